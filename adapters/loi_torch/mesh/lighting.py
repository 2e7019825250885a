"""Light: from points and directions, and from all around."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_torch.mesh.meshes import Material
from loi_torch.mesh.tensors import tensor_of, unit
from loi_torch.mesh.textures import Pyramid, cube_face, latlong

__all__ = ["Environment", "Light", "reflected"]


@dataclass(frozen=True, eq=False)
class Light:
    """A light without falloff or shadow.

    Parameters
    ----------
    position : array, shape (3,), optional
        In world units.
    direction : array, shape (3,), optional
        In which the light of a distant source travels; of any length but 0. Without this and a position, the light is
        at the camera.
    colour : array, shape (3,), or float
        Linear RGB.
    """

    position: Any = None
    direction: Any = None
    colour: Any = 1.0

    def __post_init__(self) -> None:
        if self.position is not None and self.direction is not None:
            msg = "`position` and `direction` of a light exclude each other"
            raise ParameterError(msg)
        for name in ("position", "direction"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, tensor_of(name, getattr(self, name), (3,)))
        colour = tensor_of("colour", self.colour)
        if tuple(colour.shape) not in ((), (3,)):
            msg = f"`colour` must be a number or three, got shape {tuple(colour.shape)}"
            raise ParameterError(msg)
        object.__setattr__(self, "colour", colour.expand(3))
        if self.direction is not None and not bool((self.direction.detach() != 0.0).any()):
            msg = "`direction` must not be 0"
            raise ParameterError(msg)

    def towards(self, points: Tensor, eye: Tensor) -> Tensor:
        """Unit vectors to the light, shape (s, 3); `eye` is where the camera is, shape (3,)."""
        if self.direction is not None:
            return unit(-self.direction).expand_as(points)
        return unit((eye if self.position is None else self.position) - points)


class Environment:
    """Light from far away, in all directions.

    Parameters
    ----------
    image : array, shape (6, s, s, 3) or (h, w, 3)
        Linear RGB: the faces +x, -x, +y, -y, +z, -z of a cube, as OpenGL turns them; or longitude across and latitude
        down, with -z in the middle and +y on top.
    blurred : bool
        Whether to look up in halved copies where pixels see many texels at once, so that none is missed.
    """

    def __init__(self, image: Any, *, blurred: bool = True) -> None:
        self.image = tensor_of("image", image)
        shape = tuple(self.image.shape)
        self.cube = self.image.ndim == 4 and shape[0] == 6 and shape[3] == 3 and shape[1] == shape[2]
        if not self.cube and not (self.image.ndim == 3 and shape[2] == 3):
            msg = f"`image` of an environment must have shape (6, s, s, 3) or (h, w, 3), got {shape}"
            raise ParameterError(msg)
        self._blurred = blurred
        layers = self.image if self.cube else self.image[None]
        self._pyramid = Pyramid(layers, (not self.cube, False), None if blurred else 0)

    def with_image(self, image: Any) -> Environment:
        """The same with another image."""
        return Environment(image, blurred=self._blurred)

    def radiance(self, direction: Tensor, footprint: Tensor | None = None) -> Tensor:
        """What comes from the directions, shape (s, 3); `footprint` is the angle of a pixel, in radians, shape (s,)."""
        if self.cube:
            face, place = cube_face(direction)
            return self._pyramid.look_up(face, place, None if footprint is None else 0.5 * footprint)
        place = latlong(direction)
        layer = torch.zeros(len(place), dtype=torch.int64, device=place.device)
        return self._pyramid.look_up(layer, place, None if footprint is None else footprint / (2.0 * torch.pi))


def reflected(
    colours: Tensor, points: Tensor, normals: Tensor, eye: Tensor, view: Tensor, material: Material, lights: list[Light]
) -> Tensor:
    """Blinn-Phong's sum (Blinn 1977), shape (s, 3).

    Parameters
    ----------
    colours, points, normals, view : Tensor, shape (s, 3)
        The surface's colour, place and unit normal, and unit vectors to the eye.
    eye : Tensor, shape (3,)
    material : Material
    lights : list of Light
    """
    total: Tensor = colours * material.ambient
    for light in lights:
        towards = light.towards(points, eye)
        lit = (normals * towards).sum(dim=1, keepdim=True).clamp(min=0.0)
        total = total + colours * material.diffuse * lit * light.colour
        if material.specular.requires_grad or bool((material.specular != 0.0).any()):
            halfway = unit(towards + view)
            gloss = (normals * halfway).sum(dim=1, keepdim=True)
            shining = (gloss > 0.0) & (lit > 0.0)
            gloss = torch.where(shining, gloss, torch.ones_like(gloss)) ** material.shininess
            gloss = torch.where(shining, gloss, torch.zeros_like(gloss))
            total = total + material.specular * gloss * light.colour
    return total

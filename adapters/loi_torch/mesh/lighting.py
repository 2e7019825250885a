"""Point and directional lights, environment maps, and Blinn-Phong reflection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.keywords import suggest_keywords
from loi_torch.mesh.meshes import Material
from loi_torch.mesh.tensors import finite_tensor, unit
from loi_torch.mesh.textures import MipPyramid, cube_coordinates, latlong_coordinates

__all__ = ["Environment", "Light", "blinn_phong"]


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Light:
    """A light without falloff or shadows; at the camera if it has neither position nor direction.

    Parameters
    ----------
    position : array, shape (3,), optional
        In world units.
    direction : array, shape (3,), optional
        Direction of travel of a distant light, of any length but 0.
    colour : array, shape (3,), or float
        Linear RGB.

    Raises
    ------
    ParameterError
        If a value has a wrong shape, or both `position` and `direction` are given.
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
                object.__setattr__(self, name, finite_tensor(name, getattr(self, name), (3,)))
        colour = finite_tensor("colour", self.colour)
        if tuple(colour.shape) not in ((), (3,)):
            msg = f"`colour` must be a number or three, got shape {tuple(colour.shape)}"
            raise ParameterError(msg)
        object.__setattr__(self, "colour", colour.expand(3))
        if self.direction is not None and not bool((self.direction.detach() != 0.0).any()):
            msg = "`direction` must not be 0"
            raise ParameterError(msg)

    def towards(self, points: Tensor, eye: Tensor) -> Tensor:
        """Return unit vectors from points to the light, shape (s, 3); `eye` is the camera's position, shape (3,)."""
        if self.direction is not None:
            return unit(-self.direction).expand_as(points)
        return unit((eye if self.position is None else self.position) - points)


class Environment:
    """An environment map: radiance from all directions, infinitely far away.

    Parameters
    ----------
    image : array, shape (6, s, s, 3) or (h, w, 3)
        Linear RGB: the faces +x, -x, +y, -y, +z, -z of a cube map, oriented as in OpenGL; or a map of longitude and
        latitude with -z in the middle and +y on top. Where pixels cover many texels, its mipmap is used.

    Raises
    ------
    ParameterError
        If `image` has another shape or is not finite.
    """

    def __init__(self, image: Any) -> None:
        self.image = finite_tensor("image", image)
        shape = tuple(self.image.shape)
        self.cube = self.image.ndim == 4 and shape[0] == 6 and shape[3] == 3 and shape[1] == shape[2]
        if not self.cube and not (self.image.ndim == 3 and shape[2] == 3):
            msg = f"`image` of an environment must have shape (6, s, s, 3) or (h, w, 3), got {shape}"
            raise ParameterError(msg)
        self._pyramid = MipPyramid(self.image if self.cube else self.image[None], (not self.cube, False))

    def radiance(self, direction: Tensor, footprint: Tensor | None = None) -> Tensor:
        """Return the radiance from directions, shape (s, 3); `footprint`, shape (s,), is a pixel's angle in radians."""
        if self.cube:
            face, position = cube_coordinates(direction)
            return self._pyramid.sample(face, position, None if footprint is None else 0.5 * footprint)
        position = latlong_coordinates(direction)
        layer = torch.zeros(len(position), dtype=torch.int64, device=position.device)
        return self._pyramid.sample(layer, position, None if footprint is None else footprint / (2.0 * torch.pi))


def blinn_phong(
    colours: Tensor, points: Tensor, normals: Tensor, eye: Tensor, view: Tensor, material: Material, lights: list[Light]
) -> Tensor:
    """Return the reflected light of all lights (Blinn 1977), shape (s, 3).

    `colours`, `points`, unit `normals` and `view`, unit vectors to the `eye`, have shape (s, 3).
    """
    total: Tensor = colours * material.ambient
    for light in lights:
        towards = light.towards(points, eye)
        cosine = (normals * towards).sum(dim=1, keepdim=True).clamp(min=0.0)
        total = total + colours * material.diffuse * cosine * light.colour
        if material.specular.requires_grad or bool((material.specular != 0.0).any()):
            halfway = unit(towards + view)
            gloss = (normals * halfway).sum(dim=1, keepdim=True)
            is_glossy = (gloss > 0.0) & (cosine > 0.0)
            gloss = torch.where(is_glossy, gloss, torch.ones_like(gloss)) ** material.shininess
            gloss = torch.where(is_glossy, gloss, torch.zeros_like(gloss))
            total = total + material.specular * gloss * light.colour
    return total

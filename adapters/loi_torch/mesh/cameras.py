"""Cameras: from the world to homogeneous pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.values import real_number
from loi_core.support.wording import shown
from loi_torch.mesh.projected import View
from loi_torch.mesh.tensors import tensor_of, unit

__all__ = ["Camera"]

UPRIGHT = 1e-9  # sine of the least angle between the direction of view and `up`


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera at a place, looking at another.

    Parameters
    ----------
    position, target, up : array, shape (3,)
        In world units; where it is, what is in the middle of the image, and what points upwards in it.
    fov : float
        Field of view from the image's top to its bottom, in degrees; of a perspective camera.
    extent : float, optional
        World units from the image's top to its bottom; makes the camera orthographic.
    near : float
        Distance along the direction of view, in world units, from which on things are drawn; in perspective more than
        0.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or range, or `up` is the direction of view.

    Notes
    -----
    All but `near` may be tensors that require gradients.
    """

    position: Any
    target: Any = (0.0, 0.0, 0.0)
    up: Any = (0.0, 1.0, 0.0)
    fov: Any = 45.0
    extent: Any = None
    near: float = 0.01

    def __post_init__(self) -> None:
        for name in ("position", "target", "up"):
            object.__setattr__(self, name, tensor_of(name, getattr(self, name), (3,)))
        object.__setattr__(self, "fov", tensor_of("fov", self.fov, ()))
        if not 0.0 < float(self.fov.detach()) < 180.0:
            msg = f"`fov` must be between 0 and 180 degrees, got {float(self.fov.detach()):g}"
            raise ParameterError(msg)
        if self.extent is not None:
            object.__setattr__(self, "extent", tensor_of("extent", self.extent, ()))
            if not float(self.extent.detach()) > 0.0:
                msg = f"`extent` must be more than 0, got {float(self.extent.detach()):g}"
                raise ParameterError(msg)
        near = real_number(self.near)
        if not math.isfinite(near):
            msg = f"`near` must be a finite number, got {shown(self.near)}"
            raise ParameterError(msg)
        if self.extent is None and not near > 0.0:
            msg = f"`near` must be more than 0 in perspective, got {near:g}"
            raise ParameterError(msg)
        object.__setattr__(self, "near", near)
        forward, up = self.target.detach() - self.position.detach(), self.up.detach()
        sine = torch.linalg.vector_norm(torch.linalg.cross(forward, up))
        scale = torch.linalg.vector_norm(forward) * torch.linalg.vector_norm(up)
        if not bool(sine > UPRIGHT * scale):
            msg = "`target` must not be at `position`, nor `up` along the direction of view"
            raise ParameterError(msg)

    def axes(self) -> Tensor:
        """Unit vectors to the right, down and forward, the rows of a matrix (3, 3)."""
        forward = unit(self.target - self.position)
        right = unit(torch.linalg.cross(forward, self.up))
        return torch.stack([right, torch.linalg.cross(forward, right), forward])

    def project(self, points: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
        """Points of the world, shape (n, 3), on the screen.

        Returns
        -------
        corners : Tensor, shape (n, 3)
            Homogeneous pixels (x w, y w, w); (0, 0) is the image's top left corner.
        depth : Tensor, shape (n,)
            `w` times the nearness that a depth buffer compares.
        """
        x, y, z = ((points - self.position) @ self.axes().T).unbind(dim=1)
        one = torch.ones_like(z)
        if self.extent is not None:
            scale = height / self.extent
            return torch.stack([scale * x + 0.5 * width, scale * y + 0.5 * height, one], dim=1), -z
        focal = 0.5 * height / torch.tan(0.5 * torch.deg2rad(self.fov))
        return torch.stack([focal * x + 0.5 * width * z, focal * y + 0.5 * height * z, z], dim=1), one

    def view(self, height: int, width: int) -> View:
        """What is drawn of an image of this size."""
        if self.extent is not None:
            return View(height, width, 0.5, -self.near)  # all w are 1
        return View(height, width, self.near, 1.0 / self.near)

    def directions(self, points: Tensor, height: int, width: int) -> Tensor:
        """Unit vectors from the eye through points of the image, shape (s, 3); `points` are pixels, shape (s, 2)."""
        right, down, forward = self.axes()
        if self.extent is not None:
            level: Tensor = forward.expand(len(points), 3)
            return level
        focal = 0.5 * height / torch.tan(0.5 * torch.deg2rad(self.fov))
        x, y = (points[:, :1] - 0.5 * width) / focal, (points[:, 1:] - 0.5 * height) / focal
        return unit(x * right + y * down + forward)

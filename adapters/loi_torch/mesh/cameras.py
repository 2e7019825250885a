"""Cameras: projection from world space to homogeneous pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.values import real_number
from loi_core.support.wording import shown
from loi_torch.mesh.tensors import accelerator_of, finite_tensor, unit
from loi_torch.mesh.visibility.types import Viewport

__all__ = ["Camera"]

MIN_UP_SINE: Final = 1e-9  # of the angle between the viewing direction and `up`


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective or orthographic camera.

    Parameters
    ----------
    position, target, up : array, shape (3,)
        In world units: the eye, the point in the middle of the image, and the direction that points upwards in it.
    fov : float
        Vertical field of view of a perspective camera in degrees, more than 0 and less than 180.
    extent : float, optional
        World units from the image's top to its bottom; makes the camera orthographic.
    near : float
        Distance of the near plane in world units, along the viewing direction; more than 0 for a perspective camera.
    device : torch.device, optional
        Device of the images of meshes on the processor; by default the first tensor's that is not there.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or range, or `up` is parallel to the viewing direction.

    Notes
    -----
    All but `near` and `device` may be tensors that require gradients, on any device. The camera holds them on the
    processor; gradients arrive on their devices.
    """

    position: Any
    target: Any = (0.0, 0.0, 0.0)
    up: Any = (0.0, 1.0, 0.0)
    fov: Any = 45.0
    extent: Any = None
    near: float = 0.01
    device: Any = None

    def __post_init__(self) -> None:
        numbers = self.position, self.target, self.up, self.fov, self.extent
        object.__setattr__(self, "device", accelerator_of(*numbers) or self.device)
        for name in ("position", "target", "up"):
            object.__setattr__(self, name, finite_tensor(name, getattr(self, name), (3,)))
        object.__setattr__(self, "fov", finite_tensor("fov", self.fov, ()))
        if not 0.0 < float(self.fov.detach()) < 180.0:
            msg = f"`fov` must be between 0 and 180 degrees, got {float(self.fov.detach()):g}"
            raise ParameterError(msg)
        if self.extent is not None:
            object.__setattr__(self, "extent", finite_tensor("extent", self.extent, ()))
            if not float(self.extent.detach()) > 0.0:
                msg = f"`extent` must be more than 0, got {float(self.extent.detach()):g}"
                raise ParameterError(msg)
        near_plane = real_number(self.near)
        if not math.isfinite(near_plane):
            msg = f"`near` must be a finite number, got {shown(self.near)}"
            raise ParameterError(msg)
        if self.extent is None and not near_plane > 0.0:
            msg = f"`near` must be more than 0 in perspective, got {near_plane:g}"
            raise ParameterError(msg)
        object.__setattr__(self, "near", near_plane)
        forward, up = self.target.detach() - self.position.detach(), self.up.detach()
        cross_length = torch.linalg.vector_norm(torch.linalg.cross(forward, up))
        scale = torch.linalg.vector_norm(forward) * torch.linalg.vector_norm(up)
        if not bool(cross_length > MIN_UP_SINE * scale):
            msg = "`target` must not be at `position`, nor `up` along the viewing direction"
            raise ParameterError(msg)

    def axes(self) -> Tensor:
        """Return the unit vectors to the right, down and forward, as the rows of a matrix, shape (3, 3)."""
        forward = unit(self.target - self.position)
        right = unit(torch.linalg.cross(forward, self.up))
        return torch.stack([right, torch.linalg.cross(forward, right), forward])

    def project(self, points: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
        """Project points in world units, shape (n, 3).

        Returns
        -------
        corners : Tensor, shape (n, 3)
            Homogeneous pixels (x w, y w, w); (0, 0) is the image's top left corner.
        depth : Tensor, shape (n,)
            `w` times the reversed depth of the depth buffer, which is larger for nearer points.
        """
        x, y, z = ((points - self.position) @ self.axes().T).unbind(dim=1)
        ones = torch.ones_like(z)
        if self.extent is not None:
            scale = height / self.extent
            return torch.stack([scale * x + 0.5 * width, scale * y + 0.5 * height, ones], dim=1), -z
        focal = 0.5 * height / torch.tan(0.5 * torch.deg2rad(self.fov))
        return torch.stack([focal * x + 0.5 * width * z, focal * y + 0.5 * height * z, z], dim=1), ones

    def viewport(self, height: int, width: int) -> Viewport:
        """Return the image size and the near plane for the visibility pass."""
        if self.extent is not None:
            return Viewport(height, width, 0.5, -self.near)  # every w is 1
        return Viewport(height, width, self.near, 1.0 / self.near)

    def directions(self, points: Tensor, height: int, width: int) -> Tensor:
        """Return unit vectors from the eye through points in pixels, shape (s, 2), as shape (s, 3)."""
        right, down, forward = self.axes()
        if self.extent is not None:
            parallel: Tensor = forward.expand(len(points), 3)
            return parallel
        focal = 0.5 * height / torch.tan(0.5 * torch.deg2rad(self.fov))
        x, y = (points[:, :1] - 0.5 * width) / focal, (points[:, 1:] - 0.5 * height) / focal
        return unit(x * right + y * down + forward)

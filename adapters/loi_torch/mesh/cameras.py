"""Cameras: projection from world space to homogeneous pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import real_number
from loi_core.support.wording import shown
from loi_torch.mesh.tensors import accelerator_of, finite_tensor, unit
from loi_torch.mesh.visibility.types import Viewport

__all__ = ["Camera"]

MIN_UP_SINE: Final = 1e-9  # of the angle between the viewing direction and `up`
MAX_ROTATION_ERROR: Final = 1e-3  # of an element of R R^T; files have three digits or more


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective or orthographic camera.

    Parameters
    ----------
    position, target, up : array, shape (3,)
        In world units: the eye, the point in the middle of the image, and the direction that points upwards in it.
    fov : float
        Vertical field of view of a perspective camera in degrees, more than 0 and less than 180. Without a
        `principal_point`, half of it is above the image's centre.
    extent : float, optional
        World units from the image's top to its bottom; makes the camera orthographic.
    near : float
        Distance of the near plane in world units, along the viewing direction; more than 0 for a perspective camera.
    device : torch.device, optional
        Device of the images of meshes on the processor; by default the first tensor's that is not there.
    focal : array, shape (2,), optional
        Focal lengths along x and y in pixels, more than 0; they replace `fov`.
    principal_point : array, shape (2,), optional
        The x and y of the viewing direction in the image, in pixels from its top left corner, by default its centre.
    skew : float
        Pixels along x for each unit of y / z; 0 for nearly every lens.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or range, `up` is parallel to the viewing direction, or an orthographic camera has
        `focal` or `skew`.

    Notes
    -----
    All but `near` and `device` may be tensors that require gradients, on any device. The camera holds them on the
    processor; gradients arrive on their devices. `focal`, `principal_point` and `skew` are in pixels, so they belong to
    one size of the image.
    """

    position: Any
    target: Any = (0.0, 0.0, 0.0)
    up: Any = (0.0, 1.0, 0.0)
    fov: Any = 45.0
    extent: Any = None
    near: float = 0.01
    device: Any = None
    focal: Any = None
    principal_point: Any = None
    skew: Any = 0.0

    def __post_init__(self) -> None:
        optics = self.fov, self.extent, self.focal, self.principal_point, self.skew
        object.__setattr__(self, "device", accelerator_of(self.position, self.target, self.up, *optics) or self.device)
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
        for name in ("focal", "principal_point"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, finite_tensor(name, getattr(self, name), (2,)))
        object.__setattr__(self, "skew", finite_tensor("skew", self.skew, ()))
        if self.focal is not None and not bool((self.focal.detach() > 0.0).all()):
            msg = f"`focal` must be more than 0, got {tuple(self.focal.tolist())}"
            raise ParameterError(msg)
        if self.extent is not None and (self.focal is not None or float(self.skew.detach()) != 0.0):
            msg = "an orthographic camera, which `extent` makes, must have neither `focal` nor `skew`"
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

    @classmethod
    def from_matrix(cls, intrinsics: Any, world_to_camera: Any, *, near: float = 0.01, device: Any = None) -> Camera:
        """Return a perspective camera from its matrices, in OpenCV's axes: x to the right, y down, z forward.

        Parameters
        ----------
        intrinsics : array, shape (3, 3) or (4, 4)
            ``[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]`` in pixels of the image that is drawn, where (0, 0) is the
            image's top left corner, and not the centre of its first pixel. A fourth row and column are the identity's.
        world_to_camera : array, shape (3, 4) or (4, 4)
            Rotation and translation, ``[R | t]``: a point p in world units is at ``R p + t`` in the camera's axes.
        near, device
            As for the class.

        Raises
        ------
        ParameterError
            If a matrix has another shape or form, or `world_to_camera` scales or mirrors.

        Notes
        -----
        Tensors that require gradients may be given. The camera has the rotation nearest in rounding to R, so gradients
        are those along rotations.

        Examples
        --------
        >>> import numpy as np
        >>> from loi_torch.mesh import Camera
        >>> camera = Camera.from_matrix([[90, 0, 32], [0, 90, 24], [0, 0, 1]], np.eye(4))
        >>> camera.intrinsics(48, 64).tolist()
        [[90.0, 0.0, 32.0], [0.0, 90.0, 24.0], [0.0, 0.0, 1.0]]
        """
        device = accelerator_of(intrinsics, world_to_camera) or device
        matrix = _upper_left("intrinsics", finite_tensor("intrinsics", intrinsics), ((3, 3), (4, 4)), 3)
        fixed = matrix.detach()[[1, 2, 2, 2], [0, 0, 1, 2]].tolist()
        if fixed != [0.0, 0.0, 0.0, 1.0]:
            msg = f"`intrinsics` must be [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], got {matrix.tolist()}"
            raise ParameterError(msg)
        extrinsics = finite_tensor("world_to_camera", world_to_camera)
        extrinsics = _upper_left("world_to_camera", extrinsics, ((3, 4), (4, 4)), 4)
        rotation, translation = extrinsics[:, :3], extrinsics[:, 3]
        error = float((rotation.detach() @ rotation.detach().T - torch.eye(3, dtype=torch.float64)).abs().max())
        if error > MAX_ROTATION_ERROR or float(torch.linalg.det(rotation.detach())) < 0.0:
            msg = f"`world_to_camera` must begin with a rotation matrix, got {rotation.tolist()}"
            raise ParameterError(msg)
        position = -rotation.T @ translation
        return cls(
            position,
            position + rotation[2],
            -rotation[1],
            near=near,
            device=device,
            focal=matrix[[0, 1], [0, 1]],
            principal_point=matrix[:2, 2],
            skew=matrix[0, 1],
        )

    def intrinsics(self, height: int, width: int) -> Tensor:
        """Return the camera matrix in pixels, shape (3, 3), as in :meth:`from_matrix`.

        The matrix of an orthographic camera maps x and y in world units, and 1, to pixels.
        """
        focal, skew, centre = self._scales(height), self.skew, self._centre(height, width)
        zero, one = torch.zeros_like(skew), torch.ones_like(skew)
        rows = [focal[0], skew, centre[0], zero, focal[1], centre[1], zero, zero, one]
        return torch.stack(rows).reshape(3, 3)

    def world_to_camera(self) -> Tensor:
        """Return the rotation and translation into the camera's axes, shape (4, 4), as in :meth:`from_matrix`."""
        axes = self.axes()
        upper = torch.cat([axes, -(axes @ self.position)[:, None]], dim=1)
        return torch.cat([upper, torch.eye(4, dtype=torch.float64)[3:]])

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
        w = z if self.extent is None else ones
        (x_scale, y_scale), (x_centre, y_centre) = self._scales(height), self._centre(height, width)
        corners = torch.stack([x_scale * x + self.skew * y + x_centre * w, y_scale * y + y_centre * w, w], dim=1)
        return corners, ones if self.extent is None else -z

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
        x_scale, y_scale = self._scales(height)
        x, y = (points - self._centre(height, width)).unbind(dim=1)
        y = y / y_scale
        x = (x - self.skew * y) / x_scale
        return unit(x[:, None] * right + y[:, None] * down + forward)

    def pixel_angle(self, height: int) -> float:
        """Return the approximate angle that a pixel subtends, in radians; 0 for an orthographic camera."""
        if self.extent is not None:
            return 0.0
        return 2.0 * math.atan(0.5 * height / float(self._scales(height)[1].detach())) / height

    def _scales(self, height: int) -> Tensor:
        """Return pixels along x and y for each unit of x / z and y / z, or of x and y, shape (2,)."""
        if self.focal is not None:
            focal: Tensor = self.focal
            return focal
        if self.extent is not None:
            scale: Tensor = height / self.extent
            return scale.expand(2)
        scale = 0.5 * height / torch.tan(0.5 * torch.deg2rad(self.fov))
        return scale.expand(2)

    def _centre(self, height: int, width: int) -> Tensor:
        """Return the x and y of the viewing direction in pixels, shape (2,)."""
        if self.principal_point is not None:
            principal_point: Tensor = self.principal_point
            return principal_point
        return torch.tensor([0.5 * width, 0.5 * height], dtype=torch.float64)


def _upper_left(name: str, matrix: Tensor, shapes: tuple[tuple[int, int], ...], columns: int) -> Tensor:
    """Return three rows of a matrix that may have a fourth row, and column, of the identity."""
    if tuple(matrix.shape) not in shapes:
        msg = f"`{name}` must have shape {shapes[0]} or {shapes[1]}, got {tuple(matrix.shape)}"
        raise ParameterError(msg)
    rest = matrix.detach()
    if rest[3:].tolist() not in ([], [[0.0, 0.0, 0.0, 1.0]]) or bool(rest[:3, columns:].any()):
        msg = (
            f"`{name}` must have the identity's fourth row{' and column' if columns == 3 else ''}, got {rest.tolist()}"
        )
        raise ParameterError(msg)
    return matrix[:3, :columns]

"""Cameras and poses of kornia, for the meshes of :mod:`loi_torch.mesh`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.keywords import suggest_keywords
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.posing import rotation_from_rows

if TYPE_CHECKING:
    from kornia.geometry.camera import PinholeCamera
    from kornia.geometry.liegroup import Se3

__all__ = ["cameras_from_pinhole", "pinhole_from_cameras", "pose_from_values", "values_from_pose"]

PIXEL_CENTRE = 0.5
"""Position of the first pixel's centre from the image's corner; kornia counts pixels from that centre."""


@suggest_keywords
def cameras_from_pinhole(pinhole: PinholeCamera, *, near: float = 0.01) -> list[Camera]:
    """Return the cameras of a batch of kornia's.

    Parameters
    ----------
    pinhole : PinholeCamera
        A batch of B cameras. Both libraries have OpenCV's axes; kornia's pixels have whole numbers at their centres.
    near : float
        See :class:`loi_torch.mesh.Camera`.

    Returns
    -------
    list of Camera, length B
        They draw images of the pinhole cameras' `height` and `width`. Gradients reach its matrices.

    Raises
    ------
    ParameterError
        As :meth:`loi_torch.mesh.Camera.from_matrix`.
    """
    intrinsics = _moved(pinhole.camera_matrix, PIXEL_CENTRE)
    pairs = zip(intrinsics, pinhole.extrinsics, strict=True)
    return [Camera.from_matrix(matrix, extrinsics, near=near) for matrix, extrinsics in pairs]


@suggest_keywords
def pinhole_from_cameras(cameras: Sequence[Camera], height: int, width: int) -> PinholeCamera:
    """Return perspective cameras that draw images of one size as a batch of kornia's, float64 on the processor.

    Raises
    ------
    ParameterError
        If there is none, or one is orthographic.
    """
    from kornia.geometry.camera import PinholeCamera

    if not cameras or any(camera.extent is not None for camera in cameras):
        msg = "`cameras` must be perspective cameras, one or more"
        raise ParameterError(msg)
    intrinsics = torch.eye(4, dtype=torch.float64).repeat(len(cameras), 1, 1)
    matrices = torch.stack([camera.intrinsics(height, width) for camera in cameras])
    intrinsics[:, :3, :3] = _moved(matrices, -PIXEL_CENTRE)
    extrinsics = torch.stack([camera.world_to_camera() for camera in cameras])
    sizes = (torch.full((len(cameras),), float(size), dtype=torch.float64) for size in (height, width))
    return PinholeCamera(intrinsics, extrinsics, *sizes)


def values_from_pose(pose: Se3) -> tuple[Tensor, Tensor]:
    """Return a pose as values of the handles ``Translate(mesh)`` and ``Rotate(mesh, pivot=(0, 0, 0))``.

    Parameters
    ----------
    pose : Se3
        One pose. For an ``So3`` or a ``Quaternion`` alone: ``Se3(rotation, torch.zeros(3))``.

    Returns
    -------
    translation : Tensor, shape (3,)
    rotation : Tensor, shape (2, 3)
        The first rows of the rotation matrix. Gradients of both reach the pose.

    Raises
    ------
    ParameterError
        If it is a batch of poses.
    """
    matrix = pose.matrix()
    if matrix.shape != (4, 4):
        msg = f"`pose` must be one pose, got a batch with matrices of shape {tuple(matrix.shape)}"
        raise ParameterError(msg)
    return matrix[:3, 3], matrix[:2, :3]


@suggest_keywords
def pose_from_values(translation: Tensor, rotation: Tensor) -> Se3:
    """Return values of the handles in :func:`values_from_pose` as a pose."""
    from kornia.geometry.liegroup import Se3, So3

    return Se3(So3.from_matrix(rotation_from_rows(rotation)), translation)


def _moved(intrinsics: Tensor, pixels: float) -> Tensor:
    """Return camera matrices, shape (B, 3, 3), with the principal point moved along x and y."""
    shift = torch.zeros_like(intrinsics)
    shift[:, :2, 2] = pixels
    return intrinsics + shift

"""Differentiable transforms for the pose handles of a mesh."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from kornia.geometry.conversions import axis_angle_to_rotation_matrix
from torch import Tensor

from loi_core.renderers.poses import PoseParameter, Rotate, Translate, in_application_order

__all__ = ["apply_handles", "rotation_from_rows"]


def apply_handles(vertices: Tensor, handles: Sequence[tuple[PoseParameter, Tensor]], centre: Tensor) -> Tensor:
    """Transform vertices by handles, in the order of :func:`loi_core.renderers.poses.in_application_order`.

    Parameters
    ----------
    vertices : Tensor, shape (n, 3)
    handles : sequence of (handle, Tensor)
        Each with its value.
    centre : Tensor, shape (3,)
        Default pivot.

    Returns
    -------
    Tensor, shape (n, 3)
    """
    for handle, value in in_application_order(handles):
        if isinstance(handle, Translate):
            offset = value if handle.axis is None else value * _tensor_like(vertices, handle.axis)
            vertices = vertices + offset
            continue
        pivot = centre if handle.pivot is None else _tensor_like(vertices, handle.pivot)
        if not isinstance(handle, Rotate):
            vertices = pivot + value * (vertices - pivot)
        else:
            rotation = (
                rotation_from_rows(value)
                if handle.axis is None
                else _rotation_about(_tensor_like(vertices, handle.axis), value)
            )
            vertices = pivot + (vertices - pivot) @ rotation.T
    return vertices


def rotation_from_rows(rows: Tensor) -> Tensor:
    """Return the rotation matrix, shape (3, 3), of two rows, shape (2, 3), made orthonormal (Zhou et al. 2019)."""
    first = rows[0] / torch.linalg.vector_norm(rows[0])
    second = rows[1] - (first * rows[1]).sum() * first
    second = second / torch.linalg.vector_norm(second)
    return torch.stack([first, second, torch.linalg.cross(first, second)])


def _rotation_about(axis: Tensor, degrees: Tensor) -> Tensor:
    matrix: Tensor = axis_angle_to_rotation_matrix((axis * torch.deg2rad(degrees))[None])[0]
    return matrix


def _tensor_like(values: Tensor, numbers: Sequence[float]) -> Tensor:
    return torch.tensor(numbers, dtype=values.dtype, device=values.device)

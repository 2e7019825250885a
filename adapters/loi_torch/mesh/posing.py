"""Differentiable transforms for the pose handles of a mesh."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from kornia.geometry.conversions import axis_angle_to_rotation_matrix
from torch import Tensor

from loi_core.renderers.poses import PoseParameter, Rotate, Translate, in_application_order

__all__ = ["apply_handles", "rotation_from_rows"]


def apply_handles(vertices: Tensor, handles: Sequence[tuple[PoseParameter, Tensor]], centre: Tensor) -> Tensor:
    """Transform vertices, shape (n, 3), by handles and their values, with the default pivot `centre`, shape (3,).

    The order is that in :func:`loi_core.renderers.poses.in_application_order`.
    """
    for handle, value in in_application_order(handles):
        if isinstance(handle, Translate):
            offset = value if handle.axis is None else value * _tensor_like(vertices, handle.axis)
            vertices = vertices + offset
            continue
        pivot = centre if handle.pivot is None else _tensor_like(vertices, handle.pivot)
        if not isinstance(handle, Rotate):
            vertices = pivot + value * (vertices - pivot)
        elif handle.axis is None:
            vertices = pivot + (vertices - pivot) @ rotation_from_rows(value).T
        else:
            axis_angle = _tensor_like(vertices, handle.axis) * torch.deg2rad(value)
            vertices = pivot + (vertices - pivot) @ axis_angle_to_rotation_matrix(axis_angle[None])[0].T
    return vertices


def rotation_from_rows(rows: Tensor) -> Tensor:
    """Return the rotation matrix, shape (3, 3), of two rows, shape (2, 3), made orthonormal (Zhou et al. 2019)."""
    first = rows[0] / torch.linalg.vector_norm(rows[0])
    second = rows[1] - (first * rows[1]).sum() * first
    second = second / torch.linalg.vector_norm(second)
    return torch.stack([first, second, torch.linalg.cross(first, second)])


def _tensor_like(values: Tensor, numbers: Sequence[float]) -> Tensor:
    return torch.tensor(numbers, dtype=values.dtype, device=values.device)

"""Transforms of torch for the handles on a mesh's pose."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from kornia.geometry.conversions import axis_angle_to_rotation_matrix
from torch import Tensor

from loi_core.renderers.handles import Handle, Rotate, Translate, in_order

__all__ = ["posed", "rotation"]


def posed(vertices: Tensor, handles: Sequence[tuple[Handle, Tensor]], centre: Tensor) -> Tensor:
    """Vertices, shape (n, 3), that handles have moved, in the order of :func:`loi_core.renderers.handles.in_order`.

    Parameters
    ----------
    vertices : Tensor, shape (n, 3)
    handles : sequence of (handle, Tensor)
        Each with its value.
    centre : Tensor, shape (3,)
        The pivot of handles that have none of their own.
    """
    for handle, value in in_order(handles):
        if isinstance(handle, Translate):
            along = value if handle.axis is None else value * _like(vertices, handle.axis)
            vertices = vertices + along
            continue
        pivot = centre if handle.pivot is None else _like(vertices, handle.pivot)
        if not isinstance(handle, Rotate):
            vertices = pivot + value * (vertices - pivot)
        else:
            turn = rotation(value) if handle.axis is None else _about(_like(vertices, handle.axis), value)
            vertices = pivot + (vertices - pivot) @ turn.T
    return vertices


def rotation(rows: Tensor) -> Tensor:
    """The rotation whose matrix begins with two rows, made orthonormal; shape (2, 3) to (3, 3) (Zhou et al. 2019)."""
    first = rows[0] / torch.linalg.vector_norm(rows[0])
    second = rows[1] - (first * rows[1]).sum() * first
    second = second / torch.linalg.vector_norm(second)
    return torch.stack([first, second, torch.linalg.cross(first, second)])


def _about(axis: Tensor, degrees: Tensor) -> Tensor:
    turned: Tensor = axis_angle_to_rotation_matrix((axis * torch.deg2rad(degrees))[None])[0]
    return turned


def _like(values: Tensor, numbers: Sequence[float]) -> Tensor:
    return torch.tensor(numbers, dtype=values.dtype, device=values.device)

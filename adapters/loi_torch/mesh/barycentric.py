"""Perspective-correct barycentric coordinates, and interpolation with them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["SurfaceSamples", "barycentric_weights", "gather_corners", "interpolate"]


class SurfaceSamples(NamedTuple):
    """Points in the image, each with the triangle that is visible there."""

    corners: Tensor  # (s, 3) int64: vertices of the triangle
    mesh: Tensor  # (s,) int64
    points: Tensor  # (s, 2): (x, y) in pixels
    triangle: Tensor  # (s,) int64


def gather_corners(values: Tensor, corners: Tensor) -> Tensor:
    """Return the rows of `values`, shape (n, c), at the vertices `corners`, shape (s, 3), as shape (s, 3, c)."""
    return values.index_select(0, corners.reshape(-1)).reshape(*corners.shape, values.shape[1])


def barycentric_weights(screen: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Return the perspective-correct barycentric coordinates and the edge functions of points, both of shape (s, 3).

    `points`, shape (s, 2), are in pixels; `screen`, shape (s, 3, 3), has the homogeneous corners (x w, y w, w) of the
    triangle of each point. The sign of the sum of the edge functions is the facing of the triangle.
    """
    w = screen[..., 2]
    x = screen[..., 0] - points[:, :1] * w
    y = screen[..., 1] - points[:, 1:] * w
    functions = torch.stack(
        [
            x[:, 1] * y[:, 2] - x[:, 2] * y[:, 1],
            x[:, 2] * y[:, 0] - x[:, 0] * y[:, 2],
            x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0],
        ],
        dim=1,
    )
    return functions / functions.sum(dim=1, keepdim=True), functions


def interpolate(values: Tensor, corners: Tensor, weights: Tensor) -> Tensor:
    """Interpolate vertex values, shape (n, c), to samples, shape (s, c)."""
    result: Tensor = torch.einsum("sk,skc->sc", weights, gather_corners(values, corners))
    return result

"""Barycentric coordinates of points on the screen, and what is interpolated with them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

__all__ = ["Samples", "corner_rows", "interpolate", "weights"]


@dataclass(frozen=True)
class Samples:
    """Points on the screen, each with the triangle that is seen there.

    Attributes
    ----------
    corners : Tensor of int64, shape (s, 3)
        Of the triangle.
    mesh : Tensor of int64, shape (s,)
        Its number.
    points : Tensor, shape (s, 2)
        (x, y) in pixels.
    triangle : Tensor of int64, shape (s,)
    """

    corners: Tensor
    mesh: Tensor
    points: Tensor
    triangle: Tensor


def corner_rows(values: Tensor, corners: Tensor) -> Tensor:
    """The rows of `values`, shape (n, c), at the corners, shape (s, 3, c)."""
    return values.index_select(0, corners.reshape(-1)).reshape(*corners.shape, values.shape[1])


def weights(screen: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Perspective-correct barycentric coordinates, and the volume that tells nearness.

    Parameters
    ----------
    screen : Tensor, shape (s, 3, 3)
        Homogeneous corners (x w, y w, w) of the triangle of each sample.
    points : Tensor, shape (s, 2)
        In pixels.

    Returns
    -------
    weights : Tensor, shape (s, 3)
        They sum to 1, and are those in space, not on the screen.
    functions : Tensor, shape (s, 3)
        The edge functions, of which the weights are the shares.
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


def interpolate(values: Tensor, corners: Tensor, shares: Tensor) -> Tensor:
    """Values of corners, shape (n, c), at samples, shape (s, c)."""
    result: Tensor = torch.einsum("sk,skc->sc", shares, corner_rows(values, corners))
    return result

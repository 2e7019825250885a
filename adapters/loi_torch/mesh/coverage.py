"""Exact coverage: the area of a pixel beyond an edge, which anti-aliases outlines and differentiates their motion.

A pixel starts with the colour at its centre. Along a ray from the centre the colour changes wherever the ray meets an
edge, from the colour on the near side to the colour on the far side. Each edge segment within the pixel therefore adds
the area that it hides from the centre times this change of colour. The sum is exact for any number of edges, whether
they meet or not. So the total brightness of an object of one colour does not depend on its position relative to the
pixels, and the derivative of an area is the boundary term of Reynolds' transport theorem.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

__all__ = ["END_MARGIN", "hidden_area", "nearest_fraction", "nearest_point"]

END_MARGIN: Final = 0.02  # fraction of a segment at either end where its sides are not queried


def hidden_area(start: Tensor, end: Tensor, orientation: Tensor) -> Tensor:
    """Return the area, in pixels and shape (f,), of a pixel that edge segments hide from its centre.

    `start` and `end`, shape (f, 2), are relative to the centre and within [-0.5, 0.5]. `orientation`, shape (f,), is 1
    if a segment runs around the centre from x to y, -1 if it runs the other way, and gives the sign of the area. It
    decides only for segments through the centre or nearly so, where rounding would decide otherwise.
    """
    wedge = (_perimeter_position(end) - _perimeter_position(start)) / 8.0
    wedge = wedge - torch.round(wedge.detach())
    is_half = wedge.detach().abs() > 0.49
    wedge = torch.where(is_half & (wedge.detach() * orientation < 0.0), wedge + orientation, wedge)
    return wedge - 0.5 * (start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0])


def nearest_point(start: Tensor, end: Tensor, centre: Tensor) -> Tensor:
    """Return the points of segments nearest to the centre, shape (f, 2), for queries of their two sides.

    With these points the contribution of an edge through the centre is continuous as the centre changes sides. They
    keep away from the ends, where other edges begin.
    """
    return start + nearest_fraction(start, end, centre)[:, None] * (end - start)


def nearest_fraction(start: Tensor, end: Tensor, centre: Tensor) -> Tensor:
    """Return the positions of these points on their segments, shape (f,), 0 to 1."""
    direction = end - start
    squared = (direction * direction).sum(dim=1)
    fraction = ((centre - start) * direction).sum(dim=1) / torch.where(squared > 0.0, squared, torch.ones_like(squared))
    return fraction.clamp(END_MARGIN, 1.0 - END_MARGIN)


def _perimeter_position(point: Tensor) -> Tensor:
    """Return where the ray to a point leaves the square [-1, 1]^2, along its perimeter from (1, 0), which is 8 long.

    The part of the perimeter between two rays, divided by 8, is the area of a pixel between them.
    """
    x, y = point.unbind(dim=1)
    is_sideways = x.abs() >= y.abs()
    ones = torch.ones_like(x)
    y_over_x = torch.where(is_sideways, y / torch.where(is_sideways & (x != 0.0), x, ones), ones)
    x_over_y = torch.where(is_sideways, ones, x / torch.where(is_sideways, ones, y))
    on_vertical_sides = torch.where(x >= 0.0, y_over_x, 4.0 + y_over_x)
    on_horizontal_sides = torch.where(y > 0.0, 2.0 - x_over_y, 6.0 - x_over_y)
    return torch.where(is_sideways, on_vertical_sides, on_horizontal_sides)

"""How much of a pixel lies beyond an edge, exactly: what makes outlines smooth and moves them.

A pixel starts with the colour at its centre. Rays from the centre tell the rest: where one meets an edge, the colour
changes from what is on the near side to what is on the far side. So each part of an edge within the pixel adds the area
that it hides from the centre, within the pixel, times the change of colour. However many edges there are, and whichever
of them meet, the areas are exact. The total brightness of an object of one colour therefore does not depend on where it
lies between pixels, and the derivative of an area is the edge's own, as Reynolds' transport theorem has it.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

__all__ = ["ENDS", "hidden_area", "nearest_point", "nearest_share"]

ENDS: Final = 0.02  # of a part, at its ends


def hidden_area(first: Tensor, last: Tensor, turn: Tensor) -> Tensor:
    """The area of a pixel that parts of edges hide from its centre.

    Parameters
    ----------
    first, last : Tensor, shape (f, 2)
        Ends of each part relative to the centre of its pixel, within [-0.5, 0.5].
    turn : Tensor, shape (f,)
        1 where it runs around the centre from x to y, -1 where it runs the other way. It decides only for parts that
        pass through the centre or nearly so, where rounding would.

    Returns
    -------
    Tensor, shape (f,)
        In pixels, negative where `turn` is.
    """
    wedge = (_around(last) - _around(first)) / 8.0
    wedge = wedge - torch.round(wedge.detach())
    halves = wedge.detach().abs() > 0.49
    wedge = torch.where(halves & (wedge.detach() * turn < 0.0), wedge + turn, wedge)
    return wedge - 0.5 * (first[:, 0] * last[:, 1] - first[:, 1] * last[:, 0])


def nearest_point(first: Tensor, last: Tensor, centre: Tensor) -> Tensor:
    """The points of parts of edges, shape (f, 2), at which their two sides are looked at: those nearest to the centre.

    What an edge through the centre adds then goes on without a jump as the centre changes sides. Ends are kept away
    from, as other edges begin there.
    """
    return first + nearest_share(first, last, centre)[:, None] * (last - first)


def nearest_share(first: Tensor, last: Tensor, centre: Tensor) -> Tensor:
    """Where between their ends those points lie, shape (f,), 0 to 1."""
    along = last - first
    length = (along * along).sum(dim=1)
    share = ((centre - first) * along).sum(dim=1) / torch.where(length > 0.0, length, torch.ones_like(length))
    return share.clamp(ENDS, 1.0 - ENDS)


def _around(point: Tensor) -> Tensor:
    """Where the ray to a point leaves the square with half side 1, along its border from (1, 0), which is 8 long.

    Between two rays lies an eighth, of a pixel's area, of the border between them.
    """
    x, y = point.unbind(dim=1)
    sideways = x.abs() >= y.abs()
    one = torch.ones_like(x)
    across = torch.where(sideways, y / torch.where(sideways & (x != 0.0), x, one), one)
    along = torch.where(sideways, one, x / torch.where(sideways, one, y))
    flat = torch.where(x >= 0.0, across, 4.0 + across)
    steep = torch.where(y > 0.0, 2.0 - along, 6.0 - along)
    return torch.where(sideways, flat, steep)

"""Choosing among measured pairs of time and error: pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from loi_core.objectives.loi import gradient_tolerance

__all__ = ["HIDDEN", "WITHIN", "Recommendation", "pareto_set", "recommend"]

WITHIN: Final = gradient_tolerance("balanced")
"""Largest relative gradient error that is recommended where nothing is random."""

HIDDEN: Final = 1.0 / 3.0
"""An error hides under noise if it is at most this share of it: it makes the whole of both 5 % larger."""


@dataclass(frozen=True)
class Recommendation:
    """The cheapest choice with an error that is small enough.

    Attributes
    ----------
    index : int
        Which of the points.
    error : float
        Its relative gradient error.
    allowed : float
        Largest error that is small enough.
    noise : float or None
        Relative noise of the renderer's gradient that `allowed` is a share of; None if nothing is random.
    met : bool
        False if no error is small enough; then this is the least there is.
    """

    index: int
    error: float
    allowed: float
    noise: float | None
    met: bool


def pareto_set(points: Sequence[tuple[float, float]]) -> list[bool]:
    """For each pair of time and error whether no other is better in one and at least as good in the other."""
    marked = [False] * len(points)
    least = float("inf")
    best: tuple[float, float] | None = None
    for index in sorted(range(len(points)), key=lambda index: points[index]):
        if points[index][1] < least:
            best = points[index]
            least = best[1]
        marked[index] = points[index] == best  # equals of a point in the set are in it as well
    return marked


def recommend(points: Sequence[tuple[float, float]], noise: float | None) -> Recommendation | None:
    """The fastest of some pairs of time and error whose error hides under `noise`, or is within tolerance.

    Parameters
    ----------
    points : sequence of (float, float)
        Seconds and relative gradient error.
    noise : float or None
        Relative noise of the gradient that a renderer gives; None if it gives the same on every call.

    Returns
    -------
    Recommendation or None
        None if there are no points.
    """
    if not points:
        return None
    allowed = WITHIN if noise is None else HIDDEN * noise
    small = [index for index, point in enumerate(points) if point[1] <= allowed]
    if small:
        index = min(small, key=lambda index: points[index])
    else:
        index = min(range(len(points)), key=lambda index: points[index][::-1])
    return Recommendation(index, points[index][1], allowed, noise, bool(small))

"""Choice among measured pairs of time and error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from loi_core.objectives.loi import gradient_tolerance

__all__ = ["MAX_NOISE_FRACTION", "TOLERANCE", "Recommendation", "pareto_set", "recommend"]

TOLERANCE: Final = gradient_tolerance("balanced")
"""Largest recommended relative gradient error without noise."""

MAX_NOISE_FRACTION: Final = 1.0 / 3.0
"""Largest recommended error relative to the noise: together they are 5 % larger than the noise alone."""


@dataclass(frozen=True)
class Recommendation:
    """The fastest choice whose error is allowed.

    Attributes
    ----------
    index : int
        Index of the point.
    error : float
        Its relative gradient error.
    allowed : float
        Largest allowed error.
    noise : float or None
        Relative noise of the renderer's gradient, which determines `allowed`; None without noise.
    is_allowed : bool
        False if no error is allowed; the choice then has the least error.
    """

    index: int
    error: float
    allowed: float
    noise: float | None
    is_allowed: bool


def pareto_set(points: Sequence[tuple[float, float]]) -> list[bool]:
    """Return whether each pair of time and error is Pareto optimal; equal points are so together."""
    optimal = [False] * len(points)
    min_error = float("inf")
    last: tuple[float, float] | None = None
    for index in sorted(range(len(points)), key=lambda index: points[index]):
        if points[index][1] < min_error:
            last = points[index]
            min_error = last[1]
        optimal[index] = points[index] == last
    return optimal


def recommend(points: Sequence[tuple[float, float]], noise: float | None) -> Recommendation | None:
    """Return the fastest pair of time and error whose error is small against the noise, or within the tolerance.

    Parameters
    ----------
    points : sequence of (float, float)
        Seconds and relative gradient error.
    noise : float or None
        Relative noise of a renderer's gradient; None for a deterministic renderer.

    Returns
    -------
    Recommendation or None
        None without points.
    """
    if not points:
        return None
    allowed = TOLERANCE if noise is None else MAX_NOISE_FRACTION * noise
    candidates = [index for index, point in enumerate(points) if point[1] <= allowed]
    if candidates:
        index = min(candidates, key=lambda index: points[index])
    else:
        index = min(range(len(points)), key=lambda index: points[index][::-1])
    return Recommendation(index, points[index][1], allowed, noise, bool(candidates))

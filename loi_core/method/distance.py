"""The distance between two stacks of cumulative histograms, and its derivative.

At a tie the derivative of |x| is ours to choose, since array libraries disagree there (0 in torch, +1 in JAX).
The rule: a difference that the rounding of the CDFs alone could have made is a tie. It adds nothing to the distance,
and its derivative is 0. Without that, converged regions would send full-size gradients of random sign, and equal images
would have no distance of exactly 0 where a compiler rounds one of them otherwise than the other.
"""

from __future__ import annotations

import math
from typing import Final

from loi_core.support.arrays import Array, epsilon, namespace, sum_of_all

__all__ = ["TIE_ROUNDINGS", "cost_slope", "sum_of_costs", "tie_threshold"]

TIE_ROUNDINGS: Final = 16.0


def tie_threshold(difference: Array, total: float) -> float:
    """Largest |difference| that counts as a tie.

    Parameters
    ----------
    difference : array
        Only its dtype is used.
    total : float
        The value that the CDFs reach at the last level (1 if they are normalised).

    Returns
    -------
    float
        ``16 * eps * total``. A CDF near its total is off by a rounding for each of the roughly eight levels that carry
        a pixel's mass, and blurring, whose rows sum to at most 1, averages that. Twice as much leaves less between a
        tie and what is none: on checkerboards, whose histograms blur to equal ones, two ways to compute the same
        gradient are at most 3 % apart in float32, where they are 13 % apart with 8 roundings.
    """
    return TIE_ROUNDINGS * epsilon(difference) * total


def cost_slope(difference: Array, p: float, tie: float, weight: float = 1.0) -> Array:
    """`weight` times the derivative of ``|difference| ** (1 / p)`` (eq. 5), with 0 wherever ``|difference| <= tie``.

    For p > 1 the slope of the cost is infinite at 0; the tie keeps it finite.
    """
    xp = namespace(difference)
    # What is left beyond the ties, made so large that clipping leaves its sign: comparisons, and `sign` where a library
    # sees to NaN by itself, take two to four times the passes over memory.
    slope = xp.clip(difference, -tie, tie)
    slope -= difference
    slope *= -_larger_than_any(difference)
    slope = xp.clip(slope, -weight, weight)
    if p == 1.0:
        return slope
    magnitude = xp.abs(difference)
    safe = xp.where(magnitude > tie, magnitude, xp.ones_like(magnitude))
    slope *= safe ** (1.0 / p - 1.0) / p
    return slope


def sum_of_costs(difference: Array, slope: Array, p: float) -> Array:
    """The sum of ``|difference| ** (1 / p)`` where that is no tie, from its :func:`cost_slope` and with its weight.

    A power is its derivative times its base, over the exponent; so ties need to be found only once.
    """
    total = sum_of_all(difference * slope)
    return total if p == 1.0 else total * p


def _larger_than_any(difference: Array) -> float:
    """What makes a difference of CDFs that is not 0 exceed 1: such differences are 0 or above eps**2."""
    return math.pow(epsilon(difference), -3.0)

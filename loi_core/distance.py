"""The distance between two stacks of cumulative histograms, and its derivative.

At a tie the derivative of |x| is ours to choose, since array libraries disagree there (0 in torch, +1 in JAX).
The rule: a difference that the rounding of the CDFs alone could have made is a tie, and at a tie the derivative
is 0. Without it, converged regions would send full-size gradients of random sign.
"""

from __future__ import annotations

from typing import Final

from loi_core.arrays import Array, epsilon, namespace

__all__ = ["TIE_ROUNDINGS", "cost", "cost_slope", "tie_threshold"]

TIE_ROUNDINGS: Final = 8.0


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
        ``8 * eps * total``: a CDF near its total is off by a rounding for each of the roughly eight levels that
        carry a pixel's mass, and blurring, whose rows sum to at most 1, averages that.
    """
    return TIE_ROUNDINGS * epsilon(difference) * total


def cost(difference: Array, p: float) -> Array:
    """``|difference| ** (1 / p)``, the integrand of eq. 5."""
    xp = namespace(difference)
    magnitude = xp.abs(difference)
    return magnitude if p == 1.0 else magnitude ** (1.0 / p)


def cost_slope(difference: Array, p: float, tie: float) -> Array:
    """Derivative of :func:`cost`, with 0 wherever ``|difference| <= tie``.

    For p > 1 the slope of the cost is infinite at 0; the tie keeps it finite.
    """
    xp = namespace(difference)
    # What is left beyond the ties has the sign; comparisons would take twice the passes over memory.
    sign = xp.sign(difference - xp.clip(difference, -tie, tie))
    if p == 1.0:
        return sign
    magnitude = xp.abs(difference)
    safe = xp.where(magnitude > tie, magnitude, xp.ones_like(magnitude))
    return sign * safe ** (1.0 / p - 1.0) / p

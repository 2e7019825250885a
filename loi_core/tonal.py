"""The tonal scale: every intensity as a soft histogram, and its cumulative sum.

Shapes: `intensity` is (...); a stack of levels is put in front of it, (L, ...).
"""

from __future__ import annotations

import math

from loi_core.arrays import Array, namespace

__all__ = ["clip", "clip_pullback", "isophote_density", "soft_cdf", "soft_cdf_and_slope"]


def clip(intensity: Array, low: float, high: float) -> Array:
    """`intensity` limited to [low, high]."""
    return namespace(intensity).clip(intensity, low, high)


def clip_pullback(intensity: Array, cotangent: Array, low: float, high: float) -> Array:
    """Carry a cotangent back through :func:`clip`, keeping what points back inside.

    A clipped value is flat, so its derivative is 0 and an optimiser would leave it where it is. The rule here:
    strictly below `low`, a cotangent is kept if descent along it raises the value; strictly above `high`, if
    it lowers it; inside and on the bounds it is always kept.
    """
    xp = namespace(intensity)
    outward = ((intensity < low) & (cotangent > 0)) | ((intensity > high) & (cotangent < 0))
    return xp.where(outward, xp.zeros_like(cotangent), cotangent)


def isophote_density(intensity: Array, levels: Array, beta: float) -> Array:
    """Densities N(k_i; intensity, beta^2) of eq. 3.

    Parameters
    ----------
    intensity : array, shape (...)
    levels : array, shape (L,)
        The k_i, in units of intensity.
    beta : float
        Tonal scale, in units of intensity.

    Returns
    -------
    array, shape (L, ...)
        In units of one over intensity.
    """
    return _density(_offsets(intensity, levels, beta), beta)


def soft_cdf(intensity: Array, levels: Array, beta: float, mass: float) -> Array:
    """Cumulative soft histogram: ``cumsum_i N(k_i; intensity, beta^2) * mass``, shape (L, ...)."""
    xp = namespace(intensity)
    return xp.cumulative_sum(isophote_density(intensity, levels, beta) * mass, axis=0)


def soft_cdf_and_slope(intensity: Array, levels: Array, beta: float, mass: float) -> tuple[Array, Array]:
    """:func:`soft_cdf` and its derivative by the intensity, both of shape (L, ...).

    The slope is summed from the bottom like the CDF itself. Far above the intensity its terms cancel there, once,
    to (nearly) 0; pulling a cotangent back through the cumulative sum instead would leave that cancellation to
    the rounding of large sums of signs.
    """
    xp = namespace(intensity)
    offsets = _offsets(intensity, levels, beta)
    weights = _density(offsets, beta) * mass
    return xp.cumulative_sum(weights, axis=0), xp.cumulative_sum(weights * (offsets / beta), axis=0)


def _offsets(intensity: Array, levels: Array, beta: float) -> Array:
    xp = namespace(intensity)
    column = xp.reshape(levels, (-1, *(1,) * intensity.ndim))
    return (column - intensity) / beta


def _density(offsets: Array, beta: float) -> Array:
    xp = namespace(offsets)
    return xp.exp(-0.5 * offsets * offsets) / (math.sqrt(2.0 * math.pi) * beta)

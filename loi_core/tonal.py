"""The tonal scale: every intensity as a soft histogram, and its cumulative sum.

Shapes: `intensity` is (...); a stack of levels is put in front of it, (L, ...).

What a function has made itself, it changes in place (``a *= b``): that saves a pass over memory where arrays can be
written to, and means ``a = a * b`` where they cannot.
"""

from __future__ import annotations

import math
from typing import Final

from loi_core.arrays import Array, namespace

__all__ = [
    "accumulate",
    "clip",
    "clip_pullback",
    "isophote_density",
    "level_weights",
    "soft_cdf_and_slope",
    "weights_and_slopes",
]


ROOT_TWO: Final = math.sqrt(2.0)


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
    return _density(_offsets(intensity, levels, beta), beta, 1.0)


def soft_cdf_and_slope(intensity: Array, levels: Array, beta: float, mass: float) -> tuple[Array, Array]:
    """Cumulative soft histogram, ``cumsum_i N(k_i; intensity, beta^2) * mass``, and its derivative by the intensity.

    Both of shape (L, ...).

    The slope is summed from the bottom like the CDF itself. Far above the intensity its terms cancel there, once,
    to (nearly) 0; pulling a cotangent back through the cumulative sum instead would leave that cancellation to
    the rounding of large sums of signs.
    """
    weights, slopes = weights_and_slopes(intensity, levels, beta, mass)
    return accumulate(weights)[0], accumulate(slopes)[0]


def level_weights(intensity: Array, levels: Array, beta: float, mass: float) -> Array:
    """What every level adds to the CDF, shape (L, ...): its density times `mass`."""
    return _density(_offsets(intensity, levels, beta), beta, mass)


def weights_and_slopes(intensity: Array, levels: Array, beta: float, mass: float) -> tuple[Array, Array]:
    """What every level adds to the CDF and to its slope, both of shape (L, ...)."""
    offsets = _offsets(intensity, levels, beta)
    weights = _density(offsets, beta, mass)
    offsets *= weights
    offsets *= ROOT_TWO / beta
    return weights, offsets


def accumulate(stack: Array, start: Array | None = None) -> tuple[Array, Array]:
    """The running sums along the first axis, after `start`, and the last of them, from which the next stack goes on.

    Not the library's own cumulative sum, which along the first axis is several times slower on every one of them.
    """
    total = start
    sums = []
    for index in range(stack.shape[0]):
        total = stack[index, ...] if total is None else total + stack[index, ...]
        sums.append(total)
    return namespace(stack).stack(sums, axis=0), total


def _offsets(intensity: Array, levels: Array, beta: float) -> Array:
    """How far each level is from the intensity, in units of beta times the root of 2."""
    offsets = namespace(intensity).reshape(levels, (-1, *(1,) * intensity.ndim)) - intensity
    offsets *= 1.0 / (ROOT_TWO * beta)
    return offsets


def _density(offsets: Array, beta: float, mass: float) -> Array:
    exponent = math.log(mass / (math.sqrt(2.0 * math.pi) * beta)) - offsets * offsets
    return namespace(offsets).exp(exponent)

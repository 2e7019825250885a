"""The tonal scale: every intensity as a soft histogram, and its cumulative sum.

Shapes: `intensity` is (...); a stack of levels is put in front of it, (L, ...).

What a function has made itself, it changes in place (``a *= b``): that saves a pass over memory where arrays can be
written to, and means ``a = a * b`` where they cannot.
"""

from __future__ import annotations

import math
from typing import Final

from loi_core.method.scales import ScaleSpace
from loi_core.support.arrays import Array, namespace, runs_eagerly_on_host

__all__ = [
    "accumulate",
    "in_levels",
    "isophote_density",
    "level_positions",
    "level_weights",
    "soft_cdf_and_slope",
    "weights_and_slopes",
]


ROOT_TWO: Final = math.sqrt(2.0)
UNROLLED: Final = 64  # levels that are added one by one where each addition has to be compiled


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


def level_positions(intensity: Array, first: float, spacing: float, count: int) -> Array:
    """Intensities in units of the distance of two levels, from the level `first` on: 2.5 is between the 3rd and 4th.

    Levels are whole numbers then, which every dtype holds exactly. In units of intensity each level has a rounding of
    its own; where beta is small beside the levels these no longer cancel in the slope far above an intensity, and a
    thousand such levels outweigh the few that matter.

    All intensities lie among the `count` levels. They are clipped to them so that no compiler makes one operation, with
    one rounding, of this product and of the subtraction from a level that follows: an image would be rounded otherwise
    than a reference that was prepared outside of what is compiled, by more than ties allow for.
    """
    positions = intensity - first
    positions *= 1.0 / spacing
    return namespace(positions).clip(positions, -1.0, float(count))


def in_levels(intensity: Array, scales: ScaleSpace, beta: float) -> tuple[Array, float, float]:
    """Intensities above the padding, tonal scale and mass of a level, in units of the distance of two levels."""
    spacing = scales.spacing(beta)
    first = float(scales.levels(beta)[0]) - scales.padding
    positions = level_positions(intensity, first, spacing, scales.level_count(beta))
    return positions, beta / spacing, scales.mass(beta) / spacing


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
    if stack.shape[0] > UNROLLED and not runs_eagerly_on_host(stack):
        running = _accumulate_blocks(stack)
        running = running if start is None else running + start
        return running, running[-1, ...]
    total = start
    sums = []
    for index in range(stack.shape[0]):
        total = stack[index, ...] if total is None else total + stack[index, ...]
        sums.append(total)
    return namespace(stack).stack(sums, axis=0), total


def _accumulate_blocks(stack: Array) -> Array:
    """The running sums along the first axis, in blocks side by side: a thousand additions take a compiler minutes.

    Nor is the library's own cumulative sum an answer here: where a CDF has reached its total, the next sums must all be
    the same, and sums that are made in another order for each level are not.
    """
    xp = namespace(stack)
    count, *rest = stack.shape
    blocks = -(-count // UNROLLED)
    padding = xp.broadcast_to(xp.zeros_like(stack[:1, ...]), (blocks * UNROLLED - count, *rest))
    side_by_side = xp.reshape(xp.concat([stack, padding], axis=0), (blocks, UNROLLED, *rest))
    inside, totals = accumulate(xp.moveaxis(side_by_side, 1, 0))
    before = xp.concat([xp.zeros_like(totals[:1, ...]), accumulate(totals)[0][:-1, ...]], axis=0)
    return xp.reshape(xp.moveaxis(inside + before, 0, 1), (blocks * UNROLLED, *rest))[:count, ...]


def _offsets(intensity: Array, levels: Array, beta: float) -> Array:
    """How far each level is from the intensity, in units of beta times the root of 2."""
    offsets = namespace(intensity).reshape(levels, (-1, *(1,) * intensity.ndim)) - intensity
    offsets *= 1.0 / (ROOT_TWO * beta)
    return offsets


def _density(offsets: Array, beta: float, mass: float) -> Array:
    exponent = math.log(mass / (math.sqrt(2.0 * math.pi) * beta)) - offsets * offsets
    return namespace(offsets).exp(exponent)

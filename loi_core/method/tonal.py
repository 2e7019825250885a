"""The tonal scale: soft histograms of intensities, and their cumulative sums.

Shapes: `intensity` is (...); a stack of levels has one axis more, (L, ...).

Functions change their own intermediate arrays in place (``a *= b``), which saves a pass over memory; where arrays are
immutable it means ``a = a * b``.
"""

from __future__ import annotations

import math
from typing import Final

from loi_core.method.scales import ScaleSpace
from loi_core.support.arrays import Array, namespace, runs_eagerly_on_host

__all__ = [
    "accumulate",
    "isophote_density",
    "level_positions",
    "level_weights",
    "soft_cdf_and_slope",
    "to_level_units",
    "weights_and_slopes",
]


ROOT_TWO: Final = math.sqrt(2.0)
MAX_UNROLLED_LEVELS: Final = 64  # levels that are added one by one where each addition is compiled


def isophote_density(intensity: Array, levels: Array, beta: float) -> Array:
    """Return the densities N(k_i; intensity, beta^2) of eq. 3.

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
    """Return intensities in units of the spacing of two levels: 2.5 is between the 3rd and 4th level.

    Levels are integers in these units, which every dtype holds exactly. In units of intensity each level is rounded; if
    beta is much smaller than the levels, these errors do not cancel in the slope far above an intensity, and a thousand
    such levels outweigh the few that matter.

    All intensities lie among the `count` levels. Clipping to them keeps a compiler from fusing this product with the
    subtraction from a level that follows. A fused image would differ from a reference that was prepared without the
    compiler, by more than a tie.
    """
    positions = intensity - first
    positions *= 1.0 / spacing
    return namespace(positions).clip(positions, -1.0, float(count))


def to_level_units(intensity: Array, scales: ScaleSpace, beta: float) -> tuple[Array, float, float]:
    """Return intensities, tonal scale and mass of a level in units of the spacing of two levels.

    The intensities are given relative to the padding.
    """
    spacing = scales.spacing(beta)
    first = float(scales.levels(beta)[0]) - scales.padding
    positions = level_positions(intensity, first, spacing, scales.level_count(beta))
    return positions, beta / spacing, scales.mass(beta) / spacing


def soft_cdf_and_slope(intensity: Array, levels: Array, beta: float, mass: float) -> tuple[Array, Array]:
    """Return the cumulative soft histogram, ``cumsum_i N(k_i; intensity, beta^2) * mass``, and its derivative.

    Both have shape (L, ...); the derivative is with respect to the intensity.

    The slope is summed from the bottom like the CDF. Far above the intensity its terms cancel once, to nearly 0.
    Pulling a cotangent back through the cumulative sum instead would leave that cancellation to the rounding of large
    sums of signs.
    """
    weights, slopes = weights_and_slopes(intensity, levels, beta, mass)
    return accumulate(weights)[0], accumulate(slopes)[0]


def level_weights(intensity: Array, levels: Array, beta: float, mass: float) -> Array:
    """Return the weight of every level in the CDF, shape (L, ...): its density times `mass`."""
    return _density(_offsets(intensity, levels, beta), beta, mass)


def weights_and_slopes(intensity: Array, levels: Array, beta: float, mass: float) -> tuple[Array, Array]:
    """Return the summands of every level in the CDF and in its slope, both of shape (L, ...)."""
    offsets = _offsets(intensity, levels, beta)
    weights = _density(offsets, beta, mass)
    offsets *= weights
    offsets *= ROOT_TWO / beta
    return weights, offsets


def accumulate(stack: Array, start: Array | None = None) -> tuple[Array, Array]:
    """Return the cumulative sums along the first axis, starting from `start`, and the last of them.

    Every library's own cumulative sum is several times slower along the first axis.
    """
    if stack.shape[0] > MAX_UNROLLED_LEVELS and not runs_eagerly_on_host(stack):
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
    """Return the cumulative sums along the first axis, in blocks: compiling a thousand additions takes minutes.

    The library's own cumulative sum is not an alternative: where a CDF has reached its total, the next sums must all be
    equal, and they are not if the order of summation differs between levels.
    """
    xp = namespace(stack)
    count, *shape = stack.shape
    blocks = -(-count // MAX_UNROLLED_LEVELS)
    padding = xp.broadcast_to(xp.zeros_like(stack[:1, ...]), (blocks * MAX_UNROLLED_LEVELS - count, *shape))
    side_by_side = xp.reshape(xp.concat([stack, padding], axis=0), (blocks, MAX_UNROLLED_LEVELS, *shape))
    within_blocks, totals = accumulate(xp.moveaxis(side_by_side, 1, 0))
    preceding = xp.concat([xp.zeros_like(totals[:1, ...]), accumulate(totals)[0][:-1, ...]], axis=0)
    return xp.reshape(xp.moveaxis(within_blocks + preceding, 0, 1), (blocks * MAX_UNROLLED_LEVELS, *shape))[:count, ...]


def _offsets(intensity: Array, levels: Array, beta: float) -> Array:
    """Return the distance of each level from the intensity, in units of sqrt(2) beta."""
    offsets = namespace(intensity).reshape(levels, (-1, *(1,) * intensity.ndim)) - intensity
    offsets *= 1.0 / (ROOT_TWO * beta)
    return offsets


def _density(offsets: Array, beta: float, mass: float) -> Array:
    exponent = math.log(mass / (math.sqrt(2.0 * math.pi) * beta)) - offsets * offsets
    return namespace(offsets).exp(exponent)

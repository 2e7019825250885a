"""Estimates of the error of a gradient that was computed on samplings, measured from the images themselves.

An extent that is compared on a sampling takes the sign of a difference F of two histograms for all of a cell. Where F
changes its sign between two samples, some pixels of the cell get the wrong sign. F is nearly linear between two
samples, so its zero and the pixels with the wrong sign are known. Their fraction of the cell, signed, is the
*sign error* of that sample. The extent's blur averages sign errors on the way back: lines that cross the sampling at
every angle cancel, edges of stripes all err the same way. So sign errors are summed in blocks of `BLOCK_SIDE` by
`BLOCK_SIDE` samples, about as many as an extent averages.

Sizes alone do not bound the error. Wide blurs of periodic images, or of images that differ by less than a pixel's
motion, change sign much more often than the width of the blur suggests.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.method.plane_blurs import PlaneGrid
from loi_core.method.scales import ScaleSpace
from loi_core.method.windows import Window
from loi_core.support.arrays import Host

__all__ = ["BLOCK_SIDE", "SignErrorSums", "SignErrors", "estimated_error", "is_within", "sign_error_sums"]

BLOCK_SIDE: Final = 16

CHANCE_FACTOR: Final = 2.0
"""Block sums of unrelated sign errors have about this many times the square of independent ones."""

CONFIDENT_FRACTION: Final = 0.5
"""Fraction of the tolerance up to which an estimated error is accepted, for a tolerance up to `TIGHT_TOLERANCE`.

Over images of some twenty kinds, the error was at most 1.4 times the estimate there, and 2.2 times for a tolerance of
5e-2, whose samplings are coarser and lines between two samples less straight (docs/results/accuracy.md).
"""

TIGHT_TOLERANCE: Final = 1e-2
FRACTION_EXPONENT: Final = 0.2
"""Power of the tolerance, beyond `TIGHT_TOLERANCE`, with which that fraction decreases."""


@dataclass(frozen=True)
class SignErrors:
    """Sign errors of one extent, at one inner and one tonal scale.

    Attributes
    ----------
    mean_square : float
        Mean square, over samples, levels and planes, of the mean sign error in a block.
    independent_mean_square : float
        The same if all sign errors were independent.
    max_norm : float
        Norm of this scale's gradient where all signs agree, its largest possible value.
    """

    mean_square: float
    independent_mean_square: float
    max_norm: float

    @classmethod
    def of(cls, sums: SignErrorSums, extent: int, cells: int, *, scales: ScaleSpace, beta: float) -> SignErrors:
        """Return the sign errors of an extent that is compared on `cells` samples, at one tonal scale."""
        # Planes that equal the reference have no sign errors.
        samples = cells * sums.compared_levels * sums.planes / sums.active_planes
        mean_square, independent = (total / samples for total in sums.by_extent[extent])
        # All levels together change with an intensity as the mass does, over their spacing.
        slope = scales.scale_weight * scales.level_weight(beta) * scales.mass(beta) / scales.spacing(beta) ** 2
        return cls(mean_square, independent, slope / math.sqrt(sums.planes * sums.pixels))


@dataclass
class SignErrorSums:
    """Totals of :func:`sign_error_sums`, at one inner and one tonal scale.

    Attributes
    ----------
    planes, pixels : int
        Number of planes, and of pixels in each.
    by_extent : array, shape (E, 2)
        The two sums of each extent.
    active_planes : int
        Number of planes that were compared at all.
    compared_levels : int
        Number of levels that were compared, over these planes.
    """

    planes: int
    pixels: int
    by_extent: Host
    active_planes: int = 0
    compared_levels: int = 0


def sign_error_sums(differences: Host, grid: PlaneGrid, window: Window, tie: float) -> tuple[float, float]:
    """Return the sums over blocks whose means are in :class:`SignErrors`.

    Parameters
    ----------
    differences : array, shape (..., h, w)
        F in a window of a sampling.
    grid : PlaneGrid
        The sampling.
    window : Window
        The window; F is 0 elsewhere.
    tie : float
        Largest magnitude without a sign.
    """
    planes = differences.reshape(-1, *differences.shape[-2:])
    vertical = _axis_sums(np.swapaxes(planes, -1, -2), grid.rows.spacing, window.transposed, tie)
    horizontal = _axis_sums(planes, grid.columns.spacing, window, tie)
    return vertical[0] + horizontal[0], vertical[1] + horizontal[1]


def _axis_sums(planes: Host, spacing: float, window: Window, tie: float) -> tuple[float, float]:
    """Return the sum of the squared block sums of sign errors along the last axis, and of their squares, per sample."""
    signs = (planes > tie).astype(np.int8) - (planes < -tie).astype(np.int8)
    plane, row, column = np.nonzero(signs[..., :-1] != signs[..., 1:])
    if not len(plane):
        return 0.0, 0.0
    sample, neighbour = (planes[plane, row, column + step].astype(np.float64) for step in (0, 1))
    sign, next_sign = (signs[plane, row, column + step].astype(np.float64) for step in (0, 1))
    # Between opposite signs the line crosses 0; between a sign and a tie, the threshold.
    opposite = sign * next_sign < 0.0
    zero = np.where(opposite, 0.0, tie)
    rise = np.where(opposite, sample - neighbour, np.abs(sample) - np.abs(neighbour))
    crossing = (np.where(opposite, sample, np.abs(sample)) - zero) / rise
    position = (window.columns.start + column + 0.5) * spacing - 0.5
    # Pixels lie on integers; those up to the crossing take the sample's sign.
    fraction = (np.floor(position + crossing * spacing) + 0.5 - position) / spacing
    errors = (sign - next_sign) * (fraction - 0.5)
    block_column, block_row = (window.columns.start + column) // BLOCK_SIDE, (window.rows.start + row) // BLOCK_SIDE
    block = (plane * (block_row.max() + 1) + block_row) * (block_column.max() + 1) + block_column
    total, squares = (np.bincount(block, weights) for weights in (errors, errors**2))
    samples = float(BLOCK_SIDE**2)
    return float(np.sum(total**2)) / samples, float(np.sum(squares)) / samples


def estimated_error(sign_errors: Iterable[SignErrors]) -> float:
    """Return the estimated error, 2-norm, of a gradient that sums the sampled contributions of several extents.

    Unrelated sign errors of several extents add up as squares. The excess over chance within a block is assumed to be
    the same at all extents, so it adds up linearly.
    """
    unrelated = related = 0.0
    for errors in sign_errors:
        chance = min(errors.mean_square, CHANCE_FACTOR * errors.independent_mean_square)
        unrelated += errors.max_norm**2 * chance
        related += errors.max_norm * math.sqrt(errors.mean_square - chance)
    return math.hypot(math.sqrt(unrelated), related)


def is_within(error: float, tolerance: float, norm: float) -> bool:
    """Return whether an estimated error is safely within a tolerance, relative to the gradient's 2-norm."""
    fraction = CONFIDENT_FRACTION * math.pow(min(1.0, TIGHT_TOLERANCE / tolerance), FRACTION_EXPONENT)
    return error <= fraction * tolerance * norm

"""How far a gradient that was found on samplings may be from the exact one, measured from the images themselves.

An extent that is compared on a sampling takes the sign of a difference F of two histograms for all of a cell. Where F
changes its sign between two samples, some pixels of the cell get the wrong one. Between the two samples F is nearly a
straight line, so its zero, and with it the pixels that change sides, are known; their fraction of the cell is the
*misplacement* of that sample. What matters is how misplacements add up, since the extent's blur averages them on the
way back: lines that cross the sampling at every angle cancel, edges of stripes all err the same way. So they are added
up in blocks of `BLOCK` by `BLOCK` samples, about as many as an extent averages.

The sizes of images say nothing about this. Wide blurs of periodic images, or of images that differ by less than a
pixel's motion, change sign much more often than the width of the blur suggests.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.method.blurs import PlaneGrid
from loi_core.method.scales import ScaleSpace
from loi_core.method.windows import Window

__all__ = ["BLOCK", "Misplaced", "Tally", "error_of", "is_within", "misplaced"]

Numbers: TypeAlias = np.ndarray[Any, Any]

BLOCK: Final = 16

UNRELATED: Final = 2.0
"""Sums of unrelated misplacements have about this many times the square that independent ones would have."""

CONFIDENT: Final = 0.5
"""Share of the tolerance up to which an estimated error is believed to be within it, for a tolerance up to `CLOSE`.

Over images of some twenty kinds, the error was at most 1.4 times what is estimated there, and 2.2 times for a tolerance
of 5e-2, whose samplings are coarser, and lines between two samples less straight (docs/results/accuracy.md).
"""

CLOSE: Final = 1e-2
LOOSENING: Final = 0.2
"""With what power of the tolerance, beyond `CLOSE`, that fraction falls."""


@dataclass(frozen=True)
class Misplaced:
    """How far the signs of one extent are misplaced, at one inner and one tonal scale.

    Attributes
    ----------
    together : float
        Mean square, over samples, levels and planes, of the mean misplacement in a block.
    apart : float
        What that would be if misplacements were independent.
    weight : float
        Norm of the gradient of this scale where all signs agree, which is the most it can have.
    """

    together: float
    apart: float
    weight: float

    @classmethod
    def of(cls, tally: Tally, extent: int, cells: int, *, scales: ScaleSpace, beta: float) -> Misplaced:
        """What was tallied of an extent that is compared on so many samples, at one tonal scale."""
        seen = cells * tally.compared * tally.planes / tally.active  # planes that equal the reference are not misplaced
        together, apart = (total / seen for total in tally.sums[extent])
        # All levels together move with an intensity as the mass does, over their distance.
        most = scales.scale_weight * scales.level_weight(beta) * scales.mass(beta) / scales.spacing(beta) ** 2
        return cls(together, apart, most / math.sqrt(tally.planes * tally.pixels))


@dataclass
class Tally:
    """What :func:`misplaced` gives in all, at one inner and one tonal scale.

    Attributes
    ----------
    planes, pixels : int
        How many planes there are, and pixels of each.
    sums : array, shape (E, 2)
        The two sums, by extent.
    active : int
        How many planes were compared at all.
    compared : int
        How many levels of them.
    """

    planes: int
    pixels: int
    sums: Numbers
    active: int = 0
    compared: int = 0


def misplaced(differences: Numbers, grid: PlaneGrid, window: Window, tie: float) -> tuple[float, float]:
    """The sums over blocks that :class:`Misplaced` holds the means of.

    Parameters
    ----------
    differences : array, shape (..., h, w)
        F on a part of a sampling.
    grid : PlaneGrid
        The sampling.
    window : Window
        Which part of it; F is 0 elsewhere.
    tie : float
        Largest magnitude that has no sign.
    """
    planes = differences.reshape(-1, *differences.shape[-2:])
    down = _sums(np.swapaxes(planes, -1, -2), grid.rows.spacing, window.transposed, tie)
    across = _sums(planes, grid.columns.spacing, window, tie)
    return down[0] + across[0], down[1] + across[1]


def _sums(planes: Numbers, spacing: float, window: Window, tie: float) -> tuple[float, float]:
    """Square sums over blocks of what samples are misplaced by along the last axis, over the samples of a block."""
    signs = (planes > tie).astype(np.int8) - (planes < -tie).astype(np.int8)
    plane, row, column = np.nonzero(signs[..., :-1] != signs[..., 1:])
    if not len(plane):
        return 0.0, 0.0
    here, there = (planes[plane, row, column + step].astype(np.float64) for step in (0, 1))
    sign, other = (signs[plane, row, column + step].astype(np.float64) for step in (0, 1))
    # Between opposite signs the line passes 0; between a sign and a tie, the threshold.
    opposite = sign * other < 0.0
    zero, rise = np.where(opposite, 0.0, tie), np.where(opposite, here - there, np.abs(here) - np.abs(there))
    passed = (np.where(opposite, here, np.abs(here)) - zero) / rise
    position = (window.columns.start + column + 0.5) * spacing - 0.5
    # Pixels lie on whole numbers; those up to the line take the sign from here.
    fraction = (np.floor(position + passed * spacing) + 0.5 - position) / spacing
    moved = (sign - other) * (fraction - 0.5)
    across, down = (window.columns.start + column) // BLOCK, (window.rows.start + row) // BLOCK
    block = (plane * (down.max() + 1) + down) * (across.max() + 1) + across
    total, squares = (np.bincount(block, weights) for weights in (moved, moved**2))
    samples = float(BLOCK**2)
    return float(np.sum(total**2)) / samples, float(np.sum(squares)) / samples


def error_of(parts: Iterable[Misplaced]) -> float:
    """The estimated error, 2-norm, of a gradient that several extents compared on samplings add to.

    Unrelated misplacements of several extents add up as squares; what is alike within a block, beyond what chance does,
    is taken to be alike at all extents.
    """
    unrelated = alike = 0.0
    for part in parts:
        chance = min(part.together, UNRELATED * part.apart)
        unrelated += part.weight**2 * chance
        alike += part.weight * math.sqrt(part.together - chance)
    return math.hypot(math.sqrt(unrelated), alike)


def is_within(error: float, tolerance: float, norm: float) -> bool:
    """Whether an estimated error is surely within a tolerance, relative to the gradient's 2-norm."""
    fraction = CONFIDENT * math.pow(min(1.0, CLOSE / tolerance), LOOSENING)
    return error <= fraction * tolerance * norm

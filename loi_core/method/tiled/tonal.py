"""One tonal scale, as the kernels of a tile want it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np

from loi_core.method.dispatch import numba_supports
from loi_core.method.distance import tie_threshold
from loi_core.method.scales import ScaleSpace
from loi_core.method.tiled import plain_levels
from loi_core.method.tonal import ROOT_TWO, in_levels
from loi_core.support.arrays import Host

__all__ = ["Kernels", "TonalScale", "kernels_for"]


class Kernels(Protocol):
    """What is done with one tile: by compiled loops, or by operations on whole arrays. All arguments are arrays."""

    def gather(self, *arguments: Any) -> None:
        """See :func:`loi_core.method.tiled.plain_levels.gather`."""

    def compare(self, *arguments: Any) -> float:
        """See :func:`loi_core.method.tiled.plain_levels.compare`."""

    def pull(self, *arguments: Any) -> None:
        """See :func:`loi_core.method.tiled.plain_levels.pull`."""


def kernels_for(dtype: np.dtype[Any]) -> Kernels:
    """The fastest there are for a dtype."""
    if numba_supports(dtype.name):
        from loi_core.method.compiled import tile_levels  # with Numba, which takes long to import

        return cast("Kernels", tile_levels)
    return cast("Kernels", plain_levels)


@dataclass(frozen=True)
class TonalScale:
    """One tonal scale, in units of the distance of two levels.

    Attributes
    ----------
    scales : ScaleSpace
    beta : float
    levels : array, shape (L,)
        The numbers of the levels.
    numbers : array, shape (5,)
        See :mod:`loi_core.method.tiled.plain_levels`.
    tie : float
        The largest difference that is a tie.
    slope : float
        Of positions by intensity, and of what the kernels leave out.
    """

    scales: ScaleSpace
    beta: float
    levels: Host
    numbers: Host
    tie: float
    slope: float

    @classmethod
    def of(cls, scales: ScaleSpace, beta: float, dtype: np.dtype[Any]) -> TonalScale:
        """That of planes of one dtype."""
        nothing = np.zeros(1, dtype)
        _, width, mass = in_levels(nothing, scales, beta)
        peak = math.log(mass / (math.sqrt(2.0 * math.pi) * width))
        # Far tails are cut where they are far below a rounding: products of what is smaller may be slow to compute.
        least = 3.0 * math.log(float(np.finfo(dtype).eps))
        tie = tie_threshold(nothing, mass)
        numbers = np.asarray((1.0 / (ROOT_TWO * width), peak, least, tie, 1.0 / scales.p), dtype)
        levels = np.arange(scales.level_count(beta)).astype(dtype)
        return cls(scales, beta, levels, numbers, tie, ROOT_TWO / width / scales.spacing(beta))

    def positions(self, intensity: Host) -> Host:
        """Where intensities above the padding are, shape (h, w)."""
        return np.ascontiguousarray(in_levels(intensity, self.scales, self.beta)[0])

    def weight(self, planes: int, cells: int) -> float:
        """Of one level at one of so many samples of one of so many planes."""
        return self.scales.scale_weight * self.scales.level_weight(self.beta) / (planes * cells)

"""Plans: the samplings and blurs of each scale, chosen by :mod:`loi_core.method.planner`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from loi_core.method.plane_blurs import PlaneBlur, PlaneGrid

__all__ = ["ExtentPlan", "InnerPlan", "Plan", "TonalPlan"]

COLUMN_NAMES: Final = ["sigma", "alpha", "isophotes on", "blurred on", "compared on", "operations a pixel", "error"]


@dataclass(frozen=True)
class ExtentPlan:
    """One extent: the pyramid level it starts from, the remaining blur, and the sampling that is compared.

    Attributes
    ----------
    alpha : float
        The extent scale, in pixels.
    start : int
        Pyramid level; 0 is the sampling of the inner scale.
    blur : PlaneBlur
        From there to the sampling on which histograms are compared.
    error : float
        Estimated relative error of this scale's gradient.
    """

    alpha: float
    start: int
    blur: PlaneBlur
    error: float

    @property
    def is_sampled(self) -> bool:
        """Whether one sign is taken for several pixels, whose histograms may differ."""
        return self.error > 0.0


@dataclass(frozen=True)
class InnerPlan:
    """One inner scale: its blur, its pyramid, and its extents."""

    sigma: float
    blur: PlaneBlur
    pyramid: tuple[PlaneBlur, ...]
    extents: tuple[ExtentPlan, ...]

    @property
    def grid(self) -> PlaneGrid:
        """Sampling on which isophotes are computed."""
        return self.blur.target

    @property
    def finest(self) -> int:
        """Number of samples of the finest sampling that an extent starts from or is compared on."""
        return max(self.grid.cells, *(extent.blur.target.cells for extent in self.extents))

    @property
    def work(self) -> float:
        """Multiplications and additions for one tonal level of one channel, with the gradient."""
        return 2.0 * (sum(step.work for step in self.pyramid) + sum(extent.blur.work for extent in self.extents))


@dataclass(frozen=True)
class TonalPlan:
    """One tonal scale: its levels `first` to `last` are compared, lower levels are only accumulated."""

    beta: float
    count: int
    first: int
    last: int


@dataclass(frozen=True, repr=False)
class Plan:
    """The operations of an objective on images of one size, for each scale; ``print`` shows them.

    Attributes
    ----------
    height, width : int
        Size of the images, in pixels.
    tolerance : float
        Requested relative error of the gradient.
    eps : float
        Machine epsilon that "exact" refers to.
    inner : tuple of InnerPlan
        One for each sigma.
    tonal : tuple of TonalPlan
        One for each beta.
    compiled : bool
        Whether arrays of NumPy, and of torch and JAX on the CPU, are compared by compiled loops.
    """

    height: int
    width: int
    tolerance: float
    eps: float
    inner: tuple[InnerPlan, ...]
    tonal: tuple[TonalPlan, ...]
    compiled: bool = False

    @property
    def is_sampled(self) -> bool:
        """Whether any extent is sampled, so that the gradient is not exact."""
        return any(extent.is_sampled for inner in self.inner for extent in inner.extents)

    @property
    def work(self) -> float:
        """Multiplications and additions of the blurs for one channel: all levels and scales, with the gradient."""
        levels = sum(tonal.last - tonal.first for tonal in self.tonal)
        return levels * sum(inner.work for inner in self.inner)

    @property
    def error(self) -> float:
        """Estimated relative error of the gradient, if the errors of the scales are independent."""
        errors = [extent.error for inner in self.inner for extent in inner.extents]
        return math.sqrt(sum(error**2 for error in errors)) / len(errors)

    def __repr__(self) -> str:
        scales = sum(len(inner.extents) for inner in self.inner)
        return f"<Plan: {self.height}x{self.width} pixels, {scales} pairs of scales, tolerance {self.tolerance:g}>"

    def __str__(self) -> str:
        line = "{:>7} {:>7}  {:>12}  {:>11}  {:>11}  {:>18}  {:>7}"
        return "\n".join([self._header, *(line.format(*cells) for cells in [COLUMN_NAMES, *self._rows]), *self._footer])

    @property
    def _header(self) -> str:
        levels = ", ".join(
            f"{tonal.last - tonal.first} of {tonal.count} levels at beta {tonal.beta:g}" for tonal in self.tonal
        )
        return f"{self.height}x{self.width} pixels, tolerance {self.tolerance:g}, eps {self.eps:.1g}; {levels}"

    @property
    def _rows(self) -> list[list[str]]:
        """The cells of each pair of scales, in the order of `COLUMN_NAMES`."""
        pixels, rows = self.height * self.width, []
        for inner in self.inner:
            grids = [inner.grid, *(step.target for step in inner.pyramid)]
            steps = [0.0, *(step.work for step in inner.pyramid)]
            counted = 0  # pyramid steps whose work an earlier extent contains
            for extent in inner.extents:
                work = extent.blur.work + sum(steps[counted + 1 : extent.start + 1])
                counted = max(counted, extent.start)
                samplings = str(inner.grid), str(grids[extent.start]), str(extent.blur.target)
                cost = f"{2.0 * work / pixels:.1f}", f"{extent.error:.1e}"
                rows.append([f"{inner.sigma:g}", f"{extent.alpha:g}", *samplings, *cost])
        return rows

    @property
    def _footer(self) -> list[str]:
        cost = f"per channel {self.work / 1e6:.3g} million operations for the blurs; estimated error {self.error:.1e}"
        return (
            [cost, "NumPy, and torch and JAX on the processor: in loops compiled by Numba"] if self.compiled else [cost]
        )

"""What is computed for each scale, and where: the plan that :mod:`loi_core.method.planner` makes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from loi_core.method.blurs import PlaneBlur, PlaneGrid

__all__ = ["ExtentPlan", "InnerPlan", "Plan", "TonalPlan"]

HEADS: Final = ["sigma", "alpha", "isophotes on", "blurred on", "compared on", "operations a pixel", "error"]


@dataclass(frozen=True)
class ExtentPlan:
    """One extent: which pyramid level it starts from, what is left to blur, and the sampling that is compared.

    Attributes
    ----------
    alpha : float
        The extent scale, in pixels.
    start : int
        0 for the sampling of the inner scale, k for the k-th level of its pyramid.
    blur : PlaneBlur
        From there to where histograms are compared.
    error : float
        Estimated relative error of this scale's gradient.
    """

    alpha: float
    start: int
    blur: PlaneBlur
    error: float

    @property
    def is_sampled(self) -> bool:
        """Whether signs are taken for more than one pixel each, where histograms may differ from pixel to pixel."""
        return self.error > 0.0


@dataclass(frozen=True)
class InnerPlan:
    """One inner scale: its sampling, its pyramid, and its extents."""

    sigma: float
    blur: PlaneBlur
    pyramid: tuple[PlaneBlur, ...]
    extents: tuple[ExtentPlan, ...]

    @property
    def grid(self) -> PlaneGrid:
        """Where isophotes are computed."""
        return self.blur.target

    @property
    def finest(self) -> int:
        """Samples of the finest sampling that an extent starts from or is compared on."""
        return max(self.grid.cells, *(extent.blur.target.cells for extent in self.extents))

    @property
    def work(self) -> float:
        """Multiplications and additions for one level of one channel, there and back."""
        return 2.0 * (sum(step.work for step in self.pyramid) + sum(extent.blur.work for extent in self.extents))


@dataclass(frozen=True)
class TonalPlan:
    """One tonal scale: which of its levels are compared; those below are accumulated only."""

    beta: float
    count: int
    first: int
    last: int


@dataclass(frozen=True, repr=False)
class Plan:
    """What an objective computes for images of one size, for each scale; ``print`` shows it.

    Attributes
    ----------
    height, width : int
        Size of the images, in pixels.
    tolerance : float
        Relative error of the gradient that was asked for.
    eps : float
        Machine epsilon that "exact" refers to.
    inner : tuple of InnerPlan
        One for each sigma.
    tonal : tuple of TonalPlan
        One for each beta.
    compiled : bool
        Whether arrays of NumPy, and of torch and JAX on the processor, are compared in compiled loops.
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
        """Whether something is computed on samples, so that the gradient is not exact."""
        return any(extent.is_sampled for inner in self.inner for extent in inner.extents)

    @property
    def work(self) -> float:
        """Multiplications and additions of the blurs for one channel: all levels and scales, there and back."""
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
        return "\n".join([self._head, *(line.format(*cells) for cells in [HEADS, *self._rows]), *self._foot])

    @property
    def _head(self) -> str:
        levels = ", ".join(
            f"{tonal.last - tonal.first} of {tonal.count} levels at beta {tonal.beta:g}" for tonal in self.tonal
        )
        return f"{self.height}x{self.width} pixels, tolerance {self.tolerance:g}, eps {self.eps:.1g}; {levels}"

    @property
    def _rows(self) -> list[list[str]]:
        """What is done for each pair of scales, as `HEADS` name it."""
        pixels, rows = self.height * self.width, []
        for inner in self.inner:
            grids = [inner.grid, *(step.target for step in inner.pyramid)]
            steps = [0.0, *(step.work for step in inner.pyramid)]
            paid = 0
            for extent in inner.extents:
                work = extent.blur.work + sum(steps[paid + 1 : extent.start + 1])
                paid = max(paid, extent.start)
                where = str(inner.grid), str(grids[extent.start]), str(extent.blur.target)
                cost = f"{2.0 * work / pixels:.1f}", f"{extent.error:.1e}"
                rows.append([f"{inner.sigma:g}", f"{extent.alpha:g}", *where, *cost])
        return rows

    @property
    def _foot(self) -> list[str]:
        cost = f"per channel {self.work / 1e6:.3g} million operations for the blurs; estimated error {self.error:.1e}"
        return (
            [cost, "NumPy, and torch and JAX on the processor: in loops compiled by Numba"] if self.compiled else [cost]
        )

"""What is computed for each scale, and where: the plan that :mod:`loi_core.method.planner` makes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from loi_core.method.blurs import PlaneBlur, PlaneGrid

__all__ = ["ExtentPlan", "InnerPlan", "Plan", "TonalPlan"]


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


@dataclass(frozen=True)
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

    def __str__(self) -> str:
        pixels = self.height * self.width
        levels = ", ".join(
            f"{tonal.last - tonal.first} of {tonal.count} levels at beta {tonal.beta:g}" for tonal in self.tonal
        )
        titles = ("isophotes on", "blurred on", "compared on", "operations a pixel", "error")
        lines = [
            f"{self.height}x{self.width} pixels, tolerance {self.tolerance:g}, eps {self.eps:.1g}; {levels}",
            "{:>7} {:>7}  {:>12}  {:>11}  {:>11}  {:>18}  {:>7}".format("sigma", "alpha", *titles),
        ]
        for inner in self.inner:
            grids = [inner.grid, *(step.target for step in inner.pyramid)]
            steps = [0.0, *(step.work for step in inner.pyramid)]
            paid = 0
            for extent in inner.extents:
                work = extent.blur.work + sum(steps[paid + 1 : extent.start + 1])
                paid = max(paid, extent.start)
                lines.append(
                    f"{inner.sigma:7g} {extent.alpha:7g}  {inner.grid!s:>12}  {grids[extent.start]!s:>11}"
                    f"  {extent.blur.target!s:>11}  {2.0 * work / pixels:18.1f}  {extent.error:7.1e}"
                )
        lines.append(
            f"per channel {self.work / 1e6:.3g} million operations for the blurs; estimated error {self.error:.1e}"
        )
        if self.compiled:
            lines.append("NumPy, and torch and JAX on the processor: in loops compiled by Numba")
        return "\n".join(lines)

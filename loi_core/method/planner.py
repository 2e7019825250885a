"""Choose the samplings and blurs of each scale from sizes alone, before any array is known.

Two measures save work, with no more error than the tolerance allows:

* A wide blur passes through coarser samplings, the *pyramid levels*, where the remaining blur is cheap. Wider extents
  start from the pyramid levels of narrower ones. This is exact to rounding
  (:func:`loi_core.method.gaussian.coarsest_spacing`).
* A wide extent's blurred differences change slowly, so their mean over pixels may be taken over a coarser *sampling*.
  This has an error: where the difference of two histograms changes sign, the zero line is known only to within a cell.

Tonal levels at the far tails, which change no intensity within the bounds by more than a fraction of the tolerance,
are not compared.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.method.gaussian import (
    MIN_FLAT_SCALE,
    AxisBlur,
    AxisGrid,
    coarsest_spacing,
    equivalent_scale,
    pyramid_variance,
    truncation,
)
from loi_core.method.plan import ExtentPlan, InnerPlan, Plan, TonalPlan
from loi_core.method.plane_blurs import PlaneBlur, PlaneGrid
from loi_core.method.scales import ScaleSpace
from loi_core.method.tonal import soft_cdf_and_slope

__all__ = ["make_plan"]

QUADRATURE_ERROR: Final = 0.1
"""Relative gradient error of one extent sampled at spacing s: QUADRATURE_ERROR (s / l)**1.5, l the correlation length.

The power follows from lines that cross cells of side s, each misplaced by a fraction of s; the constant is measured
(docs/results/accuracy.md).
"""

ERROR_SHARES: Final = (0.05, 1.1, 0.6)
"""(a, b, c): error allowed for each of n scales, in units of the tolerance: min(a n**b, c).

Measured: this leaves the error of ordinary images at a third of the tolerance or less, and its estimate
(:mod:`loi_core.method.sampling_error`) below the one that has them compared at every pixel. Errors of scales average
out, and the more scales there are, the smaller each one's contribution to the gradient.
"""

MIN_SPACING_PX: Final = 4.0 / 3.0
"""Smaller spacings save less than they cost."""

MIN_CELLS: Final = 96
"""Cells along the shorter side that a sampling keeps for the tolerance BALANCED_TOLERANCE, twice for half of it.

Differences of strongly blurred images change sign along straight lines; a line along an axis is misplaced as a whole,
by up to half a cell.
"""

BALANCED_TOLERANCE: Final = 1e-2

NEGLIGIBLE_FRACTION: Final = 0.1
"""A level is not compared if it contributes less than this fraction of the tolerance to every intensity's gradient."""

BOUND_MARGIN_BETAS: Final = 16
"""Distance from a bound, in betas, at which levels at or beyond the bound still change an intensity, with a margin."""

MAX_CACHED_PLANS: Final = 64  # a loss of an image and a target plans at every call, for few sizes and scales

MAX_ITERATIONS: Final = 20  # of a fixed point; each at least halves the logarithmic distance to it

MAX_RELATIVE_SPACING: Final = 0.3
"""Largest spacing in units of the correlation length.

A Gaussian leaves less than a tie, 2e-15, of waves that are shorter than 2.6 such spacings, so signs that are not ties
do not change twice between two samples.
"""


@functools.lru_cache(maxsize=MAX_CACHED_PLANS)
def make_plan(
    scales: ScaleSpace, height: int, width: int, *, tolerance: float, eps: float, weighted: bool = False
) -> Plan:
    """Return the cheapest known plan within a tolerance.

    Parameters
    ----------
    scales : ScaleSpace
        The scales to compare.
    height, width : int
        Size of the images, in pixels.
    tolerance : float
        Relative error of the gradient, 0 or more; 0 is exact to rounding.
    eps : float
        Machine epsilon of the dtype to compute in.
    weighted : bool
        Whether pixels have weights, which may change from one pixel to the next however smooth the isophotes are.
    """
    if scales.p != 1.0:
        # |F| ** (1 / p) is steepest at 0, exactly where samplings err.
        tolerance = 0.0
    planner = _Planner(scales, PlaneGrid.pixels(height, width), tolerance, eps, weighted)
    inner = tuple(planner.plan_inner(sigma) for sigma in scales.sigma)
    return Plan(
        height, width, tolerance, eps, inner, tuple(_plan_tonal(scales, beta, tolerance) for beta in scales.beta)
    )


def _plan_tonal(scales: ScaleSpace, beta: float, tolerance: float) -> TonalPlan:
    levels = scales.levels(beta)
    everything = TonalPlan(beta, len(levels), 0, len(levels))
    if tolerance == 0.0:
        return everything
    # Levels beyond a bound change the intensities next to it most; testing all intensities could take gigabytes.
    low, high = scales.bounds
    margin = np.linspace(0.0, min(high - low, BOUND_MARGIN_BETAS * beta), 4 * BOUND_MARGIN_BETAS + 1)
    intensities = np.concat([low + margin, high - margin])
    slopes = np.abs(soft_cdf_and_slope(intensities, levels, beta, scales.mass(beta))[1])
    total = np.sum(slopes, axis=0)
    influence = np.max(slopes / np.where(total > 0.0, total, 1.0), axis=1)
    (compared,) = np.nonzero(influence >= NEGLIGIBLE_FRACTION * tolerance)
    if len(compared) == 0:
        return everything
    return TonalPlan(beta, len(levels), int(compared[0]), int(compared[-1]) + 1)


@dataclass(frozen=True)
class _Route:
    """A way to an extent: its pyramid level, the new step to that level if any, and the remaining blur."""

    level: int
    step: PlaneBlur | None
    blur: PlaneBlur

    @property
    def work(self) -> float:
        return self.blur.work + (self.step.work if self.step else 0.0)


@dataclass(frozen=True)
class _Planner:
    scales: ScaleSpace
    pixels: PlaneGrid
    tolerance: float
    eps: float
    weighted: bool

    def plan_inner(self, sigma: float) -> InnerPlan:
        grid = self._inner_grid(sigma)
        blur = self._blur(self.pixels, grid, sigma, self._effective_taps(self.scales.inner_taps, sigma))
        pyramid: list[PlaneBlur] = []
        variances = [0.0]
        extents = {}
        for alpha in sorted(self.scales.alpha):
            target, error = self._comparison_grid(grid, sigma, alpha)
            taps = self._effective_taps(self._taps, alpha)
            grids = [grid, *(step.target for step in pyramid)]
            routes = [
                _Route(level, None, self._blur(grids[level], target, math.sqrt(alpha**2 - variances[level]), taps))
                for level in range(len(grids))
                if level == 0 or self._can_leave(grids[level], alpha)
            ]
            routes += [
                _Route(len(grids), step, self._blur(step.target, target, math.sqrt(alpha**2 - variance), None))
                for step, variance in self._new_pyramid_levels(grids[-1], variances[-1], alpha)
            ]
            route = min(routes, key=lambda route: route.work)
            if route.step is not None:
                pyramid.append(route.step)
                variances.append(variances[-1] + route.step.rows.scale**2)
            extents[alpha] = ExtentPlan(alpha, route.level, route.blur, error)
        return InnerPlan(sigma, blur, tuple(pyramid), tuple(extents[alpha] for alpha in self.scales.alpha))

    @property
    def _taps(self) -> int | None:
        return self.scales.extent_taps

    def _effective_taps(self, taps: int | None, scale: float) -> int | None:
        """Return the length of a truncated kernel; None if rounding leaves nothing beyond it."""
        return None if taps is None or taps // 2 >= truncation(self.eps) * scale else taps

    @property
    def _has_pyramid(self) -> bool:
        # A truncated kernel is not Gaussian; and without reflection, a level would lose its blur beyond the border.
        return self.scales.boundary == "reflect" and self._taps is None

    @property
    def _relative_spacing(self) -> float:
        """Largest allowed spacing of a sampling in units of the correlation length."""
        factor, power, max_share = ERROR_SHARES
        terms = len(self.scales.sigma) * len(self.scales.alpha)
        allowed = self.tolerance * min(factor * math.pow(terms, power), max_share)
        return min(math.pow(allowed / QUADRATURE_ERROR, 2.0 / 3.0), MAX_RELATIVE_SPACING)

    def _inner_grid(self, sigma: float) -> PlaneGrid:
        # The pixels, although a blurred image changes slowly: its isophotes may nearly cancel in an extent, and the
        # remainder would be an artefact of the sampling.
        if self._is_constant(sigma) and self._taps is None and not self.weighted:
            return self._sampled(self.pixels, math.inf)
        return self.pixels

    def _comparison_grid(self, grid: PlaneGrid, sigma: float, alpha: float) -> tuple[PlaneGrid, float]:
        """Return the sampling on which an extent is compared, and its error."""
        if grid.cells == 1 or (self._is_constant(alpha) and self._taps is None):
            return self._sampled(grid, math.inf), 0.0
        length = self._correlation_length(sigma, alpha)
        spacing = self._limited(self._relative_spacing * length)
        if alpha == 0.0:
            target = grid
        elif self.tolerance == 0.0 or spacing < MIN_SPACING_PX:
            target = self.pixels
        else:
            target = self._sampled(self.pixels, spacing)
        if target.cells == self.pixels.cells:
            return target, 0.0
        coarsest = max(target.rows.spacing, target.columns.spacing)
        return target, QUADRATURE_ERROR * math.pow(coarsest / length, 1.5)

    def _correlation_length(self, sigma: float, alpha: float) -> float:
        """Return the correlation length of blurred differences at the allowed spacing."""
        # Isophotes of a blurred image change about twice as fast as the image.
        smooth = 0.0 if self.weighted else sigma / 2.0
        length = math.hypot(alpha, smooth)
        taps = self._effective_taps(self._taps, alpha)
        if taps is None or alpha == 0.0 or self.tolerance == 0.0:
            return length
        # At shorter distances, here to the edge of a cell, a truncated kernel changes relatively faster.
        for _ in range(MAX_ITERATIONS):
            length = math.hypot(equivalent_scale(alpha, taps, 0.5 * self._relative_spacing * length), smooth)
        return length

    def _limited(self, spacing: float) -> float:
        """Return a spacing that keeps enough cells along the shorter side."""
        shorter = min(self.pixels.rows.size, self.pixels.columns.size)
        looser = self.tolerance / BALANCED_TOLERANCE
        return min(spacing, shorter / MIN_CELLS * min(looser, math.pow(looser, 2.0 / 3.0)))

    def _is_constant(self, scale: float) -> bool:
        """Return whether a blur of this scale leaves only the mean of the plane."""
        longer = max(self.pixels.rows.size, self.pixels.columns.size)
        return self.scales.boundary == "reflect" and scale >= MIN_FLAT_SCALE * longer

    def _new_pyramid_levels(self, grid: PlaneGrid, variance: float, alpha: float) -> list[tuple[PlaneBlur, float]]:
        """Return candidate steps from `grid` to coarser levels for `alpha`, with the variance up to each level."""
        if alpha == 0.0 or not self._has_pyramid:
            return []
        steps = []
        spacing = coarsest_spacing(alpha, self.eps)
        for _ in range(3):
            coarser = self._sampled(self.pixels, spacing)
            total = pyramid_variance(spacing, self.eps)
            if 4 * coarser.cells <= grid.cells and spacing >= 2.0 and variance < total < alpha**2:
                steps.append((self._blur(grid, coarser, math.sqrt(total - variance), None), total))
            spacing /= math.sqrt(2.0)
        return steps

    def _can_leave(self, grid: PlaneGrid, alpha: float) -> bool:
        """Return whether `alpha` can be reached from a pyramid level."""
        spacing = max(grid.rows.spacing, grid.columns.spacing)
        return pyramid_variance(spacing, self.eps) < alpha**2 and spacing <= coarsest_spacing(alpha, self.eps)

    @staticmethod
    def _sampled(grid: PlaneGrid, spacing: float) -> PlaneGrid:
        """Return `grid`, or the coarser sampling of the same plane with at most this spacing."""
        rows, columns = (
            AxisGrid(axis.size, min(axis.cells, max(1, math.ceil(axis.size / spacing - 1e-9))))
            for axis in (grid.rows, grid.columns)
        )
        return PlaneGrid(rows, columns)

    def _blur(self, source: PlaneGrid, target: PlaneGrid, scale: float, taps: int | None) -> PlaneBlur:
        truncate = truncation(self.eps)
        rows = AxisBlur(source.rows, target.rows, scale, self.scales.boundary, taps, truncate)
        columns = AxisBlur(source.columns, target.columns, scale, self.scales.boundary, taps, truncate)
        return PlaneBlur(rows, columns)

"""What is computed for each scale, and where: decided from sizes alone, before any array is seen.

Two things make it cheap, and none costs accuracy beyond what was asked for:

* A wide blur passes through coarser samplings, the *levels of a pyramid*, where the rest of it is cheap. Wider extents
  start from the pyramid levels of narrower ones. This is exact to rounding
  (:func:`loi_core.method.gaussian.coarsest_spacing`).
* What a wide extent has blurred changes slowly, so its mean over pixels may be taken over a coarser *sampling*.
  There lies the error: where the difference of two histograms changes sign, the line between is only found to within
  a cell.

Levels at the far tails, which no intensity within the bounds moves by more than a fraction of the tolerance, are left
out of the comparison.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.method.blurs import PlaneBlur, PlaneGrid
from loi_core.method.gaussian import FLAT, AxisBlur, AxisGrid, as_slow_as, coarsest_spacing, pyramid_variance, reach
from loi_core.method.plan import ExtentPlan, InnerPlan, Plan, TonalPlan
from loi_core.method.scales import ScaleSpace
from loi_core.method.tonal import soft_cdf_and_slope

__all__ = ["make_plan"]

QUADRATURE: Final = 0.1
"""Relative gradient error of one extent sampled at spacing s: QUADRATURE (s / l)**1.5, with l how slowly it changes.

The power is that of lines that cross cells of side s, each misplaced by a fraction of s; the constant is measured
(docs/results/accuracy.md).
"""

FRACTION: Final = (0.05, 1.1, 0.6)
"""How much error each of n scales may have, in units of the tolerance: min(a n**b, c).

Measured: so much leaves the error of ordinary images at a third of the tolerance or less, and its estimate
(:mod:`loi_core.method.sampling_error`) below what would have them compared at every pixel. Errors of scales average
out, and the more of them there are, the smaller the part of each in the gradient.
"""

WORTHWHILE: Final = 4.0 / 3.0
"""Spacings below this save less than they cost."""

SMALLEST: Final = 96
"""A sampling keeps at least this many cells along the shorter side for a tolerance of BALANCED, twice for half that.

Differences of much blurred images change sign along straight lines; beside an axis, a line is misplaced as a whole, by
up to half a cell.
"""

BALANCED: Final = 1e-2

NEGLIGIBLE: Final = 0.1
"""A level is left out if it makes less than this fraction of the tolerance in the gradient of every intensity."""

NEAR: Final = 16
"""How many beta away from a bound an intensity is moved by levels at or beyond it, with a margin."""

SETTLED: Final = 20  # steps to a fixed point, each of which at least halves the distance to it on a scale of logarithms

RESOLVED: Final = 0.3
"""Largest spacing in units of how slowly what is sampled changes.

A Gaussian leaves less than a tie, 2e-15, of waves that are shorter than 2.6 such spacings. So signs that are not ties
do not change twice between two samples.
"""


def make_plan(
    scales: ScaleSpace, height: int, width: int, *, tolerance: float, eps: float, weighted: bool = False
) -> Plan:
    """The cheapest plan known that keeps a tolerance.

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
        Whether pixels count by weights, which may change from one to the next however smooth isophotes are.
    """
    if scales.p != 1.0:
        # |F| ** (1 / p) is steepest at 0, just where samplings err.
        tolerance = 0.0
    planner = _Planner(scales, PlaneGrid.pixels(height, width), tolerance, eps, weighted)
    inner = tuple(planner.inner(sigma) for sigma in scales.sigma)
    return Plan(height, width, tolerance, eps, inner, tuple(_levels(scales, beta, tolerance) for beta in scales.beta))


def _levels(scales: ScaleSpace, beta: float, tolerance: float) -> TonalPlan:
    levels = scales.levels(beta)
    everything = TonalPlan(beta, len(levels), 0, len(levels))
    if tolerance == 0.0:
        return everything
    # Levels beyond a bound move the intensities next to it most; to look at all intensities could take gigabytes.
    low, high = scales.bounds
    near = np.linspace(0.0, min(high - low, NEAR * beta), 4 * NEAR + 1)
    slopes = np.abs(soft_cdf_and_slope(np.concat([low + near, high - near]), levels, beta, scales.mass(beta))[1])
    total = np.sum(slopes, axis=0)
    moved = np.max(slopes / np.where(total > 0.0, total, 1.0), axis=1)
    (kept,) = np.nonzero(moved >= NEGLIGIBLE * tolerance)
    if len(kept) == 0:
        return everything
    return TonalPlan(beta, len(levels), int(kept[0]), int(kept[-1]) + 1)


@dataclass(frozen=True)
class _Planner:
    scales: ScaleSpace
    pixels: PlaneGrid
    tolerance: float
    eps: float
    weighted: bool

    def inner(self, sigma: float) -> InnerPlan:
        grid = self._inner_grid(sigma)
        blur = self._blur(self.pixels, grid, sigma, self._felt(self.scales.inner_taps, sigma))
        pyramid: list[PlaneBlur] = []
        variances = [0.0]
        extents = {}
        for alpha in sorted(self.scales.alpha):
            target, error = self._target(grid, sigma, alpha)
            taps = self._felt(self._taps, alpha)
            grids = [grid, *(step.target for step in pyramid)]
            ways: list[tuple[int, PlaneBlur | None, PlaneBlur]] = [
                (index, None, self._blur(grids[index], target, self._rest(alpha, variances[index]), taps))
                for index in range(len(grids))
                if index == 0 or self._may_leave(grids[index], alpha)
            ]
            ways += [
                (len(pyramid) + 1, step, self._blur(step.target, target, self._rest(alpha, variance), None))
                for step, variance in self._new_pyramid_levels(grids[-1], variances[-1], alpha)
            ]
            index, step, rest = min(ways, key=lambda way: way[2].work + (way[1].work if way[1] else 0.0))
            if step is not None:
                pyramid.append(step)
                variances.append(variances[-1] + step.rows.scale**2)
            extents[alpha] = ExtentPlan(alpha, index, rest, error)
        return InnerPlan(sigma, blur, tuple(pyramid), tuple(extents[alpha] for alpha in self.scales.alpha))

    @property
    def _taps(self) -> int | None:
        return self.scales.extent_taps

    def _felt(self, taps: int | None, scale: float) -> int | None:
        """Where a kernel is cut; None where that is beyond what rounding leaves of it, so that it is a Gaussian."""
        return None if taps is None or taps // 2 >= reach(self.eps) * scale else taps

    @property
    def _cascades(self) -> bool:
        # A cut kernel is no Gaussian; and without reflection, a pyramid level would lose what it blurs beyond the edge.
        return self.scales.boundary == "reflect" and self._taps is None

    @property
    def _ratio(self) -> float:
        """Largest spacing of a sampling in units of how slowly what is sampled changes."""
        fraction, power, most = FRACTION
        terms = len(self.scales.sigma) * len(self.scales.alpha)
        allowed = self.tolerance * min(fraction * math.pow(terms, power), most)
        return min(math.pow(allowed / QUADRATURE, 2.0 / 3.0), RESOLVED)

    def _inner_grid(self, sigma: float) -> PlaneGrid:
        # Not on samples, though a blurred image changes slowly: its isophotes may cancel to next to nothing further on,
        # and what is left is then what a sampling has made of them.
        if self._is_flat(sigma) and self._taps is None and not self.weighted:
            return self._sampled(self.pixels, math.inf)
        return self.pixels

    def _target(self, grid: PlaneGrid, sigma: float, alpha: float) -> tuple[PlaneGrid, float]:
        """Where an extent is compared, and the error of doing so."""
        if grid.cells == 1 or (self._is_flat(alpha) and self._taps is None):
            return self._sampled(grid, math.inf), 0.0
        slowness = self._slowness(sigma, alpha)
        spacing = self._limited(self._ratio * slowness)
        if alpha == 0.0:
            target = grid
        elif self.tolerance == 0.0 or spacing < WORTHWHILE:
            target = self.pixels
        else:
            target = self._sampled(self.pixels, spacing)
        if target.cells == self.pixels.cells:
            return target, 0.0
        coarsest = max(target.rows.spacing, target.columns.spacing)
        return target, QUADRATURE * math.pow(coarsest / slowness, 1.5)

    def _slowness(self, sigma: float, alpha: float) -> float:
        """The distance over which what is compared changes, at the spacing that is to be allowed there."""
        # Isophotes of a blurred image change about twice as fast as the image.
        smooth = 0.0 if self.weighted else sigma / 2.0
        slowness = math.hypot(alpha, smooth)
        taps = self._felt(self._taps, alpha)
        if taps is None or alpha == 0.0 or self.tolerance == 0.0:
            return slowness
        # The less far one looks, here to the edge of a cell, the faster a cut kernel changes in relation.
        for _ in range(SETTLED):
            slowness = math.hypot(as_slow_as(alpha, taps, 0.5 * self._ratio * slowness), smooth)
        return slowness

    def _limited(self, spacing: float) -> float:
        shorter = min(self.pixels.rows.size, self.pixels.columns.size)
        looser = self.tolerance / BALANCED
        return min(spacing, shorter / SMALLEST * min(looser, math.pow(looser, 2.0 / 3.0)))

    def _is_flat(self, scale: float) -> bool:
        longer = max(self.pixels.rows.size, self.pixels.columns.size)
        return self.scales.boundary == "reflect" and scale >= FLAT * longer

    def _new_pyramid_levels(self, grid: PlaneGrid, variance: float, alpha: float) -> list[tuple[PlaneBlur, float]]:
        """Pyramid levels below `grid` from which `alpha` can be reached, with the variance that they then hold."""
        if alpha == 0.0 or not self._cascades:
            return []
        found = []
        spacing = coarsest_spacing(alpha, self.eps)
        for _ in range(3):
            coarser = self._sampled(self.pixels, spacing)
            reached = pyramid_variance(spacing, self.eps)
            if 4 * coarser.cells <= grid.cells and spacing >= 2.0 and variance < reached < alpha**2:
                found.append((self._blur(grid, coarser, math.sqrt(reached - variance), None), reached))
            spacing /= math.sqrt(2.0)
        return found

    def _may_leave(self, grid: PlaneGrid, alpha: float) -> bool:
        spacing = max(grid.rows.spacing, grid.columns.spacing)
        return pyramid_variance(spacing, self.eps) < alpha**2 and spacing <= coarsest_spacing(alpha, self.eps)

    @staticmethod
    def _rest(alpha: float, variance: float) -> float:
        return math.sqrt(alpha**2 - variance)

    @staticmethod
    def _sampled(grid: PlaneGrid, spacing: float) -> PlaneGrid:
        """`grid`, or the coarser sampling of the same plane whose spacing is at most this."""
        rows, columns = (
            AxisGrid(axis.size, min(axis.cells, max(1, math.ceil(axis.size / spacing - 1e-9))))
            for axis in (grid.rows, grid.columns)
        )
        return PlaneGrid(rows, columns)

    def _blur(self, source: PlaneGrid, target: PlaneGrid, scale: float, taps: int | None) -> PlaneBlur:
        cut = reach(self.eps)
        rows = AxisBlur(source.rows, target.rows, scale, self.scales.boundary, taps, cut)
        columns = AxisBlur(source.columns, target.columns, scale, self.scales.boundary, taps, cut)
        return PlaneBlur(rows, columns)

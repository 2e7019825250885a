"""An image and a reference at one inner scale: their cumulative histograms, compared at every extent (eqs. 3 to 5).

Only what can differ is computed, where operations run one by one on the host and so may depend on values; see
:mod:`loi_core.method.scope`.

Two things keep the accuracy where bounds are far from 0, or levels many: intensities are those above the padding, and
their histograms are made in units of the distance of two levels (:func:`loi_core.method.tonal.level_positions`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.method.blurs import GaussianBlur
from loi_core.method.comparison import Compared, Terms
from loi_core.method.distance import cost_slope, sum_of_costs, tie_threshold
from loi_core.method.plan import InnerPlan, Plan, TonalPlan
from loi_core.method.sampling_error import Misplaced, Tally, misplaced
from loi_core.method.scales import ScaleSpace
from loi_core.method.scope import Route, Scope, find_scope, levels_among
from loi_core.method.tonal import accumulate, in_levels, level_weights, weights_and_slopes
from loi_core.method.windows import Window
from loi_core.pixels.bounds import above_padding
from loi_core.support.arrays import (
    Array,
    device,
    epsilon,
    from_numpy,
    namespace,
    runs_eagerly_on_host,
    to_numpy,
    values_may_decide,
)

__all__ = ["ArrayComparison"]

CHUNK_ON_HOST: Final = 2**19  # elements: 2 MiB in float32, a few of which lie in the caches of a core
CHUNK: Final = 2**24  # elements: where operations are fused or run on an accelerator, large ones are better


@dataclass(frozen=True)
class _Levels:
    """Some levels of one tonal scale, the first few only accumulated, and the reference's CDF at the others."""

    values: Array  # shape (L,), counted from the first of all
    host: tuple[float, ...]  # where they are, in units of intensity
    skipped: int
    cdf: Array  # shape (L - skipped, N, h, w)

    def within(self, scope: Scope, scales: ScaleSpace, beta: float, eps: float) -> _Levels | None:
        """Only those that are in a scope; None if none are left."""
        among = levels_among(self.host, self.skipped, scope, scales, beta, eps)
        if among.stop <= among.start:
            return None
        first, stop = among.first, max(among.first, among.stop)
        cdf = self.cdf[first - self.skipped : stop - self.skipped, ...]
        kept = slice(among.start, among.stop)
        return _Levels(self.values[kept], self.host[kept], min(first, among.stop) - among.start, cdf)


@dataclass(frozen=True)
class _Extent:
    alpha: float
    start: int
    blur: GaussianBlur

    @property
    def cells(self) -> int:
        """Samples of a plane that are compared."""
        return self.blur.blur.target.cells


@dataclass(frozen=True)
class _InnerComparison:
    """One inner scale, its operators, and the reference's CDFs there."""

    scales: ScaleSpace
    plan: InnerPlan
    blur: GaussianBlur
    intensity: Array  # the reference's, above the padding; shape (N, h, w)
    weights: Array | None  # of its pixels, shape (N, h, w)
    pyramid: tuple[GaussianBlur, ...]
    extents: tuple[_Extent, ...]
    planes: int  # how many planes are handled together
    levels: dict[float, list[_Levels]]  # by tonal scale, those that are handled together

    @classmethod
    def of(
        cls,
        scales: ScaleSpace,
        plan: InnerPlan,
        tonal: tuple[TonalPlan, ...],
        reference: Array,
        weights: Array | None,
    ) -> _InnerComparison:
        """Everything that depends on the reference alone: planes within the bounds, and weights, shape (N, H, W)."""
        blur = GaussianBlur(plan.blur, reference)
        intensity = blur.apply(above_padding(reference, scales.padding))
        most, planes = _chunk(max(each.last for each in tonal), reference.shape[0], plan.finest, reference)
        levels = {each.beta: _split(scales, each, most, intensity) for each in tonal}
        pyramid = tuple(GaussianBlur(step, reference) for step in plan.pyramid)
        extents = tuple(
            _Extent(extent.alpha, extent.start, GaussianBlur(extent.blur, reference)) for extent in plan.extents
        )
        return cls(scales, plan, blur, intensity, weights, pyramid, extents, planes, levels)

    def compare(self, clipped: Array, *, gradient: bool) -> Compared:
        """Compare planes within the bounds, shape (N, H, W).

        Where a plan has samplings, values must be at hand (:func:`loi_core.support.arrays.values_may_decide`).
        """
        xp = namespace(clipped)
        intensity = self.blur.apply(above_padding(clipped, self.scales.padding))
        terms = {
            (extent.alpha, beta, self.plan.sigma): xp.zeros((), dtype=clipped.dtype, device=device(clipped))
            for extent in self.extents
            for beta in self.levels
        }
        count, pixels = clipped.shape[0], clipped.shape[-2] * clipped.shape[-1]
        tallies = {beta: Tally(count, pixels, np.zeros((len(self.extents), 2))) for beta in self.levels}
        cotangents = []
        for start in range(0, intensity.shape[0], self.planes):
            part = slice(start, min(start + self.planes, intensity.shape[0]))
            cotangents.append(self._compare(intensity[part, ...], part, terms, tallies, gradient=gradient))
        if not gradient:
            return Compared(terms, None)
        cotangent = self.blur.adjoint(cotangents[0] if len(cotangents) == 1 else xp.concat(cotangents, axis=0))
        return Compared(terms, cotangent, tuple(self._misplaced(tallies)))

    def _misplaced(self, tallies: dict[float, Tally]) -> Iterator[Misplaced]:
        for beta, tally in tallies.items():
            for index, extent in enumerate(self.extents):
                if self.plan.extents[index].is_sampled and tally.compared:
                    yield Misplaced.of(tally, index, extent.cells, scales=self.scales, beta=beta)

    def _compare(
        self, intensity: Array, part: slice, terms: Terms, tallies: dict[float, Tally], *, gradient: bool
    ) -> Array | None:
        """Add the terms of some planes, shape (N, h, w); their cotangent by `intensity`.

        A few levels at a time, so that what is at work stays small and near.
        """
        xp = namespace(intensity)
        if values_may_decide(intensity):
            scope = find_scope(intensity, self.intensity[part, ...], self.plan, self.scales, gradient=gradient)
        else:
            scope = Scope.everything(self.plan)
        if scope is None:
            return xp.zeros_like(intensity) if gradient else None
        differing, support = scope.route.support[0], scope.support
        seen = support.crop(intensity)
        cotangent = xp.zeros_like(seen) if gradient else None
        for beta, groups in self.levels.items():
            tallies[beta].active += intensity.shape[0]
            positions, width, mass = in_levels(seen, self.scales, beta)
            tie = tie_threshold(intensity, mass)
            per_intensity = 1.0 / self.scales.spacing(beta)
            cdf_sum = slope_sum = None
            for group in groups:
                levels = group.within(scope, self.scales, beta, epsilon(intensity))
                if levels is None:
                    continue
                slope: Array = None
                if gradient:
                    weights, slopes = weights_and_slopes(positions, levels.values, width, mass)
                    slope, slope_sum = accumulate(slopes, slope_sum)
                    del slopes
                else:
                    weights = level_weights(positions, levels.values, width, mass)
                cdf, cdf_sum = accumulate(weights, cdf_sum)
                del weights
                if levels.skipped == levels.values.shape[0]:
                    continue
                difference = differing.crop(cdf[levels.skipped :, ...], support)
                difference -= differing.crop(levels.cdf[:, part, ...])
                if self.weights is not None:
                    difference *= differing.crop(self.weights[part, ...])
                tallies[beta].compared += difference.shape[0] * difference.shape[1]
                pulled = self._compare_levels(
                    difference, scope.route, beta, tie, terms, tallies[beta], gradient=gradient
                )
                if gradient:
                    pulled *= slope[levels.skipped :, ...]
                    if self.weights is not None:
                        pulled *= support.crop(self.weights[part, ...])
                    cotangent += xp.sum(pulled, axis=0) * per_intensity
        return support.paste(cotangent, *intensity.shape[-2:]) if gradient else None

    def _compare_levels(
        self, difference: Array, route: Route, beta: float, tie: float, terms: Terms, tally: Tally, *, gradient: bool
    ) -> Array | None:
        """Add the terms of a difference of CDFs, shape (L, N, h, w); the cotangent by it.

        Blurring and accumulating commute, so the difference is blurred once instead of each histogram.
        """
        scales = self.scales
        differences = [difference]
        for step, window in zip(self.pyramid, route.support, strict=False):
            differences.append(step.apply(differences[-1], window))
        pulled: list[Array | None] = [None] * len(differences)

        def pull(index: int, part: Array, window: Window) -> None:
            total, wanted = pulled[index], route.pulled[index]
            pulled[index] = _plus(total, wanted, part, window)

        for index, extent in enumerate(self.extents):
            window, plan = route.support[extent.start], self.plan.extents[index]
            blurred = extent.blur.apply(differences[extent.start], window)
            reached = plan.blur.reached(window)
            if gradient and plan.is_sampled:
                tally.sums[index] += misplaced(to_numpy(blurred), plan.blur.target, reached, tie)
            weight = scales.scale_weight * scales.level_weight(beta) / (self.intensity.shape[0] * extent.cells)
            slope = cost_slope(blurred, scales.p, tie, weight)
            terms[extent.alpha, beta, self.plan.sigma] += sum_of_costs(blurred, slope, scales.p)
            if gradient:
                back = extent.blur.adjoint(slope, reached)
                pull(extent.start, back, extent.blur.blur.reached_back(reached))
        if not gradient:
            return None
        for index in range(len(self.pyramid), 0, -1):
            part, wanted = pulled[index], route.pulled[index]
            if part is not None:
                step = self.pyramid[index - 1]
                pull(index - 1, step.adjoint(part, wanted), step.blur.reached_back(wanted))
        if pulled[0] is None:
            shape = *difference.shape[:-2], *route.pulled[0].shape
            return namespace(difference).zeros(shape, dtype=difference.dtype, device=device(difference))
        return pulled[0]


@dataclass(frozen=True)
class ArrayComparison:
    """By operations on whole arrays, of any library."""

    inner: tuple[_InnerComparison, ...]

    @classmethod
    def of(cls, scales: ScaleSpace, plan: Plan, reference: Array, weights: Array | None = None) -> ArrayComparison:
        """Everything that depends on the reference alone: planes within the bounds, and weights, shape (N, H, W)."""
        return cls(tuple(_InnerComparison.of(scales, inner, plan.tonal, reference, weights) for inner in plan.inner))

    def compare(self, clipped: Array, *, gradient: bool) -> Compared:
        """Compare planes within the bounds, shape (N, H, W)."""
        terms: Terms = {}
        total: Array = None
        parts: tuple[Misplaced, ...] = ()
        for inner in self.inner:
            compared = inner.compare(clipped, gradient=gradient)
            terms |= compared.terms
            parts += compared.misplaced
            if total is None:
                total = compared.cotangent
            elif gradient:
                total += compared.cotangent
        return Compared(terms, total, parts)


def _plus(total: Array | None, wanted: Window, part: Array, window: Window) -> Array:
    """A sum of planes in `wanted`: `total`, if there is one yet, and `part`, which lies in `window`."""
    if total is None:
        return part if window == wanted else window.paste(part, *wanted.shape, wanted)
    if window == wanted:
        total += part
    else:
        inside = window.crop(total, wanted)  # a view: windows are for libraries that have them
        inside += part
    return total


def _split(scales: ScaleSpace, plan: TonalPlan, most: int, intensity: Array) -> list[_Levels]:
    """The levels of one tonal scale, at most so many together, and the CDF of the reference's `intensity` there."""
    host = [float(level) - scales.padding for level in scales.levels(plan.beta)[: plan.last]]
    values = from_numpy(np.arange(plan.last, dtype=np.float64), intensity)
    positions, width, mass = in_levels(intensity, scales, plan.beta)
    running = None
    parts = []
    for start in range(0, plan.last, most):
        stop = min(start + most, plan.last)
        skipped = min(max(plan.first, start), stop) - start
        part = values[start:stop]
        cdf, running = accumulate(level_weights(positions, part, width, mass), running)
        kept = namespace(cdf).asarray(cdf[skipped:, ...], copy=True)
        parts.append(_Levels(part, tuple(host[start:stop]), skipped, kept))
    return parts


def _chunk(levels: int, planes: int, cells: int, like: Array) -> tuple[int, int]:
    """How many levels of how many planes to handle together, so that they fit the cache, or at least the memory."""
    elements = CHUNK_ON_HOST if runs_eagerly_on_host(like) else CHUNK
    if levels * cells <= elements:
        return levels, max(1, min(planes, elements // (levels * cells)))
    return max(1, elements // cells), 1

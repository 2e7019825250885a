"""Comparison of planes with a reference by whole-array operations of any library (eqs. 3 to 5).

Where operations run eagerly on the host, values may be read, and only the pixels and levels that can differ are
computed (:mod:`loi_core.method.support`).

Two measures keep the accuracy where bounds are far from 0 or levels many: intensities count from the padding, and
histograms are computed in units of the spacing of two levels (:func:`loi_core.method.tonal.level_positions`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from loi_core.method.blurs import GaussianBlur
from loi_core.method.comparison import ComparisonResult, Terms
from loi_core.method.distance import cost_slope, sum_of_costs, tie_threshold
from loi_core.method.plan import InnerPlan, Plan, TonalPlan
from loi_core.method.sampling_error import SignErrors, SignErrorSums, sign_error_sums
from loi_core.method.scales import ScaleSpace
from loi_core.method.support import Dependency, Supports, active_levels, find_dependency
from loi_core.method.tonal import accumulate, level_weights, to_level_units, weights_and_slopes
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

MAX_HOST_ELEMENTS: Final = 2**19  # 2 MiB in float32: a few such arrays fit the caches of a core
MAX_ELEMENTS: Final = 2**24  # larger arrays are faster where operations are fused or run on an accelerator


@dataclass(frozen=True)
class _Levels:
    """Some levels of one tonal scale, the first few only accumulated, and the reference's CDF at the others."""

    values: Array  # shape (L,), counted from the first level of the scale
    intensities: tuple[float, ...]  # above the padding
    skipped: int
    cdf: Array  # shape (L - skipped, N, h, w)

    def within(self, dependency: Dependency, scales: ScaleSpace, beta: float, eps: float) -> _Levels | None:
        """Return the active levels; None if there are none."""
        active = active_levels(self.intensities, self.skipped, dependency, scales, beta, eps)
        if active.stop <= active.start:
            return None
        first, stop = active.first, max(active.first, active.stop)
        cdf = self.cdf[first - self.skipped : stop - self.skipped, ...]
        levels = slice(active.start, active.stop)
        return _Levels(self.values[levels], self.intensities[levels], min(first, active.stop) - active.start, cdf)


@dataclass(frozen=True)
class _Extent:
    alpha: float
    start: int
    blur: GaussianBlur

    @property
    def cells(self) -> int:
        """Number of samples of a plane that are compared."""
        return self.blur.blur.target.cells


@dataclass(frozen=True)
class _InnerComparison:
    """One inner scale, its operators, and the reference's CDFs there."""

    scales: ScaleSpace
    plan: InnerPlan
    blur: GaussianBlur
    intensity: Array  # the reference's, above the padding; shape (N, h, w)
    weights: Array | None  # shape (N, h, w)
    pyramid: tuple[GaussianBlur, ...]
    extents: tuple[_Extent, ...]
    planes_at_once: int
    levels: dict[float, list[_Levels]]  # by tonal scale, in groups that are handled at once

    @classmethod
    def of(
        cls,
        scales: ScaleSpace,
        plan: InnerPlan,
        tonal: tuple[TonalPlan, ...],
        reference: Array,
        weights: Array | None,
    ) -> _InnerComparison:
        """Prepare a comparison with a reference: planes within the bounds, and weights, shape (N, H, W)."""
        blur = GaussianBlur(plan.blur, reference)
        intensity = blur.apply(above_padding(reference, scales.padding))
        max_levels, planes = _chunk(max(scale.last for scale in tonal), reference.shape[0], plan.finest, reference)
        levels = {scale.beta: _split(scales, scale, max_levels, intensity) for scale in tonal}
        pyramid = tuple(GaussianBlur(step, reference) for step in plan.pyramid)
        extents = tuple(
            _Extent(extent.alpha, extent.start, GaussianBlur(extent.blur, reference)) for extent in plan.extents
        )
        return cls(scales, plan, blur, intensity, weights, pyramid, extents, planes, levels)

    def compare(self, compressed: Array, *, gradient: bool) -> ComparisonResult:
        """See :class:`loi_core.method.comparison.Comparison`."""
        xp = namespace(compressed)
        intensity = self.blur.apply(above_padding(compressed, self.scales.padding))
        terms = {
            (extent.alpha, beta, self.plan.sigma): xp.zeros((), dtype=compressed.dtype, device=device(compressed))
            for extent in self.extents
            for beta in self.levels
        }
        count, pixels = compressed.shape[0], compressed.shape[-2] * compressed.shape[-1]
        sums = {beta: SignErrorSums(count, pixels, np.zeros((len(self.extents), 2))) for beta in self.levels}
        cotangents = []
        for start in range(0, count, self.planes_at_once):
            chunk = slice(start, min(start + self.planes_at_once, count))
            cotangents.append(self._compare(intensity[chunk, ...], chunk, terms, sums, gradient=gradient))
        if not gradient:
            return ComparisonResult(terms, None)
        cotangent = self.blur.adjoint(cotangents[0] if len(cotangents) == 1 else xp.concat(cotangents, axis=0))
        return ComparisonResult(terms, cotangent, tuple(self._sign_errors(sums)))

    def _sign_errors(self, sums_by_beta: dict[float, SignErrorSums]) -> Iterator[SignErrors]:
        for beta, sums in sums_by_beta.items():
            for index, extent in enumerate(self.extents):
                if self.plan.extents[index].is_sampled and sums.compared_levels:
                    yield SignErrors.of(sums, index, extent.cells, scales=self.scales, beta=beta)

    def _compare(
        self, intensity: Array, chunk: slice, terms: Terms, sums: dict[float, SignErrorSums], *, gradient: bool
    ) -> Array | None:
        """Add the terms of some planes, shape (N, h, w); return the cotangent of `intensity`.

        Handles a few levels at a time, so that the working set stays in the caches.
        """
        xp = namespace(intensity)
        if values_may_decide(intensity):
            dependency = find_dependency(
                intensity, self.intensity[chunk, ...], self.plan, self.scales, gradient=gradient
            )
        else:
            dependency = Dependency.everything(self.plan)
        if dependency is None:
            return xp.zeros_like(intensity) if gradient else None
        differing, window = dependency.supports.differences[0], dependency.window
        image = window.crop(intensity)
        cotangent = xp.zeros_like(image) if gradient else None
        for beta, groups in self.levels.items():
            sums[beta].active_planes += intensity.shape[0]
            positions, width, mass = to_level_units(image, self.scales, beta)
            tie = tie_threshold(intensity, mass)
            per_intensity = 1.0 / self.scales.spacing(beta)
            cdf_sum = slope_sum = None
            for group in groups:
                levels = group.within(dependency, self.scales, beta, epsilon(intensity))
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
                difference = differing.crop(cdf[levels.skipped :, ...], window)
                difference -= differing.crop(levels.cdf[:, chunk, ...])
                pixel_weights = None if self.weights is None else self.weights[chunk, ...]
                if self.scales.centred:
                    difference -= _means(difference, pixel_weights)
                if pixel_weights is not None:
                    difference *= differing.crop(pixel_weights)
                sums[beta].compared_levels += difference.shape[0] * difference.shape[1]
                pulled = self._compare_levels(
                    difference, dependency.supports, beta, tie, terms, sums[beta], gradient=gradient
                )
                if gradient:
                    if self.scales.centred:
                        pulled -= _means(pulled, pixel_weights)
                    pulled *= slope[levels.skipped :, ...]
                    if pixel_weights is not None:
                        pulled *= window.crop(pixel_weights)
                    cotangent += xp.sum(pulled, axis=0) * per_intensity
        return window.paste(cotangent, *intensity.shape[-2:]) if gradient else None

    def _compare_levels(
        self,
        difference: Array,
        supports: Supports,
        beta: float,
        tie: float,
        terms: Terms,
        sums: SignErrorSums,
        *,
        gradient: bool,
    ) -> Array | None:
        """Add the terms of a difference of CDFs, shape (L, N, h, w); return its cotangent.

        Blurring and accumulating commute, so the difference is blurred once instead of each histogram.
        """
        scales = self.scales
        differences = [difference]
        for step, window in zip(self.pyramid, supports.differences, strict=False):
            differences.append(step.apply(differences[-1], window))
        cotangents: list[Array | None] = [None] * len(differences)

        def add(level: int, planes: Array, window: Window) -> None:
            cotangents[level] = _plus(cotangents[level], supports.cotangents[level], planes, window)

        for index, extent in enumerate(self.extents):
            support, plan = supports.differences[extent.start], self.plan.extents[index]
            blurred = extent.blur.apply(differences[extent.start], support)
            compared = plan.blur.support_of(support)
            if gradient and plan.is_sampled:
                sums.by_extent[index] += sign_error_sums(to_numpy(blurred), plan.blur.target, compared, tie)
            weight = scales.scale_weight * scales.level_weight(beta) / (self.intensity.shape[0] * extent.cells)
            slope = cost_slope(blurred, scales.p, tie, weight)
            terms[extent.alpha, beta, self.plan.sigma] += sum_of_costs(blurred, slope, scales.p)
            if gradient:
                pulled = extent.blur.adjoint(slope, compared)
                add(extent.start, pulled, plan.blur.adjoint_support_of(compared))
        if not gradient:
            return None
        for level in range(len(self.pyramid), 0, -1):
            cotangent, window = cotangents[level], supports.cotangents[level]
            if cotangent is not None:
                step = self.pyramid[level - 1]
                add(level - 1, step.adjoint(cotangent, window), step.blur.adjoint_support_of(window))
        return cotangents[0]


@dataclass(frozen=True)
class ArrayComparison:
    """Comparison by whole-array operations, for arrays of any library."""

    inner: tuple[_InnerComparison, ...]

    @classmethod
    def of(cls, scales: ScaleSpace, plan: Plan, reference: Array, weights: Array | None = None) -> ArrayComparison:
        """Prepare a comparison with a reference: planes within the bounds, and weights, shape (N, H, W)."""
        return cls(tuple(_InnerComparison.of(scales, inner, plan.tonal, reference, weights) for inner in plan.inner))

    def with_weights(self, weights: Array) -> ArrayComparison:
        """See :class:`loi_core.method.comparison.Comparison`."""
        return ArrayComparison(tuple(replace(inner, weights=weights) for inner in self.inner))

    def compare(self, compressed: Array, *, gradient: bool) -> ComparisonResult:
        """See :class:`loi_core.method.comparison.Comparison`."""
        terms: Terms = {}
        total: Array = None
        sign_errors: tuple[SignErrors, ...] = ()
        for inner in self.inner:
            result = inner.compare(compressed, gradient=gradient)
            terms |= result.terms
            sign_errors += result.sign_errors
            if total is None:
                total = result.cotangent
            elif gradient:
                total += result.cotangent
        return ComparisonResult(terms, total, sign_errors)


def _plus(total: Array | None, support: Window, planes: Array, window: Window) -> Array:
    """Add planes inside `window` to a sum inside `support`, which contains it; None is a sum of 0."""
    if total is None:
        return planes if window == support else window.paste(planes, *support.shape, support)
    if window == support:
        total += planes
    else:
        inside = window.crop(total, support)  # a view: windows are used only with libraries that have views
        inside += planes
    return total


def _means(stack: Array, weights: Array | None) -> Array:
    """Return the means over pixels, shape (L, N, 1, 1), of whole planes, shape (L, N, h, w)."""
    xp = namespace(stack)
    if weights is None:
        return xp.mean(stack, axis=(-2, -1), keepdims=True)
    total = xp.sum(weights, axis=(-2, -1), keepdims=True)
    return xp.sum(stack * weights, axis=(-2, -1), keepdims=True) / xp.where(total > 0.0, total, xp.ones_like(total))


def _split(scales: ScaleSpace, plan: TonalPlan, max_levels: int, intensity: Array) -> list[_Levels]:
    """Return the levels of one tonal scale, at most `max_levels` in a group, and the CDF of the reference there."""
    intensities = [float(level) - scales.padding for level in scales.levels(plan.beta)[: plan.last]]
    values = from_numpy(np.arange(plan.last, dtype=np.float64), intensity)
    positions, width, mass = to_level_units(intensity, scales, plan.beta)
    running = None
    groups = []
    for start in range(0, plan.last, max_levels):
        stop = min(start + max_levels, plan.last)
        skipped = min(max(plan.first, start), stop) - start
        cdf, running = accumulate(level_weights(positions, values[start:stop], width, mass), running)
        compared = namespace(cdf).asarray(cdf[skipped:, ...], copy=True)
        groups.append(_Levels(values[start:stop], tuple(intensities[start:stop]), skipped, compared))
    return groups


def _chunk(levels: int, planes: int, cells: int, like: Array) -> tuple[int, int]:
    """Return how many levels, and planes, to handle at once, so that they fit the cache, or at least the memory."""
    elements = MAX_HOST_ELEMENTS if runs_eagerly_on_host(like) else MAX_ELEMENTS
    if levels * cells <= elements:
        return levels, max(1, min(planes, elements // (levels * cells)))
    return max(1, elements // cells), 1

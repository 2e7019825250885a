"""An image and a reference at one inner scale: their cumulative histograms, compared at every extent (eqs. 3 to 5).

Only what can differ is computed, where operations run one by one on the host and so may depend on values:

* Where the blurred image equals that of the reference, so do the isophotes. The difference of the two stacks of CDFs
  is 0 outside a window, its blurs are 0 outside a somewhat larger one, and so is what is pulled back.
* Levels far enough below or above all intensities are ties (:func:`loi_core.distance.tie_threshold`).

Two things keep the accuracy where bounds are far from 0, or levels many: intensities are those above the padding, and
their histograms are made in units of the distance of two levels (:func:`loi_core.tonal.level_positions`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from loi_core.arrays import Array, epsilon, from_numpy, namespace, runs_eagerly_on_host, values_may_decide
from loi_core.distance import cost_slope, sum_of_costs, tie_threshold
from loi_core.kernels import reach
from loi_core.operators import GaussianBlur
from loi_core.plan import InnerPlan, TonalPlan
from loi_core.scales import ScaleSpace
from loi_core.tonal import accumulate, level_positions, level_weights, weights_and_slopes
from loi_core.windows import Window, window_of

__all__ = ["InnerComparison", "ScaleKey", "Terms"]

ScaleKey: TypeAlias = tuple[float, float, float]
Terms: TypeAlias = dict[ScaleKey, Array]

CHUNK_ON_HOST: Final = 2**20  # elements: 4 MiB in float32, a few of which lie in the caches of a core
CHUNK: Final = 2**24  # elements: where operations are fused or run on an accelerator, large ones are better

WORTHWHILE: Final = 0.75
"""Share of the samples above which a window saves less than cutting it out costs."""


@dataclass(frozen=True)
class _Levels:
    """Some levels of one tonal scale, the first few only accumulated, and the reference's CDF at the others."""

    values: Array  # shape (L,), counted from the first of all
    host: tuple[float, ...]  # where they are, in units of intensity
    skipped: int
    cdf: Array  # shape (L - skipped, N, h, w)

    def within(self, least: float, low: float, high: float) -> _Levels | None:
        """Only those of at least `least`, compared from `low` to `high`; None if none are left."""
        start = sum(level < least for level in self.host)
        first = max(start, self.skipped, sum(level < low for level in self.host))
        stop = sum(level <= high for level in self.host)
        if stop <= start:
            return None
        cdf = self.cdf[first - self.skipped : max(first, stop) - self.skipped, ...]
        return _Levels(self.values[start:stop], self.host[start:stop], min(first, stop) - start, cdf)


@dataclass(frozen=True)
class _Extent:
    alpha: float
    rung: int
    blur: GaussianBlur

    @property
    def cells(self) -> int:
        """Samples of a plane that are compared."""
        return self.blur.blur.target.cells


@dataclass(frozen=True)
class _Route:
    """Outside which windows a difference of CDFs and all that is made of it is 0.

    Attributes
    ----------
    held : tuple of Window
        On the sampling of the inner scale and on every rung, on the way there.
    pulled : tuple of Window or None
        The same on the way back; None where nothing comes back.
    """

    held: tuple[Window, ...]
    pulled: tuple[Window | None, ...]

    @classmethod
    def of(cls, start: Window, rungs: tuple[GaussianBlur, ...], extents: tuple[_Extent, ...]) -> _Route:
        held = [start]
        for rung in rungs:
            held.append(rung.reached(held[-1]))
        pulled: list[Window | None] = [None] * len(held)

        def add(index: int, window: Window) -> None:
            before = pulled[index]
            pulled[index] = window if before is None else before | window

        for extent in extents:
            add(extent.rung, extent.blur.reached_back(extent.blur.reached(held[extent.rung])))
        for index in range(len(rungs), 0, -1):
            window = pulled[index]
            if window is not None:
                add(index - 1, rungs[index - 1].reached_back(window))
        return cls(tuple(held), tuple(pulled))


@dataclass(frozen=True)
class _Scope:
    """What of some planes has to be looked at.

    Attributes
    ----------
    route : _Route
    felt : Window
        Where intensities move the distance, or, if no gradient is wanted, where they differ.
    least : float
        The least of the image's intensities there.
    low, high : float
        The least and largest intensity of both images where they differ.
    """

    route: _Route
    felt: Window
    least: float = -math.inf
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class InnerComparison:
    """One inner scale, its operators, and the reference's CDFs there."""

    scales: ScaleSpace
    sigma: float
    blur: GaussianBlur
    intensity: Array  # the reference's, above the padding; shape (N, h, w)
    rungs: tuple[GaussianBlur, ...]
    extents: tuple[_Extent, ...]
    planes: int  # how many planes are handled together
    levels: dict[float, list[_Levels]]  # by tonal scale, those that are handled together

    @classmethod
    def of(cls, scales: ScaleSpace, plan: InnerPlan, tonal: tuple[TonalPlan, ...], reference: Array) -> InnerComparison:
        """Everything that depends on the reference alone: planes within the bounds, shape (N, H, W)."""
        blur = GaussianBlur(plan.blur, reference)
        intensity = blur.apply(_above_padding(reference, scales))
        most, planes = _chunk(max(each.last for each in tonal), reference.shape[0], plan.finest, reference)
        levels = {each.beta: _split(scales, each, most, intensity) for each in tonal}
        rungs = tuple(GaussianBlur(rung, reference) for rung in plan.rungs)
        extents = tuple(
            _Extent(extent.alpha, extent.rung, GaussianBlur(extent.blur, reference)) for extent in plan.extents
        )
        return cls(scales, plan.sigma, blur, intensity, rungs, extents, planes, levels)

    def add(self, clipped: Array, terms: Terms, *, gradient: bool) -> Array | None:
        """Add the terms of planes within the bounds, shape (N, H, W); their cotangent by the planes if asked for."""
        xp = namespace(clipped)
        intensity = self.blur.apply(_above_padding(clipped, self.scales))
        cotangents = []
        for start in range(0, intensity.shape[0], self.planes):
            part = slice(start, min(start + self.planes, intensity.shape[0]))
            cotangents.append(self._compare(intensity[part, ...], part, terms, gradient=gradient))
        if not gradient:
            return None
        return self.blur.adjoint(cotangents[0] if len(cotangents) == 1 else xp.concat(cotangents, axis=0))

    def _compare(self, intensity: Array, part: slice, terms: Terms, *, gradient: bool) -> Array | None:
        """Add the terms of some planes, shape (N, h, w); their cotangent by `intensity`.

        A few levels at a time, so that what is at work stays small and near.
        """
        xp = namespace(intensity)
        scope = self._scope(intensity, self.intensity[part, ...], gradient=gradient)
        if scope is None:
            return xp.zeros_like(intensity) if gradient else None
        held, felt = scope.route.held[0], scope.felt
        seen = felt.crop(intensity)
        cotangent = xp.zeros_like(seen) if gradient else None
        for beta, groups in self.levels.items():
            positions, width, mass = _in_levels(seen, self.scales, beta)
            tie = tie_threshold(intensity, mass)
            per_intensity = 1.0 / self.scales.spacing(beta)
            below, above = self._margins(beta, epsilon(intensity))
            cdf_sum = slope_sum = None
            for group in groups:
                levels = group.within(scope.least - below, scope.low - below, scope.high + above)
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
                difference = held.crop(cdf[levels.skipped :, ...], felt)
                difference -= held.crop(levels.cdf[:, part, ...])
                pulled = self._compare_levels(difference, scope.route, beta, tie, terms, gradient=gradient)
                if gradient:
                    pulled *= slope[levels.skipped :, ...]
                    cotangent += xp.sum(pulled, axis=0) * per_intensity
        return felt.paste(cotangent, *intensity.shape[-2:]) if gradient else None

    def _margins(self, beta: float, eps: float) -> tuple[float, float]:
        """How far below and above all intensities a level is a tie, in units of intensity.

        Below, a CDF holds tails only. Above, it holds all of the total, which is the same for every intensity up to
        the ripple of a sum of samples about an integral, 2 exp(-2 (pi beta / spacing)**2): 5e-9 for levels beta apart.
        """
        margin = reach(eps) * beta
        ripple = 2.0 * math.exp(-2.0 * (math.pi * beta / self.scales.spacing(beta)) ** 2)
        return margin, margin if ripple <= eps else math.inf

    def _scope(self, intensity: Array, reference: Array, *, gradient: bool) -> _Scope | None:
        """What of some planes has to be looked at; None if nothing does."""
        whole = Window.whole(*intensity.shape[-2:])
        if not values_may_decide(intensity):
            return _Scope(_Route.of(whole, self.rungs, self.extents), whole)
        differing = window_of(intensity != reference)
        if differing is None:
            return None
        if differing.cells > WORTHWHILE * whole.cells:
            differing = whole
        route = _Route.of(differing, self.rungs, self.extents)
        felt = route.pulled[0] if gradient else None
        felt = differing if felt is None else felt
        if self.scales.p != 1.0:
            return _Scope(route, felt)  # a small power of what counts as a tie is not small
        xp = namespace(intensity)
        seen, wanted = differing.crop(intensity), differing.crop(reference)
        low, high = min(float(xp.min(seen)), float(xp.min(wanted))), max(float(xp.max(seen)), float(xp.max(wanted)))
        return _Scope(route, felt, min(low, float(xp.min(felt.crop(intensity)))), low, high)

    def _compare_levels(
        self, difference: Array, route: _Route, beta: float, tie: float, terms: Terms, *, gradient: bool
    ) -> Array | None:
        """Add the terms of a difference of CDFs, shape (L, N, h, w); the cotangent by it.

        Blurring and accumulating commute, so the difference is blurred once instead of each histogram.
        """
        scales = self.scales
        rungs = [difference]
        for rung, window in zip(self.rungs, route.held, strict=False):
            rungs.append(rung.apply(rungs[-1], window))
        pulled: list[Array | None] = [None] * len(rungs)

        def pull(index: int, part: Array, window: Window) -> None:
            total, wanted = pulled[index], route.pulled[index]
            pulled[index] = part if wanted is None else _plus(total, wanted, part, window)

        for extent in self.extents:
            window = route.held[extent.rung]
            blurred = extent.blur.apply(rungs[extent.rung], window)
            weight = scales.scale_weight * scales.level_weight(beta) / (self.intensity.shape[0] * extent.cells)
            slope = cost_slope(blurred, scales.p, tie, weight)
            terms[extent.alpha, beta, self.sigma] += sum_of_costs(blurred, slope, scales.p)
            if gradient:
                reached = extent.blur.reached(window)
                back = extent.blur.adjoint(slope, reached)
                pull(extent.rung, back, extent.blur.reached_back(reached))
        if not gradient:
            return None
        for index in range(len(self.rungs), 0, -1):
            part, wanted = pulled[index], route.pulled[index]
            if part is not None and wanted is not None:
                rung = self.rungs[index - 1]
                pull(index - 1, rung.adjoint(part, wanted), rung.reached_back(wanted))
        return pulled[0]


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
    positions, width, mass = _in_levels(intensity, scales, plan.beta)
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


def _above_padding(clipped: Array, scales: ScaleSpace) -> Array:
    """Planes within the bounds, less what lies outside of them: so 0 lies there."""
    return clipped if scales.padding == 0.0 else clipped - scales.padding


def _in_levels(intensity: Array, scales: ScaleSpace, beta: float) -> tuple[Array, float, float]:
    """Intensities above the padding, tonal scale and mass of a level, in units of the distance of two levels."""
    spacing = scales.spacing(beta)
    first = float(scales.levels(beta)[0]) - scales.padding
    positions = level_positions(intensity, first, spacing, scales.level_count(beta))
    return positions, beta / spacing, scales.mass(beta) / spacing


def _chunk(levels: int, planes: int, cells: int, like: Array) -> tuple[int, int]:
    """How many levels of how many planes to handle together, so that they fit the cache, or at least the memory."""
    elements = CHUNK_ON_HOST if runs_eagerly_on_host(like) else CHUNK
    if levels * cells <= elements:
        return levels, max(1, min(planes, elements // (levels * cells)))
    return max(1, elements // cells), 1

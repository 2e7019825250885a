"""The objective of the paper: local histograms, compared at three scales."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.arrays import Array, epsilon, from_numpy, namespace, runs_eagerly_on_host, widened
from loi_core.distance import cost_slope, sum_of_costs, tie_threshold
from loi_core.errors import OptionError, ScaleError
from loi_core.nonfinite import NanPolicy
from loi_core.objectives.base import Evaluation, ImageObjective
from loi_core.operators import Blur, GaussianBlur
from loi_core.plan import InnerPlan, Plan, TonalPlan, make_plan
from loi_core.scales import ScaleSpace
from loi_core.tonal import accumulate, clip, clip_pullback, level_positions, level_weights, weights_and_slopes
from loi_core.values import real_number

__all__ = ["ACCURACIES", "LOIObjective", "ScaleKey", "gradient_tolerance"]

ScaleKey = tuple[float, float, float]

CHUNK_ON_HOST: Final = 2**20  # elements: 4 MiB in float32, a few of which lie in the caches of a core
CHUNK: Final = 2**24  # elements: where operations are fused or run on an accelerator, large ones are better

ACCURACIES: Final = {"exact": 0.0, "balanced": 1e-2, "fast": 5e-2}


def gradient_tolerance(accuracy: str | float) -> float:
    """The relative gradient error that `accuracy` allows: of "exact" 0, "balanced" 1e-2, "fast" 5e-2.

    Raises
    ------
    OptionError
        For another name, or a number that is not in [0, 1).
    """
    if isinstance(accuracy, str) and accuracy in ACCURACIES:
        return ACCURACIES[accuracy]
    number = real_number(accuracy)
    if 0.0 <= number < 1.0:
        return number
    names = ", ".join(map(repr, ACCURACIES))
    msg = f"`accuracy` must be one of {names}, or a relative error in [0, 1), got {accuracy!r:.60}"
    raise OptionError(msg)


@dataclass(frozen=True)
class _Levels:
    """Some levels of one tonal scale, the first few only accumulated, and the reference's CDF at the others.

    All is in units of the distance of two levels: see :func:`loi_core.tonal.level_positions`.
    """

    values: Array
    skipped: int
    cdf: Array  # shape (L, N, h, w)


@dataclass(frozen=True)
class _Extent:
    alpha: float
    rung: int
    blur: Blur


@dataclass(frozen=True)
class _Inner:
    """The operators of one inner scale and the reference's CDFs there."""

    sigma: float
    blur: Blur
    rungs: tuple[Blur, ...]
    extents: tuple[_Extent, ...]
    total: int  # planes, over which the terms are averaged
    planes: int  # how many planes are handled together
    levels: dict[float, list[_Levels]]  # by tonal scale, those that are handled together

    @classmethod
    def of(cls, scales: ScaleSpace, plan: InnerPlan, tonal: tuple[TonalPlan, ...], clipped: Array) -> _Inner:
        blur = GaussianBlur(plan.blur, clipped)
        total = clipped.shape[0]
        intensity = blur.apply(clipped)
        most, planes = _chunk(max(each.last for each in tonal), total, plan.finest, clipped)
        levels = {each.beta: _split(scales, each, most, intensity) for each in tonal}
        extents = tuple(
            _Extent(extent.alpha, extent.rung, GaussianBlur(extent.blur, clipped)) for extent in plan.extents
        )
        rungs = tuple(GaussianBlur(rung, clipped) for rung in plan.rungs)
        return cls(plan.sigma, blur, rungs, extents, total, planes, levels)


@dataclass(frozen=True)
class _Prepared:
    """The operators and the reference, by inner scale."""

    inner: tuple[_Inner, ...]


def _split(scales: ScaleSpace, plan: TonalPlan, most: int, intensity: Array) -> list[_Levels]:
    """The levels of one tonal scale, at most so many together, and the CDF of the reference's `intensity` there."""
    values = from_numpy(np.arange(plan.last, dtype=np.float64), intensity)
    positions, beta, mass = _in_levels(scales, plan.beta, intensity)
    running = None
    parts = []
    for start in range(0, plan.last, most):
        stop = min(start + most, plan.last)
        skipped = min(max(plan.first, start), stop) - start
        part = values[start:stop]
        cdf, running = accumulate(level_weights(positions, part, beta, mass), running)
        parts.append(_Levels(part, skipped, namespace(cdf).asarray(cdf[skipped:, ...], copy=True)))
    return parts


def _relative(planes: Array, scales: ScaleSpace) -> Array:
    """Intensities, clipped to the bounds, less the padding, so that 0 is what lies outside."""
    clipped = clip(planes, *scales.bounds)
    return clipped if scales.padding == 0.0 else clipped - scales.padding


def _in_levels(scales: ScaleSpace, beta: float, intensity: Array) -> tuple[Array, float, float]:
    """Intensities less the padding, tonal scale and mass of a level, in units of the distance of two levels."""
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


class LOIObjective(ImageObjective[_Prepared, ScaleKey]):
    """The distance between the locally orderless images of a render and a reference (eqs. 1 to 5).

    Every pixel becomes a soft histogram of the intensities around it, at inner scale sigma, tonal scale beta and
    extent alpha. Histograms are compared by the Wasserstein distance of order `p`, averaged over pixels and
    channels, and summed over scales. Unlike a difference of pixels it has a gradient where nothing overlaps.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        What the image should look like. Real floating point; see :class:`ImageObjective`.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default.
    accuracy : {"exact", "balanced", "fast"} or float
        Largest relative error of the gradient that is allowed in exchange for time: 0, 1e-2, 5e-2, or the number
        given; in the 2-norm, beside "exact". :meth:`plan` says what is done with it. At every accuracy the gradient is
        the exact derivative of the value.
    channel_axis : int or None
        Where the channels are; None for images without channels.
    nan_policy : {"raise", "mask"}
        What happens to pixels that are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> reference = np.zeros((32, 32, 1)); reference[20:24, 20:24] = 1.0
    >>> image = np.zeros((32, 32, 1)); image[4:8, 4:8] = 1.0
    >>> objective = LOIObjective(reference, ScaleSpace(sigma=1, alpha=(1, 5), beta=0.125))
    >>> value, gradient = objective.value_and_grad(image)
    >>> gradient.shape
    (32, 32, 1)
    """

    def __init__(
        self,
        reference: Array,
        scales: ScaleSpace | None = None,
        accuracy: str | float = "exact",
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
    ) -> None:
        super().__init__(reference, channel_axis=channel_axis, nan_policy=nan_policy)
        if scales is None:
            scales = ScaleSpace.for_image(self._reference_layout.height, self._reference_layout.width)
        if not isinstance(scales, ScaleSpace):
            msg = f"`scales` must be a ScaleSpace, got {type(scales).__name__}"
            raise ScaleError(msg)
        self._scales = scales
        self._tolerance = gradient_tolerance(accuracy)

    @property
    def scales(self) -> ScaleSpace:
        """The scales that are compared."""
        return self._scales

    @property
    def tolerance(self) -> float:
        """The relative error of the gradient that `accuracy` allows."""
        return self._tolerance

    def terms(self, image: Array) -> dict[ScaleKey, Array]:
        """What each scale adds to the value: ``{(alpha, beta, sigma): 0-d array}``; they sum to the value."""
        return super().terms(image)

    def plan(self, height: int | None = None, width: int | None = None, *, eps: float | None = None) -> Plan:
        """What is computed for each scale, at which cost and error; ``print`` shows it.

        Parameters
        ----------
        height, width : int, optional
            Size of the images; the reference's by default.
        eps : float, optional
            Machine epsilon of the images' dtype; the reference's by default.
        """
        layout = self._reference_layout
        return make_plan(
            self._scales,
            layout.height if height is None else height,
            layout.width if width is None else width,
            tolerance=self._tolerance,
            eps=epsilon(widened(self._reference)) if eps is None else eps,
        )

    def _prepare(self, reference: Array) -> _Prepared:
        scales = self._scales
        height, width = reference.shape[-2:]
        plan = self.plan(height, width, eps=epsilon(reference))
        clipped = _relative(reference, scales)
        return _Prepared(tuple(_Inner.of(scales, inner, plan.tonal, clipped) for inner in plan.inner))

    def _evaluate(self, planes: Array, prepared: _Prepared, *, gradient: bool) -> Evaluation[ScaleKey]:
        scales = self._scales
        xp = namespace(planes)
        clipped = _relative(planes, scales)
        terms: dict[ScaleKey, Array] = {}
        total = xp.zeros_like(planes) if gradient else None
        for inner in prepared.inner:
            intensity = inner.blur.apply(clipped)
            cotangents = []
            for start in range(0, intensity.shape[0], inner.planes):
                part = range(start, min(start + inner.planes, intensity.shape[0]))
                cotangent = self._compare(intensity[part.start : part.stop, ...], inner, part, terms, gradient=gradient)
                cotangents.append(cotangent)
            if gradient:
                cotangent = cotangents[0] if len(cotangents) == 1 else xp.concat(cotangents, axis=0)
                total += inner.blur.adjoint(cotangent)
        if gradient:
            total = clip_pullback(planes, total, *scales.bounds)
        return Evaluation({key: terms[key] for key in scales.keys}, total)

    def _compare(
        self, intensity: Array, inner: _Inner, part: range, terms: dict[ScaleKey, Array], *, gradient: bool
    ) -> Array | None:
        """Add the terms (eq. 5) of some planes at one inner scale, shape (N, h, w); their cotangent by `intensity`.

        A few levels at a time, so that what is at work stays small and near.
        """
        scales = self._scales
        xp = namespace(intensity)
        cotangent = xp.zeros_like(intensity) if gradient else None
        for beta, parts in inner.levels.items():
            positions, width, mass = _in_levels(scales, beta, intensity)
            tie = tie_threshold(intensity, mass)
            per_intensity = 1.0 / scales.spacing(beta)
            cdf_sum = slope_sum = None
            for levels in parts:
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
                difference = cdf[levels.skipped :, ...]
                difference -= levels.cdf[:, part.start : part.stop, ...]
                pulled = self._compare_levels(difference, inner, beta, tie, terms, gradient=gradient)
                if gradient:
                    pulled *= slope[levels.skipped :, ...]
                    cotangent += xp.sum(pulled, axis=0) * per_intensity
        return cotangent

    def _compare_levels(
        self, difference: Array, inner: _Inner, beta: float, tie: float, terms: dict[ScaleKey, Array], *, gradient: bool
    ) -> Array | None:
        """Add the terms of a difference of CDFs, shape (L, N, h, w); the cotangent by it.

        Blurring and accumulating commute, so the difference is blurred once instead of each histogram.
        """
        scales = self._scales
        rungs = [difference]
        for rung in inner.rungs:
            rungs.append(rung.apply(rungs[-1]))
        pulled: list[Array | None] = [None] * len(rungs)
        for extent in inner.extents:
            blurred = extent.blur.apply(rungs[extent.rung])
            weight = scales.scale_weight * scales.level_weight(beta) / (inner.total * math.prod(blurred.shape[-2:]))
            key = (extent.alpha, beta, inner.sigma)
            slope = cost_slope(blurred, scales.p, tie, weight)
            term = sum_of_costs(blurred, slope, scales.p)
            terms[key] = terms[key] + term if key in terms else term
            if gradient:
                back = extent.blur.adjoint(slope)
                pulled[extent.rung] = _plus(pulled[extent.rung], back)
        if not gradient:
            return None
        for index in range(len(inner.rungs), 0, -1):
            if pulled[index] is not None:
                pulled[index - 1] = _plus(pulled[index - 1], inner.rungs[index - 1].adjoint(pulled[index]))
        return pulled[0]


def _plus(total: Array | None, part: Array) -> Array:
    if total is None:
        return part
    total += part
    return total

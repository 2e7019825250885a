"""The objective of the paper: local histograms, compared at three scales."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from loi_core.arrays import Array, from_numpy, namespace
from loi_core.distance import cost, cost_slope, tie_threshold
from loi_core.errors import OptionError, ScaleError
from loi_core.nonfinite import NanPolicy
from loi_core.objectives.base import Evaluation, ImageObjective
from loi_core.operators import Blur, blur_about, gaussian_blur
from loi_core.scales import ScaleSpace
from loi_core.tonal import clip, clip_pullback, soft_cdf, soft_cdf_and_slope
from loi_core.values import real_number

__all__ = ["ACCURACIES", "LOIObjective", "ScaleKey", "gradient_tolerance"]

ScaleKey = tuple[float, float, float]

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
class _Prepared:
    """The reference's CDFs and the operators of every scale."""

    levels: dict[float, Array]
    inner: dict[float, Blur]
    extent: dict[float, Blur]
    cdf: dict[tuple[float, float], Array]  # by (beta, sigma); shape (L, N, H, W)


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
        given. Every accuracy is served by exact operators so far, so all of them keep the promise.
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

    def _prepare(self, reference: Array) -> _Prepared:
        scales = self._scales
        height, width = reference.shape[-2:]
        levels = {beta: from_numpy(scales.levels(beta), reference) for beta in scales.beta}
        inner = {
            sigma: gaussian_blur(height, width, sigma, scales.boundary, like=reference, taps=scales.inner_taps)
            for sigma in scales.sigma
        }
        extent = {
            alpha: gaussian_blur(height, width, alpha, scales.boundary, like=reference, taps=scales.extent_taps)
            for alpha in scales.alpha
        }
        clipped = clip(reference, *scales.bounds)
        cdf = {}
        for sigma in scales.sigma:
            intensity = blur_about(inner[sigma], clipped, scales.padding)
            for beta in scales.beta:
                cdf[beta, sigma] = soft_cdf(intensity, levels[beta], beta, scales.mass(beta))
        return _Prepared(levels, inner, extent, cdf)

    def _evaluate(self, planes: Array, prepared: _Prepared, *, gradient: bool) -> Evaluation[ScaleKey]:
        scales = self._scales
        xp = namespace(planes)
        clipped = clip(planes, *scales.bounds)
        terms: dict[ScaleKey, Array] = {}
        total = xp.zeros_like(planes) if gradient else None
        for sigma in scales.sigma:
            intensity = blur_about(prepared.inner[sigma], clipped, scales.padding)
            cotangent = xp.zeros_like(intensity) if gradient else None
            for beta in scales.beta:
                levels, mass = prepared.levels[beta], scales.mass(beta)
                if gradient:
                    cdf, slope = soft_cdf_and_slope(intensity, levels, beta, mass)
                else:
                    cdf, slope = soft_cdf(intensity, levels, beta, mass), None
                difference = cdf - prepared.cdf[beta, sigma]
                pulled = None
                for alpha in scales.alpha:
                    term, back = self._compare(difference, prepared.extent[alpha], beta, gradient=gradient)
                    terms[alpha, beta, sigma] = term
                    if gradient:
                        pulled = back if pulled is None else pulled + back
                if gradient:
                    cotangent = cotangent + xp.sum(pulled * slope, axis=0)
            if gradient:
                total = total + prepared.inner[sigma].adjoint(cotangent)
        if gradient:
            total = clip_pullback(planes, total, *scales.bounds)
        return Evaluation(terms, total)

    def _compare(self, difference: Array, extent: Blur, beta: float, *, gradient: bool) -> tuple[Array, Array | None]:
        """One term (eq. 5) of a difference of CDFs, shape (L, N, H, W), and its cotangent, before the extent blur.

        Blurring and accumulating commute, so the difference is blurred once instead of each histogram.
        """
        scales = self._scales
        xp = namespace(difference)
        blurred = extent.apply(difference)
        pixels = math.prod(blurred.shape[1:])
        weight = scales.scale_weight * scales.level_weight(beta) / pixels
        term = xp.sum(cost(blurred, scales.p)) * weight
        if not gradient:
            return term, None
        tie = tie_threshold(blurred, scales.mass(beta) / scales.spacing(beta))
        return term, extent.adjoint(cost_slope(blurred, scales.p, tie) * weight)

"""The structural baseline: multi-scale SSIM (Wang, Simoncelli and Bovik 2003), with its gradient in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from loi_core.errors import ImageError, OptionError
from loi_core.method.blurs import DenseBlur
from loi_core.method.gaussian import Matrix
from loi_core.objectives.base import ImageObjective
from loi_core.objectives.evaluation import Evaluation, PlaneComparison, ReferencePlanes
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.pixels.tone_curve import LogTone
from loi_core.support.arrays import Array, from_numpy, namespace
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import shown

__all__ = ["MSSSIM"]

LEVEL_EXPONENTS: Final = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # finest level first: section 3.2
WINDOW_TAPS: Final = 11
WINDOW_SIGMA: Final = 1.5  # standard deviation of the window, in pixels of its level
STABILISERS: Final = (0.01, 0.03)  # K1 and K2, in units of the range


@suggest_keywords
class MSSSIM(ImageObjective[str]):
    """One minus the multi-scale structural similarity, averaged over channels and batch; 0 for equal images.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        Real floating point; see :class:`ImageObjective`, as for `channel_axis`, `nan_policy`, `tone` and `weights`,
        which must be a mask.
    levels : int, optional
        1 (plain SSIM) to 5; by default as many as the size allows. The exponents of fewer than 5 are scaled to a sum
        of 1.
    data_range : float
        Difference of the largest and the smallest possible value.

    Raises
    ------
    ImageError
        If the images are smaller than a window, 11 pixels, or than 11 * 2**(levels - 1).

    Notes
    -----
    As published: Gaussian windows of 11 taps and 1.5 pixels that lie inside the image, means of 2 by 2 pixels from
    level to level (with a border of 0 where a side is odd, as other implementations do), luminance at the coarsest
    level only. A negative similarity of a level counts as 0; the product is then 0 too, and has no gradient.
    """

    def __init__(
        self,
        reference: Array,
        levels: int | None = None,
        data_range: float = 1.0,
        *,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        weights: Array | None = None,
    ) -> None:
        super().__init__(reference, channel_axis=channel_axis, nan_policy=nan_policy, tone=tone, weights=weights)
        shorter = min(self._reference_layout.height, self._reference_layout.width)
        if shorter < WINDOW_TAPS:
            msg = f"`reference` must have at least {WINDOW_TAPS} rows and columns for SSIM, got a side of {shorter}"
            raise ImageError(msg)
        max_levels = min(len(LEVEL_EXPONENTS), 1 + int(math.log2(shorter / WINDOW_TAPS)))
        count = max_levels if levels is None else whole_number(levels)
        if count is None or not 1 <= count <= max_levels:
            msg = f"`levels` must be a whole number from 1 to {max_levels} for this image size, got {levels!r}"
            raise OptionError(msg)
        extent = real_number(data_range)
        if not 0.0 < extent < math.inf:
            msg = f"`data_range` must be a finite number more than 0, got {shown(data_range)}"
            raise OptionError(msg)
        # All five exponents are used as published; their sum is 1.0001.
        total = 1.0 if count == len(LEVEL_EXPONENTS) else sum(LEVEL_EXPONENTS[:count])
        self._exponents = tuple(exponent / total for exponent in LEVEL_EXPONENTS[:count])
        luminance, contrast = ((constant * extent) ** 2 for constant in STABILISERS)
        self._stabilisers = _Stabilisers(luminance, contrast)

    def _facts(self) -> dict[str, str]:
        return super()._facts() | {"levels": str(len(self._exponents))}

    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[str]:
        """See :class:`loi_core.ImageObjective`."""
        levels: list[_Level] = []
        halvings: list[DenseBlur] = []
        planes = reference.planes
        for _ in self._exponents:
            if levels:
                halvings.append(_operator(_halving_matrix, planes))
                planes = halvings[-1].apply(planes)
            window = _operator(_window_matrix, planes)
            mean = window.apply(planes)
            levels.append(_Level(planes, window, mean, window.apply(planes * planes) - mean * mean))
        return _SimilarityComparison(tuple(levels), tuple(halvings), self._exponents, self._stabilisers)


class _Stabilisers(NamedTuple):
    """The constants C1 and C2 of SSIM."""

    luminance: float
    contrast: float


@dataclass(frozen=True, eq=False)
class _Similarity:
    """Similarity at one level, averaged over pixels, shape (N,), and its derivatives.

    The derivatives are those with respect to the local mean, mean square and mean product, shape (N, h, w).
    """

    mean: Array
    by_mean: Array
    by_square: Array
    by_product: Array


@dataclass(frozen=True, eq=False)
class _Level:
    """The reference at one level, with its local mean and variance."""

    reference: Array
    window: DenseBlur
    mean: Array
    variance: Array

    def compare(self, image: Array, stabilisers: _Stabilisers, *, luminance: bool) -> _Similarity:
        """Return the similarity of contrast and structure, times the similarity of luminance if requested."""
        xp = namespace(image)
        mean = self.window.apply(image)
        variance = self.window.apply(image * image) - mean * mean
        covariance = self.window.apply(image * self.reference) - mean * self.mean
        denominator = variance + self.variance + stabilisers.contrast
        similarity = (2.0 * covariance + stabilisers.contrast) / denominator
        by_variance, by_covariance = -similarity / denominator, 2.0 / denominator
        by_mean = -2.0 * mean * by_variance - self.mean * by_covariance
        if luminance:
            squares = mean * mean + self.mean * self.mean + stabilisers.luminance
            bright = (2.0 * mean * self.mean + stabilisers.luminance) / squares
            by_mean = bright * by_mean + similarity * 2.0 * (self.mean - bright * mean) / squares
            by_variance, by_covariance = bright * by_variance, bright * by_covariance
            similarity = similarity * bright
        return _Similarity(xp.mean(similarity, axis=(-2, -1)), by_mean, by_variance, by_covariance)


@dataclass(frozen=True, eq=False)
class _SimilarityComparison(PlaneComparison[str]):
    """The reference's levels, finest first, and the operators from each to the next."""

    levels: tuple[_Level, ...]
    halvings: tuple[DenseBlur, ...]
    exponents: tuple[float, ...]
    stabilisers: _Stabilisers

    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[str]:
        xp = namespace(planes)
        images = [planes]
        for halving in self.halvings:
            images.append(halving.apply(images[-1]))
        coarsest = len(images) - 1
        similarities = [
            level.compare(image, self.stabilisers, luminance=index == coarsest)
            for index, (image, level) in enumerate(zip(images, self.levels, strict=True))
        ]
        total = xp.ones_like(similarities[0].mean)
        for similarity, exponent in zip(similarities, self.exponents, strict=True):
            positive, mean = similarity.mean > 0.0, similarity.mean
            total = total * xp.where(positive, xp.where(positive, mean, total) ** exponent, xp.zeros_like(total))
        terms = {"1 - MS-SSIM": 1.0 - xp.mean(total)}
        if not gradient:
            return Evaluation(terms, None)
        cotangent = xp.zeros_like(images[-1])
        for index in range(coarsest, -1, -1):
            image, level, similarity = images[index], self.levels[index], similarities[index]
            mean = xp.where(similarity.mean > 0.0, similarity.mean, xp.ones_like(total))
            # The derivative of a product of powers with respect to one of its factors; 0 where the product is.
            slope = -self.exponents[index] * total / mean / total.shape[0]
            upstream = (slope / math.prod(level.mean.shape[-2:]))[:, None, None]
            cotangent = cotangent + level.window.adjoint(upstream * similarity.by_mean)
            cotangent = cotangent + 2.0 * image * level.window.adjoint(upstream * similarity.by_square)
            cotangent = cotangent + level.reference * level.window.adjoint(upstream * similarity.by_product)
            if index:
                cotangent = self.halvings[index - 1].adjoint(cotangent)
        return Evaluation(terms, cotangent)


def _operator(matrix: Callable[[int], Matrix], planes: Array) -> DenseBlur:
    """Return the operator that applies a matrix along rows and columns, for planes of this size, library and dtype."""
    rows, columns = (from_numpy(matrix(size), planes) for size in planes.shape[-2:])
    return DenseBlur(rows, columns)


def _window_matrix(size: int) -> Matrix:
    """Return the window at every position where it lies inside an axis, shape (size - 10, size)."""
    kernel = np.exp(-0.5 * ((np.arange(WINDOW_TAPS) - WINDOW_TAPS // 2) / WINDOW_SIGMA) ** 2)
    matrix = np.zeros((size - WINDOW_TAPS + 1, size))
    for offset, weight in enumerate(kernel / kernel.sum()):
        np.fill_diagonal(matrix[:, offset:], weight)
    return matrix


def _halving_matrix(size: int) -> Matrix:
    """Return the means of pairs of samples; an axis of odd length has a 0 at its start."""
    border = size % 2
    matrix = np.zeros(((size + border) // 2, size + border))
    for offset in range(2):
        matrix[np.arange(matrix.shape[0]), 2 * np.arange(matrix.shape[0]) + offset] = 0.5
    return matrix[:, border:]

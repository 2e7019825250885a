"""The structural baseline: multi-scale SSIM (Wang, Simoncelli and Bovik 2003), with its gradient in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.errors import ImageError, OptionError
from loi_core.method.blurs import DenseBlur
from loi_core.method.gaussian import Matrix
from loi_core.objectives.base import Evaluation, ImageObjective
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.pixels.tone_curve import LogTone
from loi_core.support.arrays import Array, from_numpy, namespace
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import shown

__all__ = ["MSSSIM"]

WEIGHTS: Final = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # of the levels, finest first: section 3.2
TAPS: Final = 11
WINDOW: Final = 1.5  # standard deviation of the window, in pixels of its level
STABILISERS: Final = (0.01, 0.03)  # K1 and K2, in units of the range


@dataclass(frozen=True)
class _Level:
    """The reference at one level, its local mean and variance."""

    reference: Array
    window: DenseBlur
    mean: Array
    variance: Array


@dataclass(frozen=True)
class _Prepared:
    """The levels, finest first, and the ways from each to the next."""

    levels: tuple[_Level, ...]
    halvings: tuple[DenseBlur, ...]


@dataclass(frozen=True)
class _Similarity:
    """Structure at one level, averaged over pixels, shape (N,), and what its derivative needs."""

    mean: Array
    by_mean: Array  # of the similarity by local mean, local square and local product, each (N, h, w)
    by_square: Array
    by_product: Array


class MSSSIM(ImageObjective[_Prepared, str]):
    """One less the multi-scale structural similarity, averaged over channels and batch; 0 for equal images.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        Real floating point; see :class:`ImageObjective`, as for `channel_axis`, `nan_policy`, `tone` and `weights`,
        which have to be a mask.
    levels : int, optional
        1 (plain SSIM) to 5; by default as many as the size allows. Fewer than 5 are weighted to a sum of 1.
    data_range : float
        Difference of the largest and the least possible value.

    Raises
    ------
    ImageError
        If the images are smaller than a window, 11 pixels, or than 11 * 2**(levels - 1).

    Notes
    -----
    As published: Gaussian windows of 11 taps and 1.5 pixels that lie inside the image, means of 2 by 2 pixels from
    level to level (with a rim of 0 where a side is odd, as others do), luminance at the coarsest level only.
    Where the similarity of a level is negative it counts as 0, and with it the whole, so that there is no gradient.
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
        if shorter < TAPS:
            msg = f"`reference` must have at least {TAPS} rows and columns for SSIM, got a side of {shorter}"
            raise ImageError(msg)
        most = min(len(WEIGHTS), 1 + int(math.log2(shorter / TAPS)))
        count = most if levels is None else whole_number(levels)
        if count is None or not 1 <= count <= most:
            msg = f"`levels` must be a whole number from 1 to {most} for this image size, got {levels!r}"
            raise OptionError(msg)
        extent = real_number(data_range)
        if not 0.0 < extent < math.inf:
            msg = f"`data_range` must be a finite number more than 0, got {shown(data_range)}"
            raise OptionError(msg)
        whole = 1.0 if count == len(WEIGHTS) else sum(WEIGHTS[:count])  # all five are used as published, sum 1.0001
        self._weights = tuple(weight / whole for weight in WEIGHTS[:count])
        self._luminance, self._contrast = ((constant * extent) ** 2 for constant in STABILISERS)

    def _facts(self) -> dict[str, str]:
        return super()._facts() | {"levels": str(len(self._weights))}

    def prepare_reference(self, reference: Array, weights: Array | None) -> _Prepared:  # noqa: ARG002  # masks only
        """See :class:`loi_core.ImageObjective`."""
        levels: list[_Level] = []
        halvings: list[DenseBlur] = []
        for _ in self._weights:
            if levels:
                halvings.append(_operator(_pairs, reference))
                reference = halvings[-1].apply(reference)
            window = _operator(_window, reference)
            mean = window.apply(reference)
            levels.append(_Level(reference, window, mean, window.apply(reference * reference) - mean * mean))
        return _Prepared(tuple(levels), tuple(halvings))

    def compare_planes(self, planes: Array, prepared: _Prepared, *, gradient: bool) -> Evaluation[str]:
        """See :class:`loi_core.ImageObjective`."""
        xp = namespace(planes)
        images = [planes]
        for halving in prepared.halvings:
            images.append(halving.apply(images[-1]))
        coarsest = len(images) - 1
        found = [
            self._similarity(image, level, luminance=index == coarsest)
            for index, (image, level) in enumerate(zip(images, prepared.levels, strict=True))
        ]
        total = xp.ones_like(found[0].mean)
        for one, weight in zip(found, self._weights, strict=True):
            positive = one.mean > 0.0
            total = total * xp.where(positive, xp.where(positive, one.mean, total) ** weight, xp.zeros_like(total))
        terms = {"1 - MS-SSIM": 1.0 - xp.mean(total)}
        if not gradient:
            return Evaluation(terms, None)
        cotangent = xp.zeros_like(images[-1])
        for index in range(coarsest, -1, -1):
            image, level, one = images[index], prepared.levels[index], found[index]
            positive = one.mean > 0.0
            # The derivative of a product of powers by one of its factors; 0 where the product is.
            weight = -self._weights[index] * total / xp.where(positive, one.mean, xp.ones_like(total)) / total.shape[0]
            upstream = (weight / math.prod(level.mean.shape[-2:]))[:, None, None]
            cotangent = cotangent + level.window.adjoint(upstream * one.by_mean)
            cotangent = cotangent + 2.0 * image * level.window.adjoint(upstream * one.by_square)
            cotangent = cotangent + level.reference * level.window.adjoint(upstream * one.by_product)
            if index:
                cotangent = prepared.halvings[index - 1].adjoint(cotangent)
        return Evaluation(terms, cotangent)

    def _similarity(self, image: Array, level: _Level, *, luminance: bool) -> _Similarity:
        """Contrast and structure, at the coarsest level times luminance."""
        xp = namespace(image)
        mean = level.window.apply(image)
        variance = level.window.apply(image * image) - mean * mean
        covariance = level.window.apply(image * level.reference) - mean * level.mean
        below = variance + level.variance + self._contrast
        similarity = (2.0 * covariance + self._contrast) / below
        by_variance, by_covariance = -similarity / below, 2.0 / below
        by_mean = -2.0 * mean * by_variance - level.mean * by_covariance
        if luminance:
            spread = mean * mean + level.mean * level.mean + self._luminance
            bright = (2.0 * mean * level.mean + self._luminance) / spread
            by_mean = bright * by_mean + similarity * 2.0 * (level.mean - bright * mean) / spread
            by_variance, by_covariance = bright * by_variance, bright * by_covariance
            similarity = similarity * bright
        return _Similarity(xp.mean(similarity, axis=(-2, -1)), by_mean, by_variance, by_covariance)


def _operator(matrix: Callable[[int], Matrix], planes: Array) -> DenseBlur:
    """The same matrix for rows and columns, for planes of this size, library, dtype and device."""
    rows, columns = (from_numpy(matrix(size), planes) for size in planes.shape[-2:])
    return DenseBlur(rows, columns)


def _window(size: int) -> Matrix:
    """The window at every place where it lies inside an axis, shape (size - 10, size)."""
    kernel = np.exp(-0.5 * ((np.arange(TAPS) - TAPS // 2) / WINDOW) ** 2)
    matrix = np.zeros((size - TAPS + 1, size))
    for offset, weight in enumerate(kernel / kernel.sum()):
        np.fill_diagonal(matrix[:, offset:], weight)
    return matrix


def _pairs(size: int) -> Matrix:
    """Means of two neighbours; an axis of odd length has a 0 at its start."""
    rim = size % 2
    matrix = np.zeros(((size + rim) // 2, size + rim))
    for side in range(2):
        matrix[np.arange(matrix.shape[0]), 2 * np.arange(matrix.shape[0]) + side] = 0.5
    return matrix[:, rim:]

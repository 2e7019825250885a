"""The loss map of each scale, and the local histograms that it compares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from loi_core.io.images import FloatImage
from loi_core.method.blurs import GaussianBlur, gaussian_blur
from loi_core.method.comparison import ScaleKey
from loi_core.method.distance import TIE_ROUNDINGS
from loi_core.method.gaussian import AxisBlur, AxisGrid, Matrix
from loi_core.method.plan import InnerPlan
from loi_core.method.planner import make_plan
from loi_core.method.reference import DOUBLE, cost
from loi_core.method.scales import ScaleSpace
from loi_core.method.tonal import level_weights, to_level_units
from loi_core.pixels.bounds import above_padding

__all__ = ["histograms_at", "loss_maps"]


def loss_maps(image: FloatImage, reference: FloatImage, scales: ScaleSpace) -> dict[ScaleKey, FloatImage]:
    """Return the distance of eq. 5 at every pixel for every scale; its mean is the contribution to the loss.

    Parameters
    ----------
    image, reference : array, shape (H, W, C), float64
    scales : ScaleSpace

    Returns
    -------
    dict
        ``{(alpha, beta, sigma): array, shape (H, W)}``, the mean over channels.
    """
    height, width, channels = image.shape
    plan = make_plan(scales, height, width, tolerance=0.0, eps=DOUBLE)
    maps = {key: np.zeros((height, width)) for key in scales.keys}
    for inner in plan.inner:
        blur = GaussianBlur(inner.blur, image)
        for channel in range(channels):
            first, second = (
                blur.apply(above_padding(scales.intensity_range.apply(array[..., channel]), scales.padding))
                for array in (image, reference)
            )
            for beta in scales.beta:
                tie = TIE_ROUNDINGS * DOUBLE * scales.mass(beta) / scales.spacing(beta)
                weight = scales.scale_weight * scales.level_weight(beta) / channels
                for alpha, blurred in _blurred(_differences(first, second, scales, beta), inner):
                    # A plan may compare a constant in a single cell, which then counts for every pixel.
                    maps[alpha, beta, inner.sigma] += weight * cost(np.abs(blurred), scales.p, tie)
    return maps


def histograms_at(
    image: FloatImage, scales: ScaleSpace, sigma: float, beta: float, rows: Sequence[int], columns: Sequence[int]
) -> FloatImage:
    """Return local histograms (eq. 4) where some rows and columns cross, for every extent.

    Parameters
    ----------
    image : array, shape (H, W, C), float64
    scales : ScaleSpace
    sigma, beta : float
        One of its inner and one of its tonal scales.
    rows, columns : sequence of int
        Pixels.

    Returns
    -------
    array, shape (extents, C, levels, rows, columns), float64
        Fractions of a histogram. Over levels they sum to 1, up to the mass beyond the tails.
    """
    height, width, channels = image.shape
    inner = gaussian_blur(height, width, sigma, scales.boundary, like=image, taps=scales.inner_taps)
    vertical = np.concatenate([_blur_matrix(height, alpha, scales)[list(rows)] for alpha in scales.alpha])
    horizontal = np.stack([_blur_matrix(width, alpha, scales)[list(columns)].T for alpha in scales.alpha])
    histograms = np.empty((len(scales.alpha), channels, scales.level_count(beta), len(rows), len(columns)))
    for channel in range(channels):
        plane = inner.apply(above_padding(scales.intensity_range.apply(image[..., channel]), scales.padding))
        for level, weights in enumerate(_weights_by_level(plane, scales, beta)):
            strips = (vertical @ weights).reshape(len(scales.alpha), len(rows), width)
            histograms[:, channel, level] = strips @ horizontal
    return histograms


def _weights_by_level(plane: FloatImage, scales: ScaleSpace, beta: float) -> Iterator[FloatImage]:
    """Yield the weight of each pixel in every level, one level at a time to save memory."""
    positions, width, mass = to_level_units(plane, scales, beta)
    for level in range(scales.level_count(beta)):
        yield level_weights(positions, np.array([float(level)]), width, mass)[0]


def _differences(first: FloatImage, second: FloatImage, scales: ScaleSpace, beta: float) -> Iterator[FloatImage]:
    """Yield the difference of two cumulative histograms level by level, without levels where it is 0 everywhere."""
    running = np.zeros_like(first), np.zeros_like(second)
    pairs = zip(_weights_by_level(first, scales, beta), _weights_by_level(second, scales, beta), strict=True)
    for weights in pairs:
        running = running[0] + weights[0], running[1] + weights[1]
        difference = running[0] - running[1]
        if np.any(difference):
            yield difference


def _blurred(differences: Iterator[FloatImage], plan: InnerPlan) -> Iterator[tuple[float, FloatImage]]:
    """Yield each difference at every extent, through the pyramid of a plan."""
    pyramid = [GaussianBlur(step, np.empty(0)) for step in plan.pyramid]
    extents = [(extent.alpha, extent.start, GaussianBlur(extent.blur, np.empty(0))) for extent in plan.extents]
    for difference in differences:
        levels = [difference]
        for step in pyramid:
            levels.append(step.apply(levels[-1]))
        for alpha, start, blur in extents:
            yield alpha, blur.apply(levels[start])


def _blur_matrix(size: int, alpha: float, scales: ScaleSpace) -> Matrix:
    pixels = AxisGrid(size, size)
    return AxisBlur(pixels, pixels, alpha, scales.boundary, scales.extent_taps).matrix()

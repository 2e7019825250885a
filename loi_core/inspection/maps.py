"""Where each scale finds two images different, what it asks for, and the histograms that it compares."""

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
from loi_core.method.tonal import in_levels, level_weights
from loi_core.pixels.bounds import above_padding, clip

__all__ = ["histograms_at", "loss_maps"]


def loss_maps(image: FloatImage, reference: FloatImage, scales: ScaleSpace) -> dict[ScaleKey, FloatImage]:
    """The distance of eq. 5 at every pixel, for every scale; its mean over pixels is what the scale adds to the loss.

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
            ours, theirs = (
                blur.apply(above_padding(clip(each[..., channel], *scales.bounds), scales.padding))
                for each in (image, reference)
            )
            for beta in scales.beta:
                tie = TIE_ROUNDINGS * DOUBLE * scales.mass(beta) / scales.spacing(beta)
                weight = scales.scale_weight * scales.level_weight(beta) / channels
                for alpha, blurred in _blurred(_differences(ours, theirs, scales, beta), inner):
                    # A plan may compare what is flat in one cell, which counts for every pixel.
                    maps[alpha, beta, inner.sigma] += weight * cost(np.abs(blurred), scales.p, tie)
    return maps


def histograms_at(
    image: FloatImage, scales: ScaleSpace, sigma: float, beta: float, rows: Sequence[int], columns: Sequence[int]
) -> FloatImage:
    """Local histograms (eq. 4) at the crossings of some rows and columns, for every extent.

    Parameters
    ----------
    image : array, shape (H, W, C), float64
    scales : ScaleSpace
    sigma, beta : float
        One of its inner and of its tonal scales.
    rows, columns : sequence of int
        Pixels.

    Returns
    -------
    array, shape (extents, C, levels, rows, columns), float64
        Shares of a histogram: over levels they sum to 1, up to what lies beyond the tails.
    """
    height, width, channels = image.shape
    inner = gaussian_blur(height, width, sigma, scales.boundary, like=image, taps=scales.inner_taps)
    upright = [_rows_of_blur(height, alpha, scales)[list(rows)] for alpha in scales.alpha]
    across = np.stack([_rows_of_blur(width, alpha, scales)[list(columns)].T for alpha in scales.alpha])
    stacked = np.concatenate(upright)
    found = np.empty((len(scales.alpha), channels, scales.level_count(beta), len(rows), len(columns)))
    for channel in range(channels):
        plane = inner.apply(above_padding(clip(image[..., channel], *scales.bounds), scales.padding))
        for level, share in enumerate(_shares(plane, scales, beta)):
            strips = (stacked @ share).reshape(len(scales.alpha), len(rows), width)
            found[:, channel, level] = strips @ across
    return found


def _shares(plane: FloatImage, scales: ScaleSpace, beta: float) -> Iterator[FloatImage]:
    """How much of each pixel every level has, level by level, so that few planes are in memory."""
    positions, width, mass = in_levels(plane, scales, beta)
    for level in range(scales.level_count(beta)):
        yield level_weights(positions, np.array([float(level)]), width, mass)[0]


def _differences(ours: FloatImage, theirs: FloatImage, scales: ScaleSpace, beta: float) -> Iterator[FloatImage]:
    """The difference of two cumulative histograms, level by level; levels where there is none are left out."""
    running = np.zeros_like(ours), np.zeros_like(theirs)
    for shares in zip(_shares(ours, scales, beta), _shares(theirs, scales, beta), strict=True):
        running = running[0] + shares[0], running[1] + shares[1]
        difference = running[0] - running[1]
        if np.any(difference):
            yield difference


def _blurred(differences: Iterator[FloatImage], plan: InnerPlan) -> Iterator[tuple[float, FloatImage]]:
    """Each difference at every extent, through the pyramid of a plan."""
    pyramid = [GaussianBlur(step, np.empty(0)) for step in plan.pyramid]
    extents = [(extent.alpha, extent.start, GaussianBlur(extent.blur, np.empty(0))) for extent in plan.extents]
    for difference in differences:
        stack = [difference]
        for step in pyramid:
            stack.append(step.apply(stack[-1]))
        for alpha, start, blur in extents:
            yield alpha, blur.apply(stack[start])


def _rows_of_blur(size: int, alpha: float, scales: ScaleSpace) -> Matrix:
    pixels = AxisGrid(size, size)
    return AxisBlur(pixels, pixels, alpha, scales.boundary, scales.extent_taps).matrix()

"""The pictures of the page as arrays in [0, 1]: colours of a loss, isophotes, tonal levels."""

from __future__ import annotations

from typing import Final

import numpy as np

from loi_core.io.images import FloatImage
from loi_core.method.blurs import blur_about, gaussian_blur
from loi_core.method.scales import ScaleSpace
from loi_core.method.tonal import isophote_density
from loi_core.pixels.display import robust_maximum
from loi_core.support.arrays import Host

__all__ = ["inner_image", "isophote_lines", "loss_colours", "reduced", "tonal_image"]

INFERNO: Final = (
    "000004 0b0724 210c4a 3d0965 57106e 71196e 8a226a a32c61 bc3754 "
    "d24644 e45a31 f1731d f98e09 fcac11 f9cb35 f2ea69 fcffa4"
)
"""Colours at equal distances along Matplotlib's map "inferno"."""

LINE_SHADES: Final = 3  # between no line and its middle: smooth lines of few colours
LINE_HALF_WIDTH_PX: Final = 0.7
MIN_SLOPE: Final = 1e-3  # in beta per pixel; flatter pixels have no lines


def reduced(image: FloatImage, max_side: int) -> FloatImage:
    """Return an image, shape (H, W) or (H, W, C), averaged so that its longer side is at most `max_side`."""
    from PIL import Image

    height, width = image.shape[:2]
    if max(height, width) <= max_side:
        return image
    factor = max_side / max(height, width)
    size = max(1, round(factor * width)), max(1, round(factor * height))
    planes = np.moveaxis(image[..., None] if image.ndim == 2 else image, -1, 0)
    small = [Image.fromarray(plane.astype(np.float32)).resize(size, Image.Resampling.BOX) for plane in planes]
    result = np.stack([np.asarray(plane, dtype=np.float64) for plane in small], axis=-1)
    return result[..., 0] if image.ndim == 2 else result


def loss_colours(loss: FloatImage) -> FloatImage:
    """Return a loss map, shape (H, W), as colours: black at 0, then red and orange, pale yellow at its maximum."""
    stops = np.array([list(bytes.fromhex(colour)) for colour in INFERNO.split()]) / 255.0
    maximum = robust_maximum(loss)
    relative = loss / maximum if maximum > 0.0 else loss
    positions = np.linspace(0.0, 1.0, len(stops))
    return np.stack([np.interp(relative, positions, channel) for channel in stops.T], axis=-1)


def inner_image(image: FloatImage, scales: ScaleSpace, sigma: float) -> FloatImage:
    """Return an image, shape (H, W, C), at an inner scale (eq. 1)."""
    planes = np.moveaxis(scales.intensity_range.apply(image), -1, 0)
    height, width = image.shape[:2]
    blur = gaussian_blur(height, width, sigma, scales.boundary, like=image, taps=scales.inner_taps)
    return np.moveaxis(blur_about(blur, planes, scales.padding), 0, -1)


def isophote_lines(inner: FloatImage, levels: Host, beta: float, max_side: int) -> FloatImage:
    """Return lines of equal intensity, shape (H, W, C), each channel in its own colour.

    Parameters
    ----------
    inner : array, shape (h, w, C)
        An image at an inner scale.
    levels : array
        The intensities of the lines.
    beta : float
        The tonal scale.
    max_side : int
        A smaller image is enlarged by a whole factor, to a longer side of at most `max_side`.
    """
    image = _enlarged(inner, max(1, max_side // max(inner.shape[:2])))
    down, right = (np.gradient(image, axis=axis) if image.shape[axis] > 1 else np.zeros_like(image) for axis in (0, 1))
    slope = np.hypot(down, right)
    difference = np.min(np.abs(image[..., None] - levels), axis=-1)
    distance_px = difference / np.maximum(slope, MIN_SLOPE * beta)
    lines = np.where(slope > MIN_SLOPE * beta, np.clip(LINE_HALF_WIDTH_PX + 0.5 - distance_px, 0.0, 1.0), 0.0)
    shaded: FloatImage = np.rint(LINE_SHADES * lines) / LINE_SHADES
    return shaded


def tonal_image(inner: FloatImage, level: float, beta: float) -> FloatImage:
    """Return the density of one tonal level in an inner image, shape (H, W, C) (eq. 3), relative to its peak."""
    density = isophote_density(inner, np.array([level]), beta)[0]
    peak = isophote_density(np.zeros(1), np.zeros(1), beta)[0, 0]
    relative: FloatImage = density / peak
    return relative


def _enlarged(image: FloatImage, factor: int) -> FloatImage:
    """Return an image, shape (H, W, C), with `factor` times as many pixels along each side, interpolated linearly."""
    if factor == 1:
        return image
    for axis in (0, 1):
        size = image.shape[axis]
        position = np.clip((np.arange(factor * size) + 0.5) / factor - 0.5, 0.0, size - 1.0)
        lower = np.minimum(np.floor(position).astype(int), max(0, size - 2))
        weight = np.expand_dims(position - lower, tuple({0, 1, 2} - {axis}))
        image = (1.0 - weight) * image.take(lower, axis) + weight * image.take(np.minimum(lower + 1, size - 1), axis)
    return image

"""The pictures of the page: arrays as images that a browser shows, and curves as SVG."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from loi_core.inspection.reach import Reach
from loi_core.io.images import FloatImage
from loi_core.method.blurs import blur_about, gaussian_blur
from loi_core.method.scales import ScaleSpace
from loi_core.method.tonal import isophote_density
from loi_core.pixels.bounds import clip
from loi_core.pixels.signed import brightest
from loi_core.support.arrays import Host

__all__ = [
    "curve",
    "encoded",
    "fitted",
    "inner_image",
    "isophote_lines",
    "loss_colours",
    "tones",
]

JPEG_QUALITY: Final = 90
JPEG_SAVES: Final = 0.6  # a JPEG is taken if it is smaller than this part of the PNG
MOST_COLOURS: Final = 256  # of a palette
SHADES: Final = 3  # of a line beside its middle, so that it is smooth and its colours are few
LINE: Final = 0.7  # half the width of a line, in pixels of the picture
FLATTEST: Final = 1e-3  # slope that has lines, in beta a pixel


def encoded(image: Host) -> str:
    """An image in [0, 1], shape (H, W, 1) or (H, W, 3), as a data URI: PNG, or JPEG if that is much smaller."""
    from PIL import Image

    values = np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
    picture = _palette(values) if values.shape[2] == 3 else Image.fromarray(values[..., 0])
    streams = {"png": io.BytesIO(), "jpeg": io.BytesIO()}
    picture.save(streams["png"], format="PNG", optimize=True)
    picture.convert("RGB").save(streams["jpeg"], format="JPEG", quality=JPEG_QUALITY, subsampling=0)
    sizes = {kind: len(stream.getvalue()) for kind, stream in streams.items()}
    kind = "jpeg" if sizes["jpeg"] < JPEG_SAVES * sizes["png"] else "png"
    return f"data:image/{kind};base64,{base64.b64encode(streams[kind].getvalue()).decode('ascii')}"


def _palette(values: Host) -> Any:
    """An image of bytes, shape (H, W, 3), with a palette if it has few enough colours for one, as lines have."""
    from PIL import Image

    coded = values.astype(np.uint32) @ np.array([2**16, 2**8, 1], dtype=np.uint32)
    colours, indices = np.unique(coded, return_inverse=True)
    if len(colours) > MOST_COLOURS:
        return Image.fromarray(values)
    picture = Image.fromarray(indices.reshape(coded.shape).astype(np.uint8), mode="P")
    picture.putpalette(np.stack([colours >> 16, colours >> 8, colours], axis=-1).astype(np.uint8).ravel().tolist())
    return picture


def fitted(image: FloatImage, longest: int) -> FloatImage:
    """An image, shape (H, W) or (H, W, C), averaged so that its longer side has `longest` pixels at most."""
    from PIL import Image

    height, width = image.shape[:2]
    if max(height, width) <= longest:
        return image
    share = longest / max(height, width)
    size = max(1, round(share * width)), max(1, round(share * height))
    planes = image[..., None] if image.ndim == 2 else image
    parts = [
        Image.fromarray(np.ascontiguousarray(planes[..., index], dtype=np.float32)).resize(size, Image.Resampling.BOX)
        for index in range(planes.shape[2])
    ]
    result = np.stack([np.asarray(part, dtype=np.float64) for part in parts], axis=-1)
    return result[..., 0] if image.ndim == 2 else result


def loss_colours(loss: FloatImage) -> FloatImage:
    """A map of losses, shape (H, W), as colours from black at 0 over red and orange to pale yellow at its brightest."""
    from matplotlib import colormaps

    most = brightest(loss)
    shown = loss / most if most > 0.0 else loss
    colours: FloatImage = colormaps["inferno"](np.clip(shown, 0.0, 1.0))[..., :3]
    return colours


def inner_image(image: FloatImage, scales: ScaleSpace, sigma: float) -> FloatImage:
    """An image, shape (H, W, C), at an inner scale (eq. 1)."""
    planes = np.moveaxis(clip(image, *scales.bounds), -1, 0)
    height, width = image.shape[:2]
    blur = gaussian_blur(height, width, sigma, scales.boundary, like=image, taps=scales.inner_taps)
    return np.moveaxis(blur_about(blur, planes, scales.padding), 0, -1)


def isophote_lines(inner: FloatImage, levels: Host, beta: float, side: int) -> FloatImage:
    """Lines of equal intensity, shape (H, W, C), each channel's in its own colour.

    Parameters
    ----------
    inner : array, shape (h, w, C)
        An image at an inner scale.
    levels : array
        Intensities that have a line.
    beta : float
        The tonal scale.
    side : int
        Images with a smaller longer side are drawn larger, by a whole factor up to it.
    """
    image = _enlarged(inner, max(1, side // max(inner.shape[:2])))
    down, right = (np.gradient(image, axis=axis) if image.shape[axis] > 1 else np.zeros_like(image) for axis in (0, 1))
    slope = np.hypot(down, right)
    nearest = np.min(np.abs(image[..., None] - levels), axis=-1)
    away = nearest / np.maximum(slope, FLATTEST * beta)
    lines = np.where(slope > FLATTEST * beta, np.clip(LINE + 0.5 - away, 0.0, 1.0), 0.0)
    shaded: FloatImage = np.rint(SHADES * lines) / SHADES
    return shaded


def tones(inner: FloatImage, level: float, beta: float) -> FloatImage:
    """How much of each pixel of an inner image, shape (H, W, C), has one tonal level (eq. 3); 1 at the level itself."""
    density = isophote_density(inner, np.array([level]), beta)[0]
    peak = isophote_density(np.zeros(1), np.zeros(1), beta)[0, 0]
    shares: FloatImage = density / peak
    return shares


def curve(distances: Sequence[float], values: Sequence[float], rise: Reach) -> str:
    """The loss against the distance, as SVG, with a line where it ceases to rise."""
    width, height, top = 240.0, 90.0, 8.0
    most = max(values) or 1.0
    across = [width * one / distances[-1] for one in distances]
    up = [height - (height - top) * one / most for one in values]
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across, up, strict=True))
    end = min(width, width * rise.distance / distances[-1])
    return (
        f'<svg class="curve" viewBox="-2 0 {width + 4:g} {height + 2:g}" aria-hidden="true">'
        f'<rect class="felt" x="0" y="0" width="{end:.1f}" height="{height:g}"/>'
        f'<path class="axis" d="M0 {height:g}H{width:g}"/><polyline points="{points}"/></svg>'
    )


def _enlarged(image: FloatImage, factor: int) -> FloatImage:
    """An image, shape (H, W, C), with `factor` times as many pixels a side, linear between the old ones."""
    if factor == 1:
        return image
    for axis in (0, 1):
        size = image.shape[axis]
        place = np.clip((np.arange(factor * size) + 0.5) / factor - 0.5, 0.0, size - 1.0)
        low = np.minimum(np.floor(place).astype(int), max(0, size - 2))
        part = np.expand_dims(place - low, tuple({0, 1, 2} - {axis}))
        image = (1.0 - part) * image.take(low, axis) + part * image.take(np.minimum(low + 1, size - 1), axis)
    return image

"""Thumbnails of images of any library, layout and range, for notebooks."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from loi_core.io.images import png_bytes
from loi_core.pixels.display import Display
from loi_core.pixels.layout import guessed_channel_axis
from loi_core.support.arrays import Array, Host, to_numpy
from loi_core.support.repr_html import picture

__all__ = ["thumbnail"]

MAX_SIDE_PX: Final = 160


def thumbnail(image: Array, caption: str, channel_axis: int | str | None = "unknown") -> str:
    """Return a small picture of an image as HTML; empty if the array cannot be shown.

    Parameters
    ----------
    image : array, shape (*batch, H, W, C)
        The first image of a batch is shown.
    caption : str
    channel_axis : int, None or "unknown"
        The axis of the channels. "unknown" looks for an axis of 1, 3 or 4 entries, last or third from last.
    """
    from PIL import Image

    pixels = _as_rgb(image, channel_axis)
    if pixels is None:
        return ""
    size = pixels.shape[1], pixels.shape[0]
    stride = max(1, max(size) // (4 * MAX_SIDE_PX))  # large images, or memory maps, are not read whole
    sampled = np.asarray(pixels[::stride, ::stride])
    sampled = sampled / np.iinfo(sampled.dtype).max if sampled.dtype.kind == "u" else sampled
    small = Image.fromarray(np.rint(255.0 * Display.of(sampled, None).show(sampled)).astype(np.uint8))
    small.thumbnail((MAX_SIDE_PX, MAX_SIDE_PX), Image.Resampling.BOX)
    return picture(png_bytes(np.asarray(small) / 255.0), size, caption)


def _as_rgb(image: Array, channel_axis: int | str | None) -> Host | None:
    """Return an image as RGB, shape (H, W, 3), its values unchanged; None if the array cannot be shown."""
    pixels: np.ndarray[Any, Any] = np.asarray(to_numpy(image))
    axis = guessed_channel_axis(pixels.shape) if channel_axis == "unknown" else channel_axis
    if axis == "unknown" or pixels.ndim < (2 if axis is None else 3) or not pixels.size:
        return None
    pixels = pixels[..., None] if axis is None else np.moveaxis(pixels, int(axis), -1)
    pixels = pixels[(0,) * (pixels.ndim - 3)]
    # A display has neither two nor many channels: the first is shown.
    return np.repeat(pixels[..., :1], 3, axis=-1) if pixels.shape[-1] < 3 else pixels[..., :3]

"""Small pictures of images of any library, layout and range, for notebooks and logs."""

from __future__ import annotations

import io
from typing import Any, Final

import numpy as np

from loi_core.pixels.display import Display
from loi_core.support.arrays import Array, Host, to_numpy
from loi_core.support.html import picture

__all__ = ["pictured", "shown_pixels"]

MOST: Final = 160  # pixels of the longer side
CHANNELS: Final = (1, 3, 4)


def pictured(image: Array, caption: str, channel_axis: int | str | None = "unknown") -> str:
    """An image as HTML, no larger than a thumb; nothing if it is none that could be shown.

    Parameters
    ----------
    image : array, shape (*batch, H, W, C)
        Of a batch, the first is shown.
    caption : str
    channel_axis : int, None or "unknown"
        Where the channels are; if that is unknown, where there are 1, 3 or 4 of something, at the end or before the
        last two axes.
    """
    from PIL import Image

    pixels = shown_pixels(image, channel_axis)
    if pixels is None:
        return ""
    size = pixels.shape[1], pixels.shape[0]
    step = max(1, max(size) // (4 * MOST))  # what is far too large, or a memory map, is not read whole
    few = np.asarray(pixels[::step, ::step])
    few = few / np.iinfo(few.dtype).max if few.dtype.kind == "u" else few
    small = Image.fromarray(np.rint(255.0 * Display.of(few, None).show(few)).astype(np.uint8))
    small.thumbnail((MOST, MOST), Image.Resampling.BOX)
    stream = io.BytesIO()
    small.save(stream, format="PNG")
    return picture(stream.getvalue(), size, caption)


def shown_pixels(image: Array, channel_axis: int | str | None = "unknown") -> Host | None:
    """An image as RGB, shape (H, W, 3), its values as they are; None if it is none that could be shown.

    Parameters are those of :func:`pictured`.
    """
    pixels: np.ndarray[Any, Any] = np.asarray(to_numpy(image))
    axis = _channels(pixels.shape) if channel_axis == "unknown" else channel_axis
    if axis == "unknown" or pixels.ndim < (2 if axis is None else 3) or not pixels.size:
        return None
    pixels = pixels[..., None] if axis is None else np.moveaxis(pixels, int(axis), -1)
    pixels = pixels[(0,) * (pixels.ndim - 3)]
    # Of two channels, or many, which no display has, the first is shown.
    return np.repeat(pixels[..., :1], 3, axis=-1) if pixels.shape[-1] < 3 else pixels[..., :3]


def _channels(shape: tuple[int, ...]) -> int | str | None:
    if len(shape) == 2:
        return None
    if len(shape) > 2 and shape[-1] in CHANNELS:
        return -1
    if len(shape) > 2 and shape[-3] in CHANNELS:
        return -3
    return "unknown"

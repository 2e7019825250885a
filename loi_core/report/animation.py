"""The frames of a fit as one animated picture."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from typing import Final

__all__ = ["animation"]

MILLISECONDS: Final = 120  # for a frame
LAST: Final = 1500  # for the last one
WIDE: Final = 384  # pixels: smaller pictures are enlarged by a whole number
MOST_PIXELS: Final = 2**24  # of all frames together


def animation(frames: Sequence[bytes]) -> bytes:
    """PNGs of one size as a WebP that repeats; empty if they are less than two, not of one size, or too large."""
    from PIL import Image

    images = []
    try:
        for frame in frames:
            with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(frame), formats=["PNG"]) as stored:
                if stored.size[0] * stored.size[1] * len(frames) > MOST_PIXELS:
                    return b""
                images.append(stored.convert("RGB"))
    except Exception:  # noqa: BLE001 - decoders raise what they like on damaged files
        return b""
    if len(images) < 2 or len({image.size for image in images}) > 1:
        return b""
    width, height = images[0].size
    larger = max(1, WIDE // width)
    while larger > 1 and larger**2 * width * height * len(images) > MOST_PIXELS:
        larger -= 1
    if larger > 1:
        images = [image.resize((larger * width, larger * height), Image.Resampling.NEAREST) for image in images]
    stream = io.BytesIO()
    images[0].save(
        stream,
        format="WEBP",
        save_all=True,
        append_images=images[1:],
        duration=[*[MILLISECONDS] * (len(images) - 1), LAST],
        loop=0,
        lossless=larger > 1,
        quality=80 if larger == 1 else 20,
        method=0,  # the fastest: a sweep makes many
    )
    return stream.getvalue()

"""The recorded steps of a fit as an animated picture."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from typing import Final

__all__ = ["animation"]

FRAME_MS: Final = 120
LAST_FRAME_MS: Final = 1500
MIN_WIDTH: Final = 384  # pixels; narrower frames are enlarged by a whole factor
MAX_PIXELS: Final = 2**24  # of all frames together


def animation(frames: Sequence[bytes]) -> bytes:
    """Return PNGs as a WebP that repeats; empty if there are fewer than two, or their sizes differ or are too large."""
    from PIL import Image

    images = []
    try:
        for frame in frames:
            with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(frame), formats=["PNG"]) as stored:
                if stored.size[0] * stored.size[1] * len(frames) > MAX_PIXELS:
                    return b""
                images.append(stored.convert("RGB"))
    except Exception:  # noqa: BLE001 - decoders raise anything on damaged files
        return b""
    if len(images) < 2 or len({image.size for image in images}) > 1:
        return b""
    width, height = images[0].size
    factor = max(1, MIN_WIDTH // width)
    while factor > 1 and factor**2 * width * height * len(images) > MAX_PIXELS:
        factor -= 1
    images = [image.resize((factor * width, factor * height), Image.Resampling.NEAREST) for image in images]
    stream = io.BytesIO()
    images[0].save(
        stream,
        format="WEBP",
        save_all=True,
        append_images=images[1:],
        duration=[*[FRAME_MS] * (len(images) - 1), LAST_FRAME_MS],
        loop=0,
        lossless=factor > 1,
        quality=80 if factor == 1 else 20,
        method=0,  # the fastest: a sweep writes many reports
    )
    return stream.getvalue()

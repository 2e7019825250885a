"""Read EXR images within a size limit; OpenEXR itself decodes any size and skips damaged parts with a printed warning.

OpenEXR 3.5 did not crash in 6600 damaged files, so it decodes in this process.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.errors import ImageFileError

__all__ = ["read_exr"]

COLOURS: Final = (("R", "G", "B", "A"), ("R", "G", "B"), ("Y",))
BYTES_PER_PIXEL: Final = 16  # of all parts and channels: four of 32 bits, since headers read by OpenEXR lack the type


def read_exr(path: Path, max_pixels: int) -> np.ndarray[Any, Any]:
    """Return the first part of an EXR image with colours, shape (H, W, 3 or 4), or luminance, shape (H, W).

    Raises
    ------
    ImageFileError
        If the image is damaged or deep, has neither colours nor luminance, has a part of more than `max_pixels`, or
        all channels of all parts, which OpenEXR decodes together, take more than 16 bytes times that.
    """
    import OpenEXR  # here, since few programs read EXR

    with OpenEXR.File(str(path), header_only=True) as file:
        channels = [_check_part(path, image.header, max_pixels) for image in file.parts]
        bytes_decoded = sum(size for _, size in channels)
    if bytes_decoded > BYTES_PER_PIXEL * max_pixels:
        msg = f"{path}: its channels take more than the {BYTES_PER_PIXEL * max_pixels} bytes that are read"
        raise ImageFileError(msg)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        decoded = [{name: channel.pixels for name, channel in image.channels.items()} for image in file.parts]
    if [sorted(pixels) for pixels in decoded] != [names for names, _ in channels]:
        msg = f"{path}: not a readable EXR image, its pixels are damaged"
        raise ImageFileError(msg)
    for pixels in decoded:
        for layout in COLOURS:
            if pixels.keys() >= set(layout):
                return np.stack([pixels[name] for name in layout], axis=-1) if len(layout) > 1 else pixels[layout[0]]
    listed = ", ".join(sorted({name for names, _ in channels for name in names}))
    msg = f"{path}: an EXR image must have the channels R, G, B or Y, it has {listed}"
    raise ImageFileError(msg)


def _check_part(path: Path, header: dict[str, Any], max_pixels: int) -> tuple[list[str], int]:
    """Return the sorted names of a part's channels and the bytes that they take decoded."""
    import OpenEXR

    if header["type"] in (OpenEXR.deepscanline, OpenEXR.deeptile):
        msg = f"{path}: deep EXR images are not read; flatten it first"
        raise ImageFileError(msg)
    (left, top), (right, bottom) = (map(int, corner) for corner in header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if width * height > max_pixels:
        msg = f"{path}: {width} x {height} pixels are more than the {max_pixels} that are read"
        raise ImageFileError(msg)
    tile = header["tiles"].xSize * header["tiles"].ySize if "tiles" in header else 0
    names = sorted(channel.name for channel in header["channels"])
    return names, max(width * height, tile) * 4 * len(names)

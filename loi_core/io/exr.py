"""Reading EXR images, of which the OpenEXR library alone would take any: too large ones, and damaged ones in silence.

First the header is read here, since the library takes all the memory that a header asks for. Then the library decodes
the pixels in a process of its own, since it goes on after damaged pixels and only prints that there were some.

The layout of the header is that of the OpenEXR file format, version 2: a magic number, the version with flags, and for
each part a list of attributes (name, type, size, value) that an empty name ends; after several parts comes one more.
"""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.errors import ImageFileError
from loi_core.io.exr_decoder import NO_COLOUR
from loi_core.io.files import open_regular
from loi_core.support.wording import printable

__all__ = ["read_exr"]

MAGIC: Final = b"\x76\x2f\x31\x01"
SEVERAL_PARTS: Final = 0x1000
DEEP: Final = 0x800
MOST_HEADER: Final = 2**24  # bytes; a preview and many notes fit in
LONGEST_NAME: Final = 255
MOST_ATTRIBUTES: Final = 4096  # of all parts; the library takes time that grows with their square
SAMPLE_SIZES: Final = {0: 4, 1: 2, 2: 4}  # bytes of unsigned integers, halves and floats
SECONDS: Final = 600.0


@dataclass(frozen=True)
class _Part:
    width: int
    height: int
    channels: tuple[str, ...]
    memory: int  # bytes of all channels once decoded, or of one tile if that is more


def read_exr(path: Path, most_pixels: int) -> np.ndarray[Any, Any]:
    """The first part of an EXR image that has colours, shape (H, W, 3 or 4), or brightness, shape (H, W).

    Raises
    ------
    ImageFileError
        If it is damaged, deep, has neither colours nor brightness, or a part has more than `most_pixels`, or all
        channels of all parts, each of which is decoded, take more than 16 bytes times that.
    """
    parts = _parts(path)
    for part in parts:
        if part.width * part.height > most_pixels:
            msg = f"{path}: {part.width} x {part.height} pixels are more than the {most_pixels} that are read"
            raise ImageFileError(msg)
    if sum(part.memory for part in parts) > 16 * most_pixels:
        msg = f"{path}: its channels take more than the {16 * most_pixels} bytes that are read; leave out some"
        raise ImageFileError(msg)
    with tempfile.TemporaryFile() as pixels:
        done = subprocess.run(  # noqa: S603 - our own file
            [sys.executable, "-P", str(Path(__file__).with_name("exr_decoder.py")), str(path)],
            stdin=subprocess.DEVNULL,
            stdout=pixels,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},  # what can be imported here can be there
            timeout=SECONDS,
            check=False,
        )
        if done.returncode not in (0, NO_COLOUR) or done.stderr:
            said = done.stderr.decode("utf-8", "replace").strip().splitlines() or [f"exit code {done.returncode}"]
            msg = f"{path}: not a readable EXR image ({printable(said[-1]):.300})"
            raise ImageFileError(msg)
        if done.returncode == NO_COLOUR:
            names = sorted({name for part in parts for name in part.channels})
            msg = f"{path}: an EXR image must have the channels R, G, B or Y, it has {', '.join(names)}"
            raise ImageFileError(msg)
        pixels.seek(0)
        array: np.ndarray[Any, Any] = np.load(pixels, allow_pickle=False)
        return array


def _parts(path: Path) -> list[_Part]:
    """What the header tells of each part."""
    with open_regular(path) as stream:
        content = stream.read(MOST_HEADER)
    if len(content) < 8 or not content.startswith(MAGIC):
        msg = f"{path}: not a readable EXR image, it begins otherwise"
        raise ImageFileError(msg)
    (version,) = struct.unpack_from("<I", content, 4)
    if version & DEEP:
        msg = f"{path}: deep EXR images are not read; flatten it first"
        raise ImageFileError(msg)
    try:
        return [_part(one) for one in _headers(content, several=bool(version & SEVERAL_PARTS))]
    except (struct.error, ValueError, KeyError, IndexError) as error:
        msg = f"{path}: not a readable EXR image, its header is damaged"
        raise ImageFileError(msg) from error


def _headers(content: bytes, *, several: bool) -> Iterator[dict[bytes, bytes]]:
    """The attributes of each part, by name."""
    place = 8
    count = 0
    while True:
        attributes: dict[bytes, bytes] = {}
        while True:
            name, place = _text(content, place)
            if not name:
                break
            _, place = _text(content, place)
            (size,) = struct.unpack_from("<i", content, place)
            place += 4
            count += 1
            if count > MOST_ATTRIBUTES:
                msg = "it has too many attributes"
                raise ValueError(msg)
            if not 0 <= size <= len(content) - place:
                msg = "an attribute is larger than the file"
                raise ValueError(msg)
            attributes[name] = content[place : place + size]
            place += size
        if attributes:
            yield attributes
        if not several or not attributes:
            return


def _text(content: bytes, place: int) -> tuple[bytes, int]:
    end = content.index(b"\0", place, place + LONGEST_NAME + 1)
    return content[place:end], end + 1


def _part(attributes: dict[bytes, bytes]) -> _Part:
    left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if width < 1 or height < 1:
        msg = "the data window is empty"
        raise ValueError(msg)
    channels = list(_channels(attributes[b"channels"]))
    area = width * height
    if b"tiles" in attributes:
        across, down = struct.unpack_from("<2I", attributes[b"tiles"])
        area = max(area, across * down)
    return _Part(width, height, tuple(name for name, _ in channels), area * sum(size for _, size in channels))


def _channels(listed: bytes) -> Iterator[tuple[str, int]]:
    """Names of the channels, and bytes of one sample of each."""
    place = 0
    while listed[place]:
        name, place = _text(listed, place)
        kind, _, _, _ = struct.unpack_from("<iIii", listed, place)
        place += 16
        yield name.decode("utf-8", "replace"), SAMPLE_SIZES[kind]

"""Damaged image files, and small image files that claim to be huge."""

from __future__ import annotations

import functools
import io
import pickle
import random
import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

from loi_core.io.images import read_image
from tests.fuzz.claims import Call, Marked
from tests.fuzz.damage import damaged
from tests.helpers import Host

__all__ = ["bombs", "exr_with_window", "exrs", "jpegs", "npys", "png_chunk", "pngs", "whole_exr"]

COMPRESSIONS = (
    *(OpenEXR.NO_COMPRESSION, OpenEXR.RLE_COMPRESSION, OpenEXR.ZIPS_COMPRESSION, OpenEXR.ZIP_COMPRESSION),
    *(OpenEXR.PIZ_COMPRESSION, OpenEXR.PXR24_COMPRESSION, OpenEXR.B44_COMPRESSION, OpenEXR.B44A_COMPRESSION),
    *(OpenEXR.DWAA_COMPRESSION, OpenEXR.DWAB_COMPRESSION),
)
DTYPES = ("<f8", ">f8", "<f4", ">f2", "|u1", "<u2", "<i8", "|b1", "<c16", "<U3", "|O", "|S0", "|V0", "<M8[s]")
LENGTHS = (0, 1, 2, 3, 4, 7, -1, 2**31, 2**62, 2**63, 10**30, 8192, 65537, True, "'a'", 1.5, "1" * 5000)


def reading(path: Path, content: bytes) -> Call:
    """Return a call that reads an image file with this content."""
    path.write_bytes(content)

    def read() -> str:
        image = read_image(path)
        assert image.dtype == np.float64
        assert image.ndim == 3
        assert image.shape[2] in (3, 4)
        return "an image"

    return read


def _pixels(rng: random.Random, channels: int) -> Host:
    size = (rng.randint(1, 40), rng.randint(1, 40), channels)
    return np.random.default_rng(rng.getrandbits(32)).integers(0, 256, size, dtype=np.uint8)


def pngs(rng: random.Random, folder: Path) -> Call:
    """Damaged PNGs, half of them with right checksums."""
    stream = io.BytesIO()
    Image.fromarray(_pixels(rng, 3)).convert(rng.choice(("1", "L", "LA", "P", "RGB", "RGBA"))).save(stream, "PNG")
    content = stream.getvalue()
    if rng.random() < 0.5:
        return reading(folder / "image.png", damaged(rng, content))
    chunks, start = [], 8
    while start < len(content):
        (size,) = struct.unpack_from(">I", content, start)
        chunks.append((content[start + 4 : start + 8], content[start + 8 : start + 8 + size]))
        start += size + 12
    index = rng.randrange(len(chunks))
    chunks[index] = (chunks[index][0], damaged(rng, chunks[index][1], 2))
    return reading(folder / "image.png", content[:8] + b"".join(png_chunk(*chunk) for chunk in chunks))


def png_chunk(name: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG with its checksum."""
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def jpegs(rng: random.Random, folder: Path) -> Call:
    """Damaged JPEGs."""
    picture = Image.fromarray(_pixels(rng, 3)).convert(rng.choice(("L", "RGB", "CMYK")))
    stream = io.BytesIO()
    picture.save(stream, format="JPEG", progressive=rng.random() < 0.5, quality=rng.choice((30, 95)))
    return reading(folder / "image.jpg", damaged(rng, stream.getvalue()))


@functools.cache
def whole_exr(number: int) -> bytes:
    """Return an EXR file of any compression and channels, in scan lines or tiles, with one or two parts."""
    rng = random.Random(number)  # noqa: S311 - nothing is secret
    header = {"compression": COMPRESSIONS[number % len(COMPRESSIONS)], "type": OpenEXR.scanlineimage}
    if rng.random() < 0.4:
        header |= {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    size, noise = (rng.randint(1, 40), rng.randint(1, 40)), np.random.default_rng(number)
    channels = {
        name: noise.random((*size, *depth)).astype(rng.choice((np.float32, np.float16)))
        for name, depth in rng.choice(([("RGB", (3,))], [("RGBA", (4,))], [("Y", ())], [("RGB", (3,)), ("Z", ())]))
    }
    exr_parts = [
        OpenEXR.Part(dict(header), dict(channels), name) for name in ("first", "second")[: rng.choice((1, 1, 2))]
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "whole.exr"
        with OpenEXR.File(exr_parts) as file:
            file.write(str(path))
        return path.read_bytes()


def exrs(rng: random.Random, folder: Path) -> Call:
    """Damaged EXRs."""
    return reading(folder / "image.exr", damaged(rng, whole_exr(rng.randrange(200))))


def exr_with_window(content: bytes, height: int, width: int) -> bytes:
    """Return an EXR whose windows claim another size."""
    changed, start = bytearray(content), content.find(b"box2i\0")
    while start >= 0:
        changed[start + 10 : start + 26] = struct.pack("<4i", 0, 0, width - 1, height - 1)
        start = content.find(b"box2i\0", start + 1)
    return bytes(changed)


def npys(rng: random.Random, folder: Path) -> Call:
    """NPY files with any header, with pickles, or damaged."""
    if rng.random() < 0.15:
        stream = io.BytesIO()
        np.save(stream, np.array([[Marked(folder)]], dtype=object), allow_pickle=True)
        return reading(folder / "image.npy", rng.choice((stream.getvalue(), pickle.dumps(Marked(folder)))))
    if rng.random() < 0.4:
        shape = ", ".join(str(rng.choice(LENGTHS)) for _ in range(rng.randint(0, 5)))
        header = f"{{'descr': '{rng.choice(DTYPES)}', 'fortran_order': {rng.random() < 0.5}, 'shape': ({shape},)}}"
        length = struct.pack("<H", rng.choice((len(header), len(header), 65535, 0)) % 65536)
        content = b"\x93NUMPY\x01\x00" + length + header.encode() + bytes(rng.choice((0, 8, 480, 4096)))
        return reading(folder / "image.npy", content)
    stream = io.BytesIO()
    np.save(
        stream, _pixels(rng, rng.choice((1, 2, 3, 4))).astype(rng.choice(("<f8", ">f8", "<f4", "<f2", "u1", ">u2")))
    )
    return reading(folder / "image.npy", damaged(rng, stream.getvalue()))


def bombs(rng: random.Random, folder: Path) -> Call:
    """Small files that claim to be huge."""
    height, width = (rng.choice((5, 5, 9000, 13000, 50000, 65500, 2**20, 2**31 - 1)) for _ in range(2))
    suffix = rng.choice(("png", "jpeg", "exr"))
    if suffix == "png":
        header = struct.pack(">IIBBBBB", width, height, 8, rng.choice((0, 2, 6)), 0, 0, rng.choice((0, 1)))
        chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(bytes(2**20))), (b"IEND", b"")]
        content = b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in chunks)
        return reading(folder / "image.png", content)
    if suffix == "jpeg":
        stream = io.BytesIO()
        Image.fromarray(_pixels(rng, 3)).save(stream, format="JPEG", progressive=True)
        changed = bytearray(stream.getvalue())
        start = changed.index(b"\xff\xc2")
        changed[start + 5 : start + 9] = struct.pack(">HH", height % 65536, width % 65536)
        return reading(folder / "image.jpg", bytes(changed))
    return reading(folder / "image.exr", exr_with_window(whole_exr(rng.randrange(20)), height, width))

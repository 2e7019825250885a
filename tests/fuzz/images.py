"""Image files that are not what they say, and images that ask for more than there is."""

from __future__ import annotations

import functools
import io
import pickle
import random
import struct
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image

from loi_core.io.images import read_image
from tests.fuzz.claims import Call, marked
from tests.fuzz.damage import damaged
from tests.helpers import Host

__all__ = ["bombs", "exrs", "jpegs", "npys", "pngs"]


def reading(path: Path) -> Call:
    def read() -> str:
        image = read_image(path)
        assert image.dtype == np.float64
        assert image.ndim == 3
        assert image.shape[2] in (3, 4)
        return "an image"

    return read


def _file(rng: random.Random, folder: Path, suffix: str, content: bytes) -> Call:
    path = folder / f"image{suffix}"
    path.write_bytes(content)
    return reading(path)


def _pixels(rng: random.Random, channels: int) -> Host:
    size = (rng.randint(1, 40), rng.randint(1, 40), channels)
    return np.random.default_rng(rng.getrandbits(32)).integers(0, 256, size, dtype=np.uint8)


def pngs(rng: random.Random, folder: Path) -> Call:
    mode = rng.choice(("1", "L", "LA", "P", "RGB", "RGBA", "I;16"))
    stream = io.BytesIO()
    if mode == "I;16":
        picture = Image.fromarray(_pixels(rng, 1)[..., 0].astype(np.uint16) * 257)
    else:
        picture = Image.fromarray(_pixels(rng, 3)).convert(mode)
    options = {"transparency": bytes(range(256))} if mode == "P" and rng.random() < 0.5 else {}
    picture.save(stream, format="PNG", **options)
    return _file(rng, folder, ".png", _png_damage(rng, stream.getvalue()))


def _png_damage(rng: random.Random, content: bytes) -> bytes:
    if rng.random() < 0.5:
        return damaged(rng, content)
    # Faults that the checksums do not tell: within a chunk, which is then sealed again.
    chunks, place = [], 8
    while place < len(content):
        (size,) = struct.unpack_from(">I", content, place)
        chunks.append((content[place + 4 : place + 8], content[place + 8 : place + 8 + size]))
        place += size + 12
    index = rng.randrange(len(chunks))
    chunks[index] = (chunks[index][0], damaged(rng, chunks[index][1], 2))
    if rng.random() < 0.2:
        extra = rng.choice((b"tRNS", b"PLTE", b"iCCP", b"zTXt", b"eXIf", b"acTL", b"fdAT", b"gAMA", b"IDAT"))
        chunks.insert(rng.randrange(len(chunks) + 1), (extra, rng.randbytes(rng.choice((0, 3, 8, 300)))))
    return content[:8] + b"".join(png_chunk(kind, data) for kind, data in chunks)


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def jpegs(rng: random.Random, folder: Path) -> Call:
    picture = Image.fromarray(_pixels(rng, 3)).convert(rng.choice(("L", "RGB", "CMYK")))
    exif = picture.getexif()
    exif[0x0112] = rng.choice((1, 3, 6, 8, 9, 0))
    stream = io.BytesIO()
    picture.save(stream, format="JPEG", exif=exif, progressive=rng.random() < 0.5, quality=rng.choice((30, 95)))
    return _file(rng, folder, rng.choice((".jpg", ".jpeg")), damaged(rng, stream.getvalue()))


COMPRESSIONS = (
    *(OpenEXR.NO_COMPRESSION, OpenEXR.RLE_COMPRESSION, OpenEXR.ZIPS_COMPRESSION, OpenEXR.ZIP_COMPRESSION),
    *(OpenEXR.PIZ_COMPRESSION, OpenEXR.PXR24_COMPRESSION, OpenEXR.B44_COMPRESSION, OpenEXR.B44A_COMPRESSION),
    *(OpenEXR.DWAA_COMPRESSION, OpenEXR.DWAB_COMPRESSION),
)


@functools.cache
def whole_exr(number: int) -> bytes:
    """One of a few hundred EXR files: every compression, several sets of channels, in scan lines or tiles."""
    rng = random.Random(number)  # noqa: S311
    dtype = rng.choice((np.float32, np.float16))
    size = rng.randint(1, 40), rng.randint(1, 40)
    noise = np.random.default_rng(number)
    smooth = rng.random() < 0.3
    header = {"compression": COMPRESSIONS[number % len(COMPRESSIONS)], "type": OpenEXR.scanlineimage}
    if rng.random() < 0.4:
        header["type"] = OpenEXR.tiledimage
        header["tiles"] = OpenEXR.TileDescription()
    channels = {
        name: np.ascontiguousarray((np.ones if smooth else noise.random)((*size, *depth)).astype(dtype))
        for name, depth in rng.choice(([("RGB", (3,))], [("RGBA", (4,))], [("Y", ())], [("RGB", (3,)), ("Z", ())]))
    }
    parts = [OpenEXR.Part(header, channels, "one")]
    if rng.random() < 0.3:
        parts.append(OpenEXR.Part(dict(header), dict(channels), "two"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "whole.exr"
        with OpenEXR.File(parts) as file:
            file.write(str(path))
        return path.read_bytes()


def exrs(rng: random.Random, folder: Path) -> Call:
    return _file(rng, folder, ".exr", damaged(rng, whole_exr(rng.randrange(200))))


DTYPES = (
    "<f8",
    ">f8",
    "<f4",
    ">f2",
    "|u1",
    "<u2",
    ">u2",
    "<i8",
    "|b1",
    "<c16",
    "<U3",
    "|O",
    "|S0",
    "|V0",
    "<M8[s]",
    "<f16",
)
DESCRIPTIONS = (
    "[('a', '<f8')]",
    "('<f8', (2, 3))",
    "'f8', 'f4'",
    "None",
    "[]",
    "'|O'",
    "'" + "x" * 9000 + "'",
    "1" * 9000,
)
SIDES = (0, 1, 2, 3, 4, 7, -1, 2**31, 2**32, 2**62, 2**63, 10**30, 8192, 65537, True, "'a'", 1.5, "1" * 5000)


def npys(rng: random.Random, folder: Path) -> Call:
    how = rng.random()
    if how < 0.15:
        stream = io.BytesIO()
        content = np.array([[marked(folder)]], dtype=object)
        np.save(stream, content, allow_pickle=True)
        raw = rng.choice((stream.getvalue(), pickle.dumps(marked(folder))))
        return _file(rng, folder, ".npy", damaged(rng, raw, 1))
    if how < 0.5:
        shape: list[Any] = [rng.choice(SIDES) for _ in range(rng.randint(0, 5))]
        if rng.random() < 0.7:
            shape = [4, 5, rng.choice((1, 2, 3, 4, 5, 2**30))][: rng.randint(2, 3)]
        description = f"'{rng.choice(DTYPES)}'" if rng.random() < 0.6 else rng.choice(DESCRIPTIONS)
        order = rng.choice(("True", "False", "False", "1", "''"))
        header = f"{{'descr': {description}, 'fortran_order': {order}, 'shape': ({', '.join(map(str, shape))},)}}"
        if rng.random() < 0.1:
            header = rng.choice(("(" * 5000, "-" * 9000 + "1", "{" * 300, "__import__('os')", "", "{}", header[:-5]))
        version = rng.choice((1, 1, 1, 2, 3, 4, 0))
        length = rng.choice((len(header), len(header), len(header), 65535, 0))
        start = b"\x93NUMPY" + bytes((version, 0)) + struct.pack("<H" if version == 1 else "<I", length % 65536)
        return _file(rng, folder, ".npy", start + header.encode() + bytes(rng.choice((0, 8, 480, 4096))))
    stream = io.BytesIO()
    dtype = rng.choice(("<f8", ">f8", "<f4", "<f2", "u1", "<u2", ">u2"))
    array = _pixels(rng, rng.choice((1, 2, 3, 4))).astype(dtype)
    np.save(stream, np.asfortranarray(array) if rng.random() < 0.3 else array)
    return _file(rng, folder, ".npy", damaged(rng, stream.getvalue()))


def bombs(rng: random.Random, folder: Path) -> Call:
    """Small files that say they are huge."""
    height, width = (rng.choice((5, 5, 9000, 13000, 50000, 65500, 2**20, 2**31 - 1)) for _ in range(2))
    kind = rng.choice(("png", "jpeg", "exr", "exr part", "exr channels", "exr tile", "npy", "text"))
    if kind == "png":
        header = struct.pack(">IIBBBBB", width, height, 8, rng.choice((0, 2, 6)), 0, 0, rng.choice((0, 1)))
        chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(bytes(2**20))), (b"IEND", b"")]
        return _file(rng, folder, ".png", b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*one) for one in chunks))
    if kind == "text":  # a compressed note of a gigabyte, of which a few kilobytes are here
        header = struct.pack(">IIBBBBB", 1, 1, 8, 2, 0, 0, 0)
        note = zlib_of_zeros()
        chunks = [(b"IHDR", header), (b"zTXt", b"note\0\0" + note), (b"iCCP", b"note\0\0" + note)]
        chunks += [(b"IDAT", zlib.compress(bytes(4))), (b"IEND", b"")]
        return _file(rng, folder, ".png", b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*one) for one in chunks))
    if kind == "jpeg":
        stream = io.BytesIO()
        Image.fromarray(_pixels(rng, 3)).save(stream, format="JPEG", progressive=True)
        content = bytearray(stream.getvalue())
        place = content.index(b"\xff\xc2")
        content[place + 5 : place + 9] = struct.pack(">HH", height % 65536, width % 65536)
        return _file(rng, folder, ".jpg", bytes(content))
    if kind == "npy":
        path = folder / "image.npy"
        array = np.lib.format.open_memmap(path, "w+", np.uint8, (1, 1, rng.choice((3, 2**32))))  # sparse
        del array
        return reading(path)
    return _file(rng, folder, ".exr", _exr_bomb(kind, width, height))


@functools.cache
def zlib_of_zeros() -> bytes:
    packer = zlib.compressobj(9)
    block = bytes(2**20)
    return b"".join([*(packer.compress(block) for _ in range(1024)), packer.flush()])


def _exr_bomb(kind: str, width: int, height: int) -> bytes:
    content = whole_exr(0)
    places = [place for place in range(len(content)) if content.startswith(b"box2i\0", place)]
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    changed = bytearray(content)
    for place in places:
        changed[place + 10 : place + 26] = window
    if kind == "exr":
        return bytes(changed)
    sizes = {"exr part": [(4, 4), (width, height)], "exr channels": [(4000, 4000)], "exr tile": [(4, 4)]}[kind]
    return b"\x76\x2f\x31\x01" + _exr_headers(sizes, kind) + bytes(4096)


def _exr_headers(sizes: list[tuple[int, int]], kind: str) -> bytes:
    """Headers of parts of these sizes, by the letter of the format."""
    flags = {"exr part": 0x1000, "exr channels": 0, "exr tile": 0x200}[kind]
    content = struct.pack("<I", 2 | flags)
    names = [b"B", b"G", b"R"] if kind != "exr channels" else [b"c%04d" % number for number in range(2000)]
    for number, (width, height) in enumerate(sizes):
        channels = b"".join(one + b"\0" + struct.pack("<iIii", 2, 0, 1, 1) for one in names) + b"\0"
        window = struct.pack("<4i", 0, 0, width - 1, height - 1)
        attributes = [
            (b"channels", b"chlist", channels),
            (b"compression", b"compression", b"\0"),
            (b"dataWindow", b"box2i", window),
            (b"displayWindow", b"box2i", window),
            (b"lineOrder", b"lineOrder", b"\0"),
            (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
            (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
            (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
        ]
        if kind == "exr tile":
            attributes.append((b"tiles", b"tiledesc", struct.pack("<2IB", 2**20, 2**20, 0)))
        if kind == "exr part":
            attributes += [
                (b"name", b"string", b"p%d" % number),
                (b"type", b"string", b"scanlineimage"),
                (b"chunkCount", b"int", struct.pack("<i", height)),
            ]
        for name, of, value in attributes:
            content += name + b"\0" + of + b"\0" + struct.pack("<i", len(value)) + value
        content += b"\0"
    return content + (b"\0" if kind == "exr part" else b"")

"""Breaking bytes as files break: cut off, flipped, overwritten, with parts lost, doubled or put in."""

from __future__ import annotations

import random
import struct

__all__ = ["damaged"]

EXTREMES = (
    *(struct.pack("<i", number) for number in (0, -1, 1, 2**31 - 1, -(2**31), 65536)),
    *(struct.pack(">i", number) for number in (1, 65535, 2**31 - 1, 2**16, 2**24)),
    *(b"\0", b"\xff", b"\x7f", b"\x80", b"\xff\xff\xff\xff\xff\xff\xff\x7f"),
)


def damaged(rng: random.Random, content: bytes, most: int = 4) -> bytes:
    """`content` with up to `most` faults; now and then with none."""
    for _ in range(rng.randint(0, most)):
        content = rng.choice(FAULTS)(rng, bytearray(content))
    return content


def _place(rng: random.Random, content: bytearray) -> int:
    # Headers are short and decide most: half of all faults are there.
    return rng.randrange(1 + (min(len(content), 64) if rng.random() < 0.5 else len(content)))


def _cut(rng: random.Random, content: bytearray) -> bytes:
    return bytes(content[: _place(rng, content)])


def _flip(rng: random.Random, content: bytearray) -> bytes:
    for _ in range(rng.choice((1, 1, 2, 8, 64)) if content else 0):
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    return bytes(content)


def _overwrite(rng: random.Random, content: bytearray) -> bytes:
    new, place = rng.choice(EXTREMES), _place(rng, content)
    content[place : place + len(new)] = new
    return bytes(content)


def _lose(rng: random.Random, content: bytearray) -> bytes:
    place = _place(rng, content)
    del content[place : place + rng.choice((1, 4, 100))]
    return bytes(content)


def _double(rng: random.Random, content: bytearray) -> bytes:
    place, size = _place(rng, content), rng.choice((1, 8, 200))
    content[place:place] = content[place : place + size] * rng.choice((1, 3, 50))
    return bytes(content)


def _insert(rng: random.Random, content: bytearray) -> bytes:
    place = _place(rng, content)
    content[place:place] = rng.randbytes(rng.choice((1, 4, 64)))
    return bytes(content)


def _noise(rng: random.Random, content: bytearray) -> bytes:
    place, size = _place(rng, content), rng.choice((4, 32, 256))
    content[place : place + size] = rng.randbytes(min(size, max(0, len(content) - place)))
    return bytes(content)


FAULTS = (_cut, _flip, _flip, _overwrite, _overwrite, _lose, _double, _insert, _noise)

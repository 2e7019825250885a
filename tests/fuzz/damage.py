"""Damage to bytes: cut off, flipped, overwritten, or with a piece lost, repeated or inserted."""

from __future__ import annotations

import random
import struct

__all__ = ["damaged"]

EXTREMES = (
    *(struct.pack("<i", number) for number in (0, -1, 1, 2**31 - 1, -(2**31), 65536)),
    *(struct.pack(">i", number) for number in (1, 65535, 2**31 - 1, 2**16, 2**24)),
    *(b"\0", b"\xff", b"\x7f", b"\x80", b"\xff\xff\xff\xff\xff\xff\xff\x7f"),
)


def damaged(rng: random.Random, content: bytes, max_faults: int = 4) -> bytes:
    """Return `content` with up to `max_faults` faults; sometimes with none."""
    for _ in range(rng.randint(0, max_faults)):
        # Headers are short and decide most: half of all faults are there.
        start = rng.randrange(1 + (min(len(content), 64) if rng.random() < 0.5 else len(content)))
        size = rng.choice((1, 4, 32, 256))
        head, piece, tail = content[:start], content[start : start + size], content[start + size :]
        extreme = rng.choice(EXTREMES)
        content = rng.choice(
            (
                head,
                head + bytes(byte ^ (1 << rng.randrange(8)) for byte in piece[:2]) + piece[2:] + tail,
                head + extreme + content[start + len(extreme) :],
                head + tail,
                head + piece * rng.choice((2, 50)) + tail,
                head + rng.randbytes(size) + piece + tail,
                head + rng.randbytes(len(piece)) + tail,
            )
        )
    return content

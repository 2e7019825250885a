"""The two loops that take most of the time: in vectors, or plain where this Numba has other vectors than we know.

What :mod:`~loi_core.method.compiled.vectors` uses of Numba is not promised to stay. Without it all takes half as long
again, which is why it is there; with another Numba everything still works.
"""

from __future__ import annotations

import numpy as np

__all__ = ["combine_pairs", "transpose"]


def _vectors_work() -> bool:
    """Whether a Numba that can be imported compiles vectors as we write them, and they give what they should."""
    from loi_core.method.compiled.records import GROUP, PAIRS, SIDE, Plane

    try:
        from loi_core.method.compiled.vector_rows import combine_pairs, transpose

        arena = np.arange(64.0 * 64.0)
        transpose(arena, Plane(0, 64), SIDE, SIDE // GROUP, Plane(2048, 64))
        combine_pairs(np.ones(PAIRS), arena, 5 * 64, 9 * 64, 64, Plane(1024, 64), SIDE, False)
    except Exception:  # noqa: BLE001  # whatever another Numba does with what it does not know
        return False
    return bool(arena[2048 + 64] == 1.0)


if _vectors_work():
    from loi_core.method.compiled.vector_rows import combine_pairs, transpose
else:
    from loi_core.method.compiled.plain_rows import combine_pairs, transpose

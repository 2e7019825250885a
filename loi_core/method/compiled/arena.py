"""Memory that kernels lay their planes out in."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from loi_core.method.compiled.bands import Numbers

__all__ = ["Arena"]

ALIGNMENT: Final = 64  # bytes of a full vector, and of a line of the cache


class Arena:
    """Numbers of one dtype that are finite and begin where a line of the cache does, as many as are asked for.

    One thread at a time may use it.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._numbers = _aligned(0, dtype)

    def of(self, elements: int) -> Numbers:
        """At least so many; what they are is left over from their last use."""
        if self._numbers.size < elements:
            self._numbers = _aligned(elements, self._numbers.dtype)
        return self._numbers


def _aligned(elements: int, dtype: np.dtype[Any]) -> Numbers:
    spare = ALIGNMENT // dtype.itemsize
    memory = np.zeros(elements + spare, dtype)
    start = -memory.ctypes.data % ALIGNMENT // dtype.itemsize
    return memory[start : start + elements]

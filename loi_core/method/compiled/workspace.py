"""Memory for the planes of the kernels."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from loi_core.method.compiled.tables import Floats

__all__ = ["Workspace"]

ALIGNMENT_BYTES: Final = 64  # of a full vector and of a cache line


class Workspace:
    """A growing array of finite numbers of one dtype, aligned to cache lines, for one thread at a time."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._memory = _aligned(0, dtype)

    def of_size(self, elements: int) -> Floats:
        """Return at least `elements` numbers, left over from the last use."""
        if self._memory.size < elements:
            self._memory = _aligned(elements, self._memory.dtype)
        return self._memory


def _aligned(elements: int, dtype: np.dtype[Any]) -> Floats:
    padding = ALIGNMENT_BYTES // dtype.itemsize
    memory = np.zeros(elements + padding, dtype)
    start = -memory.ctypes.data % ALIGNMENT_BYTES // dtype.itemsize
    return memory[start : start + elements]

"""NumPy's memory where Dr.Jit has one kernel for it."""

from __future__ import annotations

from typing import Final

import numpy as np

from loi_core.support.arrays import Host

__all__ = ["ALIGNMENT", "aligned"]

ALIGNMENT: Final = 64
"""Bytes: the widest vector that a processor has."""


def aligned(flat: Host) -> Host:
    """A copy whose address is a multiple of ALIGNMENT.

    Dr.Jit reads NumPy's memory in place, and compiles its kernels by whether each array in them is aligned: with many
    parameters, wherever NumPy happens to put them, it would hardly ever find a kernel that it has compiled before.
    """
    memory = np.empty(flat.nbytes + ALIGNMENT, dtype=np.uint8)
    first = -memory.ctypes.data % ALIGNMENT
    copy: Host = memory[first : first + flat.nbytes].view(flat.dtype)
    copy[:] = flat
    return copy

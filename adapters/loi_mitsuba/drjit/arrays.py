"""NumPy arrays that Dr.Jit reads in place."""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["ALIGNMENT_BYTES", "Float32Array", "Float64Array", "HostArray", "aligned_copy"]

HostArray: TypeAlias = NDArray[Any]
"""A NumPy array of any dtype."""

Float32Array: TypeAlias = NDArray[np.float32]
Float64Array: TypeAlias = NDArray[np.float64]

ALIGNMENT_BYTES: Final = 64
"""Width of the widest vector register of current processors."""


def aligned_copy(flat: HostArray) -> HostArray:
    """Copy a flat array to an address that is a multiple of ALIGNMENT_BYTES.

    Dr.Jit reads NumPy's memory in place, and compiles a separate kernel for each combination of aligned and unaligned
    arrays. NumPy's own addresses would therefore defeat Dr.Jit's kernel cache in scenes with many parameters.
    """
    memory = np.empty(flat.nbytes + ALIGNMENT_BYTES, dtype=np.uint8)
    offset = -memory.ctypes.data % ALIGNMENT_BYTES
    copy: HostArray = memory[offset : offset + flat.nbytes].view(flat.dtype)
    copy[:] = flat
    return copy

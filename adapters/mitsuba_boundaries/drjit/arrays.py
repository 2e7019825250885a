"""NumPy arrays that Dr.Jit reads in place, and flat arrays of Dr.Jit as vectors."""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ALIGNMENT_BYTES",
    "Float32Array",
    "Float64Array",
    "HostArray",
    "aligned_copy",
    "as_host",
    "converted",
    "gather",
    "unravel",
]

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


def unravel(vector: Any, flat: Any) -> Any:
    """Return a flat array, in C order, as a vector whose gradient adds to other gradients of that array.

    Parameters
    ----------
    vector : type
        Vector type of Dr.Jit, such as ``mi.Point3f``.
    flat : mi.Float
    """
    size = dr.size_v(vector)
    first = size * dr.arange(dr.uint32_array_t(type(flat)), dr.width(flat) // size)
    return vector(*(gather(flat, first + offset) for offset in range(size)))


def gather(flat: Any, index: Any) -> Any:
    """Return elements of a flat array of Dr.Jit, whose gradients add to others of that array.

    The gradient of ``dr.unravel`` replaces gradients of other gathers from the array. By default, ``dr.gather`` on
    several threads loses gradients of small arrays, or refuses to combine them (``dr.ReduceMode.Expand``).
    """
    return dr.gather(type(flat), flat, index, mode=dr.ReduceMode.Direct)


def as_host(value: Any, shape: tuple[int, ...]) -> Float32Array:
    """Return an array of Dr.Jit as float32 of `shape`, in C order."""
    return np.array(value, dtype=np.float32, order="C").reshape(shape)


def converted(current: Any, flat: Any, shape: tuple[int, ...]) -> Any:
    """Return the flat array `flat`, in C order of `shape`, as a value of the type of `current`, with its gradient."""
    if isinstance(current, float):
        return float(flat[0])
    if dr.is_tensor_v(current):
        return type(current)(flat, shape=shape)
    if isinstance(current, mi.Transform4f):
        # Gathered: an element of a flat array, such as `flat[3]`, is a plain number without a gradient.
        rows = [[gather(flat, 4 * row + column) for column in range(4)] for row in range(4)]
        return mi.Transform4f(mi.Matrix4f(rows))
    return type(current)(flat) if dr.depth_v(current) == 1 else unravel(type(current), flat)

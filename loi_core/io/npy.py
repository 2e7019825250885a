"""Reading arrays in NumPy's file format, of which ``numpy.load`` believes too much.

A header may ask for any memory, and with elements of no size and a shape beyond counting it ends the process. So it is
judged before anything is made of it. Pickles are not read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format

__all__ = ["NpyHeader", "read_npy_header", "read_npy_values"]


@dataclass(frozen=True)
class NpyHeader:
    """What an NPY file says of its array; `columns_first` is Fortran's order."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    columns_first: bool


def read_npy_header(stream: IO[bytes]) -> NpyHeader:
    """The header, which leaves `stream` at the values; ValueError if it is damaged, or not of numbers or texts."""
    version = npy_format.read_magic(stream)
    readers = {(1, 0): npy_format.read_array_header_1_0, (2, 0): npy_format.read_array_header_2_0}
    if version not in readers:  # version 3 is for names of fields
        msg = f"NPY version {version} is not one of numbers"
        raise ValueError(msg)
    shape, columns_first, dtype = readers[version](stream)
    if dtype.kind not in "fiubU" or dtype.itemsize == 0 or min(shape, default=0) < 0 or len(shape) > 8:
        msg = f"an array of {dtype.str} and shape {shape!s:.60} is not one of numbers or texts"
        raise ValueError(msg)
    return NpyHeader(dtype, shape, columns_first)


def read_npy_values(stream: IO[bytes], header: NpyHeader, available: int) -> np.ndarray[Any, Any]:
    """The array, in this machine's byte order; ValueError if it takes more than the `available` bytes."""
    count = math.prod(header.shape)
    if count * header.dtype.itemsize > available:
        msg = f"{count} values of {header.dtype.itemsize} bytes are more than there are"
        raise ValueError(msg)
    values = np.empty(count, dtype=header.dtype)
    if stream.readinto(values.view(np.uint8)) != values.nbytes:  # type: ignore[attr-defined]  # every binary stream has it
        msg = "the values end early"
        raise ValueError(msg)
    values = values.astype(header.dtype.newbyteorder("="), copy=False)
    return values.reshape(header.shape, order="F" if header.columns_first else "C")

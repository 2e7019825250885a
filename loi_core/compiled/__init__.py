"""The loss on the processor, compiled by Numba if that is installed (``pip install "loi[compiled]"``).

Operations on whole arrays pass over memory hundreds of times; here each level of each plane stays in a core's cache
from its isophotes to its gradient, and cores work on different ones. Values and gradients are those of
:mod:`loi_core.comparison` up to rounding, and the same to the last bit with any number of threads.

Importing this package imports nothing else; Numba is loaded when something is first compared.
"""

from __future__ import annotations

import functools

from loi_core.arrays import Array, is_read_by_numpy, is_recorded

__all__ = ["available", "serves"]


@functools.cache
def available() -> bool:
    """Whether Numba can be loaded: one that does not know this NumPy, or this Python, refuses to."""
    try:
        import numba  # noqa: F401  # takes as long as all else together, so only where it is needed
    except ImportError:
        return False
    return True


def serves(planes: Array) -> bool:
    """Whether arrays like `planes` are compared by compiled kernels: those that NumPy can read, of any library.

    Not where a framework differentiates through what is computed.
    """
    if not is_read_by_numpy(planes) or is_recorded(planes):
        return False
    dtype = str(planes.dtype).removeprefix("torch.")
    return dtype in ("float32", "float64") and available()

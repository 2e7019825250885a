"""A branch-free exp within two roundings, which LLVM vectorises; for other versions it calls a library."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import types
from numba.extending import overload

__all__ = ["exponential"]

# exp(x) = 2**n exp(r) with r = x - n log 2, |r| <= log(2) / 2. Here log 2 is the sum of two numbers; the first has so
# few bits that its product with n is exact.
SINGLE_HIGH: Final = np.float32(355 / 512)
SINGLE_LOW: Final = np.float32(math.log(2.0) - 355 / 512)
DOUBLE_HIGH: Final = 2977044472 / 2**32
DOUBLE_LOW: Final = -4.2009150726810846e-11

# Adding and subtracting this rounds to an integer, which is in the last bits in between.
SINGLE_ROUNDING: Final = np.float32(1.5 * 2**23)
DOUBLE_ROUNDING: Final = 1.5 * 2**52

SINGLE_LOG2_E: Final = np.float32(1.0 / math.log(2.0))
DOUBLE_LOG2_E: Final = 1.0 / math.log(2.0)

# Coefficients of the series of exp(r), up to a term below half a rounding.
S7, S6, S5, S4, S3 = (np.float32(1.0 / math.factorial(order)) for order in (7, 6, 5, 4, 3))
D13, D12, D11, D10, D9, D8, D7, D6, D5, D4, D3 = (1.0 / math.factorial(order) for order in range(13, 2, -1))
HALF: Final = np.float32(0.5)
UNIT: Final = np.float32(1.0)


def exponential(x: Any) -> Any:
    """Return exp(x) for a float32 or float64 x from the logarithm of the smallest normal number to 0."""
    return np.exp(x)


@overload(exponential, inline="never")  # type: ignore[untyped-decorator]  # Numba has no types
def _compiled(x: Any) -> Any:
    return _single if x == types.float32 else _double


def _single(x: Any) -> Any:
    shifted = x * SINGLE_LOG2_E + SINGLE_ROUNDING
    whole = shifted - SINGLE_ROUNDING
    r = (x - whole * SINGLE_HIGH) - whole * SINGLE_LOW
    p = (((S7 * r + S6) * r + S5) * r + S4) * r + S3
    p = ((p * r + HALF) * r + UNIT) * r + UNIT
    return p * np.int32((np.float32(shifted).view(np.int32) + np.int32(127)) << np.int32(23)).view(np.float32)


def _double(x: Any) -> Any:
    shifted = x * DOUBLE_LOG2_E + DOUBLE_ROUNDING
    whole = shifted - DOUBLE_ROUNDING
    r = (x - whole * DOUBLE_HIGH) - whole * DOUBLE_LOW
    p = (((((D13 * r + D12) * r + D11) * r + D10) * r + D9) * r + D8) * r + D7
    p = (((p * r + D6) * r + D5) * r + D4) * r + D3
    p = ((p * r + 0.5) * r + 1.0) * r + 1.0
    return p * np.int64((np.float64(shifted).view(np.int64) + np.int64(1023)) << np.int64(52)).view(np.float64)

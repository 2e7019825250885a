"""Telling numbers from what only looks like them, for the checks of arguments."""

from __future__ import annotations

import math
from numbers import Integral, Real

import numpy as np

__all__ = ["real_number", "whole_number"]


def real_number(value: object) -> float:
    """`value` as a float; NaN if it is not a real number, is a bool, or is too large for a float.

    Arrays of shape () count as the number that they hold.
    """
    if getattr(value, "shape", None) == () and hasattr(value, "item"):
        value = value.item()
    if not isinstance(value, Real) or isinstance(value, bool | np.bool_):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.nan


def whole_number(value: object) -> int | None:
    """`value` as an int; None if it is not a whole number, or is a bool."""
    return int(value) if isinstance(value, Integral) and not isinstance(value, bool | np.bool_) else None

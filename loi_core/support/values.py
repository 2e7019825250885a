"""Numbers from values of unknown type: real numbers, whole numbers, numbers in text."""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import Any

import numpy as np

__all__ = ["finite_or_none", "formatted", "parsed_number", "real_number", "whole_number"]


def real_number(value: object) -> float:
    """Return `value` as a float; NaN for a bool, anything that is not a real number, and an int too large for a float.

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
    """Return `value` as an int; None for a bool and anything that is not a whole number."""
    return int(value) if isinstance(value, Integral) and not isinstance(value, bool | np.bool_) else None


def finite_or_none(value: Any) -> float | None:
    """Return a number as a float for JSON, which has neither NaN nor infinity; None for those."""
    return float(value) if math.isfinite(value) else None


def formatted(value: object, spec: str) -> str:
    """Return a finite number in a format such as ".2f"; "-" for everything else."""
    number = real_number(value)
    return format(number, spec) if math.isfinite(number) else "-"


def parsed_number(text: str) -> float:
    """Return the number in a text; NaN if the text is not a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan

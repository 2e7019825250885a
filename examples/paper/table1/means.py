"""Means over seeds, and how sure one can be of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Mean"]

# Quantiles of Student's t at 97.5 % for 1 to 15 degrees of freedom; beyond, those of the normal law are near enough.
STUDENT = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23, 2.20, 2.18, 2.16, 2.14, 2.13)


@dataclass(frozen=True)
class Mean:
    """A mean with the half width of its 95 % confidence interval, and the least value.

    Attributes
    ----------
    value, half, least : float
        `half` is NaN for a single value.
    count : int
        How many values.
    """

    value: float
    half: float
    least: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Mean:
        """Of one value or more; the interval is Student's."""
        count = len(values)
        value = float(np.mean(values))
        if count == 1:
            return cls(value, math.nan, min(values), 1)
        quantile = STUDENT[count - 2] if count - 2 < len(STUDENT) else 1.96
        half = quantile * float(np.std(values, ddof=1)) / math.sqrt(count)
        return cls(value, half, min(values), count)

"""Means over seeds, and how sure one can be of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

__all__ = ["Mean"]


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
        half = float(stats.t.ppf(0.975, count - 1)) * float(np.std(values, ddof=1)) / math.sqrt(count)
        return cls(value, half, min(values), count)

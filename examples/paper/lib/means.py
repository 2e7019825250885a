"""Means over seeds with their confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

__all__ = ["Mean"]


@dataclass(frozen=True)
class Mean:
    """Mean of a sample, the half width of its 95 % confidence interval, and its minimum.

    Attributes
    ----------
    value : float
    half_width : float
        NaN for a single value.
    minimum : float
    count : int
        Size of the sample.
    """

    value: float
    half_width: float
    minimum: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Mean:
        """Return the mean of one or more values, with Student's interval."""
        count = len(values)
        value = float(np.mean(values))
        if count == 1:
            return cls(value, math.nan, min(values), 1)
        half_width = float(stats.t.ppf(0.975, count - 1)) * float(np.std(values, ddof=1)) / math.sqrt(count)
        return cls(value, half_width, min(values), count)

"""How arrays of signed values, such as gradients, are shown."""

from __future__ import annotations

from typing import Final

import numpy as np

from loi_core.support.arrays import Host

__all__ = ["about_grey", "brightest"]

BRIGHTEST: Final = 0.998  # quantile of magnitudes that is shown as the largest


def brightest(values: Host) -> float:
    """The largest magnitude, but for a few values."""
    return float(np.quantile(np.abs(values), BRIGHTEST)) or float(np.max(np.abs(values)))


def about_grey(values: Host, largest: float | None = None) -> Host:
    """`values` as intensities: mid grey is 0; `largest`, their own without it, is white, and minus it is black."""
    size = (brightest(values) if largest is None else largest) or 1.0
    shown: Host = np.clip(0.5 + 0.5 * values / size, 0.0, 1.0)
    return shown

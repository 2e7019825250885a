"""How near an image is to another, in decibels."""

from __future__ import annotations

import math

import numpy as np

from loi_core.support.arrays import Host

__all__ = ["psnr"]


def psnr(image: Host, target: Host) -> float:
    """Peak signal-to-noise ratio in dB, for a peak of 1; infinite for equal images."""
    error = float(np.mean((np.asarray(image, dtype=np.float64) - target) ** 2))
    return math.inf if error == 0.0 else -10.0 * math.log10(error)

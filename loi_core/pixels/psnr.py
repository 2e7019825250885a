"""The peak signal-to-noise ratio."""

from __future__ import annotations

import math

import numpy as np

from loi_core.support.arrays import Host

__all__ = ["psnr"]


def psnr(image: Host, target: Host, weights: Host | None = None) -> float:
    """Return the peak signal-to-noise ratio in dB, for a peak of 1; infinite for equal images.

    Parameters
    ----------
    image, target : array, shape (H, W, C)
    weights : array, shape (H, W), optional
        Weight of each pixel.
    """
    with np.errstate(all="ignore"):  # a square may overflow: then the ratio is -inf
        squares = np.mean((np.asarray(image, dtype=np.float64) - target) ** 2, axis=-1)
        if weights is None:
            error = float(np.mean(squares))
        else:
            counts = weights > 0.0  # pixels of weight 0 may hold anything
            error = float(np.average(squares[counts], weights=weights[counts]))
    return math.inf if error == 0.0 else -10.0 * math.log10(error)

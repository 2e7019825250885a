"""The loss and its gradient as a plain sum, in float64 on NumPy: dense matrices, every level, every pixel."""

from __future__ import annotations

import math

import numpy as np

from loi_core import ScaleSpace
from loi_core.kernels import blur_matrix
from tests.helpers import Host

TIE = 8.0 * float(np.finfo(np.float64).eps)


def direct(image: Host, reference: Host, scales: ScaleSpace) -> tuple[float, Host, float]:
    """Value, gradient by pixels within the bounds, and how far the gradient's 1-norm hangs on signs near a tie.

    Images of shape (H, W, C), float64, within the bounds; p = 1.
    """
    planes, wanted = (np.moveaxis(each, -1, 0) for each in (image, reference))
    height, width = planes.shape[1:]
    value, total, unsure = 0.0, np.zeros(planes.shape), 0.0
    for sigma in scales.sigma:
        rows, columns = (_matrix(size, sigma, scales, scales.inner_taps) for size in (height, width))
        blurred, target = rows @ planes @ columns.T, rows @ wanted @ columns.T
        for beta in scales.beta:
            mass = scales.mass(beta)
            cdf, slope = _cdf(blurred, scales, beta)
            difference = cdf - _cdf(target, scales, beta)[0]
            tie = TIE * mass / scales.spacing(beta)
            weight = scales.scale_weight * scales.level_weight(beta) / math.prod(planes.shape)
            for alpha in scales.alpha:
                down, across = (_matrix(size, alpha, scales, scales.extent_taps) for size in (height, width))
                mean = down @ difference @ across.T
                value += weight * float(np.abs(mean).sum())
                sign = np.where(np.abs(mean) > tie, np.sign(mean), 0.0)
                pulled = np.sum((down.T @ sign @ across) * slope, axis=0)
                total += weight * (rows.T @ pulled @ columns)
                close = (np.abs(mean) > 0.2 * tie) & (np.abs(mean) < 5.0 * tie)
                unsure += 2.0 * weight * float(close.sum()) * float(np.abs(slope).max())
    return value, np.moveaxis(total, 0, -1), unsure


def _matrix(size: int, scale: float, scales: ScaleSpace, taps: int | None) -> Host:
    return blur_matrix(size, scale, scales.boundary, taps)


def _cdf(intensity: Host, scales: ScaleSpace, beta: float) -> tuple[Host, Host]:
    offsets = (scales.levels(beta)[:, None, None, None] - intensity) / beta
    weights = np.exp(-0.5 * offsets**2) / (math.sqrt(2.0 * math.pi) * beta) * scales.mass(beta)
    return np.cumsum(weights, axis=0), np.cumsum(weights * offsets / beta, axis=0)

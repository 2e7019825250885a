"""The loss and its gradient in forty digits: for the cases in which float64 itself is in doubt."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np

from loi_core import ScaleSpace
from loi_core.method.distance import TIE_ROUNDINGS
from tests.helpers import Host

DIGITS = 40
REACH = 14  # standard deviations: beyond, a Gaussian is below 1e-42 of its peak

exp = np.frompyfunc(mpmath.exp, 1, 1)


def precise(image: Host, reference: Host, scales: ScaleSpace) -> tuple[float, Host]:
    """Value and gradient by the image, shape (H, W), with the boundary "reflect" and the paper's convention.

    A pixel beyond the bounds keeps the gradient that points back inside. Ties are those of float64.
    """
    with mpmath.workdps(DIGITS):
        low, high = scales.bounds
        planes, wanted = (_exact(np.clip(each, low, high)) for each in (image, reference))
        value, gradient = mpmath.mpf(0), 0 * planes
        for sigma in scales.sigma:
            down, across = (_matrix(size, sigma) for size in image.shape)
            ours, theirs = (down @ each @ across.T for each in (planes, wanted))
            for beta in scales.beta:
                cdf, slope = _cdf_and_slope(ours, scales, beta)
                difference = cdf - _cdf_and_slope(theirs, scales, beta)[0]
                weight = mpmath.mpf(beta) / image.size
                for alpha in scales.alpha:
                    rows, columns = (_matrix(size, alpha) for size in image.shape)
                    mean = np.stack([rows @ one @ columns.T for one in difference])
                    cost, derivative = _cost(mean, scales.p)
                    value += weight * np.sum(cost)
                    pulled = np.stack([rows.T @ one @ columns for one in derivative])
                    gradient = gradient + weight * (down.T @ np.sum(pulled * slope, axis=0) @ across)
    slopes = gradient.astype(np.float64)
    outwards = ((image < low) & (slopes > 0.0)) | ((image > high) & (slopes < 0.0))
    return float(value), np.where(outwards, 0.0, slopes)


def _exact(values: Host) -> Host:
    exact: Host = np.vectorize(mpmath.mpf, otypes=[object])(values)
    return exact


def _matrix(size: int, scale: float) -> Host:
    """A Gaussian on a mirrored axis, normalised by its sum over an axis without end."""
    if scale == 0.0:
        return _exact(np.eye(size))
    reach = int(REACH * scale) + 1
    entries: list[Any] = [
        mpmath.exp(-(mpmath.mpf(step) ** 2) / (2 * mpmath.mpf(scale) ** 2)) for step in range(reach + 1)
    ]
    total = entries[0] + 2 * sum(entries[1:])
    matrix = _exact(np.zeros((size, size)))
    for here in range(size):
        for away in range(-reach, reach + 1):
            there = (here + away) % (2 * size)
            matrix[here, min(there, 2 * size - 1 - there)] += entries[abs(away)] / total
    return matrix


def _cdf_and_slope(intensity: Host, scales: ScaleSpace, beta: float) -> tuple[Host, Host]:
    count, width = scales.level_count(beta), mpmath.mpf(beta)
    middle = (mpmath.mpf(scales.bounds[0]) + mpmath.mpf(scales.bounds[1])) / 2
    levels = np.array([middle + width * (step - mpmath.mpf(count - 1) / 2) for step in range(count)], dtype=object)
    offsets = (levels[:, None, None] - intensity) / width
    weights = exp(-offsets * offsets / 2) / mpmath.sqrt(2 * mpmath.pi)
    return np.cumsum(weights, axis=0), np.cumsum(weights * offsets / width, axis=0)


def _cost(mean: Host, p: float) -> tuple[Host, Host]:
    tie, power = TIE_ROUNDINGS * float(np.finfo(np.float64).eps), 1 / mpmath.mpf(p)
    cost, derivative = 0 * mean, 0 * mean
    for index in np.ndindex(mean.shape):
        size = abs(mean[index])
        if size > tie:
            cost[index] = size**power
            derivative[index] = mpmath.sign(mean[index]) * power * size ** (power - 1)
    return cost, derivative

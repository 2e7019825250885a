"""The loss and its gradient in forty digits, for cases where float64 is not accurate enough."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np

from loi_core import ScaleSpace
from loi_core.method.distance import TIE_ROUNDINGS
from tests.helpers import Host

DIGITS = 40
TRUNCATION = 14  # standard deviations beyond which a Gaussian is below 1e-42 of its peak

exp = np.frompyfunc(mpmath.exp, 1, 1)


def precise(image: Host, reference: Host, scales: ScaleSpace) -> tuple[float, Host]:
    """Return the value and its gradient, shape (H, W), with the boundary "reflect" and the paper's convention.

    Intensities beyond the bounds are compressed in float64. The tie threshold is float64's.
    """
    with mpmath.workdps(DIGITS):
        planes, expected = (_exact(scales.intensity_range.apply(pixels)) for pixels in (image, reference))
        value, gradient = mpmath.mpf(0), 0 * planes
        for sigma in scales.sigma:
            vertical, horizontal = (_matrix(size, sigma) for size in image.shape)
            blurred, reference_blurred = (vertical @ pixels @ horizontal.T for pixels in (planes, expected))
            for beta in scales.beta:
                cdf, slope = _cdf_and_slope(blurred, scales, beta)
                difference = cdf - _cdf_and_slope(reference_blurred, scales, beta)[0]
                weight = mpmath.mpf(beta) / image.size
                for alpha in scales.alpha:
                    rows, columns = (_matrix(size, alpha) for size in image.shape)
                    mean = np.stack([rows @ level @ columns.T for level in difference])
                    cost, derivative = _cost(mean, scales.p)
                    value += weight * np.sum(cost)
                    pulled = np.stack([rows.T @ level @ columns for level in derivative])
                    gradient = gradient + weight * (vertical.T @ np.sum(pulled * slope, axis=0) @ horizontal)
    return float(value), scales.intensity_range.pullback(image, gradient.astype(np.float64))


def _exact(values: Host) -> Host:
    exact: Host = np.vectorize(mpmath.mpf, otypes=[object])(values)
    return exact


def _matrix(size: int, scale: float) -> Host:
    """Return a Gaussian on a mirrored axis, normalised by its sum over an infinite axis."""
    if scale == 0.0:
        return _exact(np.eye(size))
    radius = int(TRUNCATION * scale) + 1
    entries: list[Any] = [
        mpmath.exp(-(mpmath.mpf(step) ** 2) / (2 * mpmath.mpf(scale) ** 2)) for step in range(radius + 1)
    ]
    total = entries[0] + 2 * sum(entries[1:])
    matrix = _exact(np.zeros((size, size)))
    for row in range(size):
        for step in range(-radius, radius + 1):
            column = (row + step) % (2 * size)
            matrix[row, min(column, 2 * size - 1 - column)] += entries[abs(step)] / total
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

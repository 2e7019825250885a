"""All levels of a tile, by operations on whole arrays; :mod:`loi_core.method.compiled.tile_levels` does the same.

`numbers` are, in units of the distance of two levels: one over the tonal scale times the root of 2; the logarithm of
what a level adds to the CDF at its peak; the least such logarithm that counts; the largest difference that is a tie;
and the power of differences that is their cost. `rows`, shape (h, r), and `columns`, shape (c, w), are how much of each
sample each pixel is; `spans`, shape (c, 2), is where a row of `columns` is not 0. `shares`, shape (h, w), is empty if
all pixels count alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from loi_core.method.distance import cost_slope, sum_of_costs
from loi_core.support.arrays import Host

__all__ = ["compare", "gather", "pull"]


def gather(
    image: Host,
    reference: Host,
    shares: Host,
    levels: Host,
    numbers: Host,
    rows: Host,
    columns: Host,
    spans: Host,  # noqa: ARG001  # for loops
    gathered: Host,
) -> None:
    """Add the differences of the CDFs of two tiles, shape (h, w), to samples, shape (L, r, c)."""
    difference = np.zeros_like(image)
    for level, samples in zip(levels, gathered, strict=True):
        weights = _weights(_offsets(image, level, numbers), numbers)
        weights -= _weights(_offsets(reference, level, numbers), numbers)
        if shares.size:
            weights *= shares
        difference += weights
        samples += rows.T @ (difference @ columns.T)


def compare(
    samples: Host,
    weight: Any,
    numbers: Host,
    rows: Host,
    columns: Host,
    spans: Host,  # noqa: ARG001  # for loops
    gathered: Host,
) -> float:
    """What the differences cost that samples, shape (L, r, c), spread to a tile; their slopes are added to `gathered`.

    That is of the samples' shape, or empty if it is not wanted.
    """
    tie, power = float(numbers[3]), float(numbers[4])
    total = 0.0
    for index, level in enumerate(samples):
        difference = (rows @ level) @ columns
        slope = cost_slope(difference, 1.0 / power, tie, float(weight))
        total += float(sum_of_costs(difference, slope, 1.0 / power))
        if gathered.size:
            gathered[index] += rows.T @ (slope @ columns.T)
    return total


def pull(
    image: Host,
    shares: Host,
    levels: Host,
    numbers: Host,
    samples: Host,
    rows: Host,
    columns: Host,
    spans: Host,  # noqa: ARG001  # for loops
    cotangent: Host,
) -> None:
    """Add what samples, shape (L, r, c), spread to a tile, shape (h, w), pulled back through its CDFs."""
    slope = np.zeros_like(image)
    for level, there in zip(levels, samples, strict=True):
        offsets = _offsets(image, level, numbers)
        weights = _weights(offsets, numbers)
        weights *= offsets
        if shares.size:
            weights *= shares
        slope += weights
        cotangent += slope * ((rows @ there) @ columns)


def _offsets(intensity: Host, level: Any, numbers: Host) -> Host:
    offsets: Host = level - intensity
    offsets *= numbers[0]
    return offsets


def _weights(offsets: Host, numbers: Host) -> Host:
    exponents: Host = np.square(offsets)
    np.subtract(numbers[1], exponents, out=exponents)
    np.maximum(exponents, numbers[2], out=exponents)
    np.exp(exponents, out=exponents)
    return exponents

"""All levels of one tile, row by row, compiled by Numba: the sibling of :mod:`loi_core.method.tiled.plain_levels`.

A row goes all the way, through all levels, before the next: what is at work stays in the nearest cache.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from loi_core.method.compiled.compiling import compiled, compiled_sums
from loi_core.method.compiled.exponential import exponential
from loi_core.method.compiled.levels import sum_of_powers, sum_of_sizes
from loi_core.method.compiled.records import Floats, Table

__all__ = ["compare", "gather", "pull"]


@compiled
def gather(
    image: Floats,
    reference: Floats,
    shares: Floats,
    levels: Floats,
    numbers: Floats,
    rows: Floats,
    columns: Floats,
    spans: Table,
    gathered: Floats,
) -> None:
    """Add the differences of the CDFs of two tiles, shape (h, w), to samples, shape (L, r, c)."""
    scale, peak, least = numbers[0], numbers[1], numbers[2]
    difference = np.empty(image.shape[1], image.dtype)
    sums = np.empty(columns.shape[0], image.dtype)
    for y in range(image.shape[0]):
        ours, theirs = image[y], reference[y]
        difference[:] = 0
        for index in range(levels.size):
            level = levels[index]
            if shares.size > 0:
                share = shares[y]
                for x in range(difference.size):
                    offset, other = (level - ours[x]) * scale, (level - theirs[x]) * scale
                    weight = exponential(max(peak - offset * offset, least)) * share[x]
                    difference[x] += weight - exponential(max(peak - other * other, least)) * share[x]
            else:
                for x in range(difference.size):
                    offset, other = (level - ours[x]) * scale, (level - theirs[x]) * scale
                    weight = exponential(max(peak - offset * offset, least))
                    difference[x] += weight - exponential(max(peak - other * other, least))
            _gather_row(difference, rows[y], columns, spans, sums, gathered[index])


@compiled
def compare(
    samples: Floats,
    weight: Any,
    numbers: Floats,
    rows: Floats,
    columns: Floats,
    spans: Table,
    gathered: Floats,
) -> float:
    """What the differences cost that samples, shape (L, r, c), spread to a tile; their slopes are added to `gathered`.

    That is of the samples' shape, or empty if it is not wanted.
    """
    tie, power = numbers[3], numbers[4]
    row = np.empty(columns.shape[1], samples.dtype)
    sums = np.empty(columns.shape[0], samples.dtype)
    total = 0.0
    for y in range(rows.shape[0]):
        for index in range(samples.shape[0]):
            _spread_row(samples[index], rows[y], columns, spans, sums, row)
            total += sum_of_sizes(row, tie, weight) if power == 1 else sum_of_powers(row, tie, power, weight)
            if gathered.size > 0:
                _gather_row(row, rows[y], columns, spans, sums, gathered[index])
    cost: float = total * weight
    return cost


@compiled
def pull(
    image: Floats,
    shares: Floats,
    levels: Floats,
    numbers: Floats,
    samples: Floats,
    rows: Floats,
    columns: Floats,
    spans: Table,
    cotangent: Floats,
) -> None:
    """Add what samples, shape (L, r, c), spread to a tile, shape (h, w), pulled back through its CDFs."""
    scale, peak, least = numbers[0], numbers[1], numbers[2]
    slope, back = np.empty(image.shape[1], image.dtype), np.empty(image.shape[1], image.dtype)
    sums = np.empty(columns.shape[0], image.dtype)
    for y in range(image.shape[0]):
        ours, row = image[y], cotangent[y]
        slope[:] = 0
        for index in range(levels.size):
            level = levels[index]
            _spread_row(samples[index], rows[y], columns, spans, sums, back)
            if shares.size > 0:
                share = shares[y]
                for x in range(row.size):
                    offset = (level - ours[x]) * scale
                    slope[x] += offset * exponential(max(peak - offset * offset, least)) * share[x]
                    row[x] += slope[x] * back[x]
            else:
                for x in range(row.size):
                    offset = (level - ours[x]) * scale
                    slope[x] += offset * exponential(max(peak - offset * offset, least))
                    row[x] += slope[x] * back[x]


@compiled
def _gather_row(row: Floats, down: Floats, columns: Floats, spans: Table, sums: Floats, samples: Floats) -> None:
    """Add a row of pixels to samples, shape (r, c)."""
    for c in range(columns.shape[0]):
        first, last = spans[c]
        sums[c] = _product(row[first:last], columns[c, first:last])
    for r in range(down.size):
        share = down[r]
        if share != 0:
            into = samples[r]
            for c in range(sums.size):
                into[c] += share * sums[c]


@compiled
def _spread_row(samples: Floats, down: Floats, columns: Floats, spans: Table, sums: Floats, row: Floats) -> None:
    """Make a row of pixels of samples, shape (r, c)."""
    sums[:] = 0
    for r in range(down.size):
        share = down[r]
        if share != 0:
            there = samples[r]
            for c in range(sums.size):
                sums[c] += share * there[c]
    row[:] = 0
    for c in range(columns.shape[0]):
        first, last = spans[c]
        share, weights, part = sums[c], columns[c, first:last], row[first:last]
        for x in range(part.size):
            part[x] += share * weights[x]


@compiled_sums
def _product(one: Floats, other: Floats) -> Any:
    total = one.dtype.type(0)
    for x in range(one.size):
        total += one[x] * other[x]
    return total

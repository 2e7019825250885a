"""Sign errors on a sampling, compiled: see :func:`loi_core.method.sampling_error.sign_error_sums`."""

from __future__ import annotations

import math
from typing import Any

from loi_core.method.compiled.compiling import compiled, compiled_sums
from loi_core.method.compiled.tables import Box, Floats, Plane
from loi_core.method.sampling_error import BLOCK_SIDE

__all__ = ["add_sign_errors", "block_sums_size", "reduce_block_sums"]


def block_sums_size(rows: int, columns: int) -> int:
    """Return the size of `block_sums` that suffices for any window of a sampling of `rows` by `columns`."""
    return rows + 4 * (rows // BLOCK_SIDE + 2) * (columns // BLOCK_SIDE + 2)


@compiled
def add_sign_errors(
    workspace: Floats, plane: Plane, box: Box, first: int, last: int, spacings: Floats, tie: Any, block_sums: Floats
) -> None:
    """Add the sign errors of the samples in a box to the sums of their blocks.

    The columns `first` to `last` arrive from left to right in several boxes. `block_sums` starts with the last column
    of the box before, one number per row. Four numbers per block follow: sum and sum of squares across, then down.
    """
    top, bottom, left, right = box
    first_block = first // BLOCK_SIDE
    per_row = 4 * ((last - 1) // BLOCK_SIDE - first_block + 1)
    for y in range(top, bottom):
        row = plane.offset + y * plane.stride
        row_sums = bottom - top + (y // BLOCK_SIDE - top // BLOCK_SIDE) * per_row
        if left > first:
            previous = workspace.dtype.type(block_sums[y - top])
            block = (left - 1) // BLOCK_SIDE - first_block
            _add_sign_error(
                previous, workspace[row + left], left - 1, spacings[1], tie, block_sums, row_sums + 4 * block
            )
        block_sums[y - top] = workspace[row + right - 1]
        for block in range(left // BLOCK_SIDE, (right - 1) // BLOCK_SIDE + 1):
            begin, stop = max(left, block * BLOCK_SIDE), min(right, (block + 1) * BLOCK_SIDE)
            sums = row_sums + 4 * (block - first_block)
            last_column = min(stop, right - 1)
            if _count_sign_changes(
                workspace[row + begin : row + last_column], workspace[row + begin + 1 : row + last_column + 1], tie
            ):
                for x in range(begin, last_column):
                    _add_sign_error(workspace[row + x], workspace[row + x + 1], x, spacings[1], tie, block_sums, sums)
            below = row + plane.stride
            if y + 1 < bottom and _count_sign_changes(
                workspace[row + begin : row + stop], workspace[below + begin : below + stop], tie
            ):
                for x in range(begin, stop):
                    _add_sign_error(workspace[row + x], workspace[below + x], y, spacings[0], tie, block_sums, sums + 2)


@compiled_sums
def _count_sign_changes(samples: Floats, neighbours: Floats, tie: Any) -> Any:
    """Count the samples whose sign differs from their neighbour's."""
    unit, zero = tie / tie, tie - tie
    total = zero
    for x in range(samples.size):
        first, second = samples[x], neighbours[x]
        total += unit if ((first > tie) != (second > tie)) or ((first < -tie) != (second < -tie)) else zero
    return total


@compiled
def _add_sign_error(
    sample: Any, neighbour: Any, index: int, spacing: float, tie: Any, block_sums: Floats, sums: int
) -> None:
    """Add the sign error between a sample and the next one to the sum at `sums`, and its square to the one after."""
    sign = (1.0 if sample > tie else 0.0) - (1.0 if sample < -tie else 0.0)
    next_sign = (1.0 if neighbour > tie else 0.0) - (1.0 if neighbour < -tie else 0.0)
    if sign == next_sign:
        return
    if sign * next_sign < 0.0:
        crossing = float(sample) / (float(sample) - float(neighbour))
    else:
        crossing = (abs(float(sample)) - float(tie)) / (abs(float(sample)) - abs(float(neighbour)))
    position = (index + 0.5) * spacing - 0.5
    fraction = (math.floor(position + crossing * spacing) + 0.5 - position) / spacing
    error = (sign - next_sign) * (fraction - 0.5)
    block_sums[sums] += error
    block_sums[sums + 1] += error * error


@compiled
def reduce_block_sums(block_sums: Floats, rows: int, sign_errors: Floats) -> None:
    """Add the squared sums of all blocks, and the sums of squares, to `sign_errors`; clear `block_sums`."""
    for index in range(rows, block_sums.size - 1, 2):
        sign_errors[0] += block_sums[index] * block_sums[index] / (BLOCK_SIDE * BLOCK_SIDE)
        sign_errors[1] += block_sums[index + 1] / (BLOCK_SIDE * BLOCK_SIDE)
    block_sums[:] = 0.0

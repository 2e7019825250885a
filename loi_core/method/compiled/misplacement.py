"""How far signs are misplaced on a sampling: :func:`loi_core.method.sampling_error.misplaced`, compiled."""

from __future__ import annotations

import math
from typing import Any

from loi_core.method.compiled.compiling import compiled, compiled_sums
from loi_core.method.compiled.records import Box, Floats, Plane
from loi_core.method.sampling_error import BLOCK

__all__ = ["room_for_sums", "sum_misplaced", "take_sums"]


def room_for_sums(rows: int, columns: int) -> int:
    """How long `sums` has to be for any part of a sampling of so many rows and columns."""
    return rows + 4 * (rows // BLOCK + 2) * (columns // BLOCK + 2)


@compiled
def sum_misplaced(
    arena: Floats, plane: Plane, box: Box, first: int, last: int, spacings: Floats, tie: Any, sums: Floats
) -> None:
    """Add what samples in the columns of a box are misplaced by to the sums of their blocks.

    All columns from `first` to `last` come, from left to right, some at a time. After as many numbers as there are
    rows, which hold the column before, `sums` has four for each block: the sum and the sum of squares across, and down.
    """
    top, bottom, left, right = box
    first_block = first // BLOCK
    per_row = 4 * ((last - 1) // BLOCK - first_block + 1)
    for y in range(top, bottom):
        row = plane.at + y * plane.stride
        to = bottom - top + (y // BLOCK - top // BLOCK) * per_row
        if left > first:
            before = arena.dtype.type(sums[y - top])
            block = (left - 1) // BLOCK - first_block
            _add_misplaced(before, arena[row + left], left - 1, spacings[1], tie, sums, to + 4 * block)
        sums[y - top] = arena[row + right - 1]
        for block in range(left // BLOCK, (right - 1) // BLOCK + 1):
            begin, end = max(left, block * BLOCK), min(right, (block + 1) * BLOCK)
            at = to + 4 * (block - first_block)
            beside = min(end, right - 1)
            if _changes(arena[row + begin : row + beside], arena[row + begin + 1 : row + beside + 1], tie) > 0:
                for x in range(begin, beside):
                    _add_misplaced(arena[row + x], arena[row + x + 1], x, spacings[1], tie, sums, at)
            below = row + plane.stride
            if y + 1 < bottom and _changes(arena[row + begin : row + end], arena[below + begin : below + end], tie) > 0:
                for x in range(begin, end):
                    _add_misplaced(arena[row + x], arena[below + x], y, spacings[0], tie, sums, at + 2)


@compiled_sums
def _changes(here: Floats, there: Floats, tie: Any) -> Any:
    """How many samples have another sign than their neighbours."""
    one, nothing = tie / tie, tie - tie
    total = nothing
    for x in range(here.size):
        a, b = here[x], there[x]
        total += one if ((a > tie) != (b > tie)) or ((a < -tie) != (b < -tie)) else nothing
    return total


@compiled
def _add_misplaced(here: Any, there: Any, index: int, spacing: float, tie: Any, sums: Floats, to: int) -> None:
    """Add what a sample is misplaced by to the sum at `to`, and its square to the next."""
    sign = (1.0 if here > tie else 0.0) - (1.0 if here < -tie else 0.0)
    other = (1.0 if there > tie else 0.0) - (1.0 if there < -tie else 0.0)
    if sign == other:
        return
    if sign * other < 0.0:
        passed = float(here) / (float(here) - float(there))
    else:
        passed = (abs(float(here)) - float(tie)) / (abs(float(here)) - abs(float(there)))
    position = (index + 0.5) * spacing - 0.5
    fraction = (math.floor(position + passed * spacing) + 0.5 - position) / spacing
    moved = (sign - other) * (fraction - 0.5)
    sums[to] += moved
    sums[to + 1] += moved * moved


@compiled
def take_sums(sums: Floats, rows: int, doubt: Floats) -> None:
    """Add the squares of the sums of all blocks, and the sums of squares, to `doubt`; clear `sums`."""
    for index in range(rows, sums.size - 1, 2):
        doubt[0] += sums[index] * sums[index] / (BLOCK * BLOCK)
        doubt[1] += sums[index + 1] / (BLOCK * BLOCK)
    sums[:] = 0.0

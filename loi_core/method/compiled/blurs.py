"""Separable blurs of windows of planes in the workspace, compiled by Numba.

A blur runs the same pass twice: it combines rows and writes the result transposed, so that its columns are rows the
second time. The result of a blur is therefore transposed; two blurs restore the orientation.
"""

from __future__ import annotations

from typing import Final

from loi_core.method.compiled.compiling import compiled
from loi_core.method.compiled.rows import combine_pairs, transpose
from loi_core.method.compiled.tables import (
    COLUMN_MULTIPLE,
    GROUP_ROWS,
    STRIP_ROWS,
    TAPS_PER_STEP,
    BandColumn,
    Box,
    Floats,
    Operators,
    PassColumn,
    Plane,
    Table,
)

__all__ = ["blur_rows", "blur_window", "clear_window", "combine_first", "combine_second"]

TILE_COLUMNS: Final = 512  # columns that are combined together, so that all their source rows fit the nearest cache

# Numba does not know enums, only plain integers.
WEIGHTS, STARTS, TAPS, KERNEL, KERNEL_LENGTH, ABOVE, BELOW, FIRST_SYMMETRIC, LAST_SYMMETRIC = map(int, BandColumn)
BAND, FIRST, LAST, TOP, BOTTOM, LEFT, RIGHT, GROUPS, STRIDE, SECOND_BAND, SECOND_FIRST, SECOND_LAST = map(
    int, PassColumn
)


@compiled
def blur_window(
    row: Table, operators: Operators, source: Plane, target: Plane, transposed: int, strip: int, add: bool
) -> None:
    """Blur a window of a plane as a row of passes says; write the result to a window of the target, or add it."""
    for first in range(row[FIRST], row[LAST], row[GROUPS]):
        last = min(first + row[GROUPS], row[LAST])
        blur_rows(row, first, last, operators, source, target, transposed, strip, add)


@compiled
def blur_rows(
    row: Table,
    first: int,
    last: int,
    operators: Operators,
    source: Plane,
    target: Plane,
    transposed: int,
    strip: int,
    add: bool,
) -> None:
    """Blur some groups of rows, few enough for the transposed rows to stay in a near cache.

    They become columns of the result, whose column 0 lies at `target`, allocated or not.
    """
    columns = transposed - GROUP_ROWS * first
    combine_first(row, first, last, row[LEFT], row[RIGHT], operators, source, columns, strip)
    top, bottom = GROUP_ROWS * first, GROUP_ROWS * last
    combine_second(row, row[SECOND_FIRST], row[SECOND_LAST], top, bottom, operators, columns, target, add)


@compiled
def combine_first(
    row: Table,
    first: int,
    last: int,
    left: int,
    right: int,
    operators: Operators,
    source: Plane,
    transposed: int,
    strip: int,
) -> None:
    """First half of a blur, for some groups of its rows and some columns: combine rows and write them as columns.

    Column 0 of the written rows lies at `transposed`, allocated or not.
    """
    band, stride = operators.bands[row[BAND]], row[STRIDE]
    _clear_margins(band, first, last, operators, source, Box(row[TOP], row[BOTTOM], left, right))
    groups_per_strip = STRIP_ROWS // GROUP_ROWS
    for group in range(first, last, groups_per_strip):
        count = min(groups_per_strip, last - group)
        _combine(band, group, count, operators, source, Plane(strip - left, source.stride), left, right, False)
        target = Plane(transposed + left * stride + GROUP_ROWS * group, stride)
        transpose(operators.workspace, Plane(strip, source.stride), right - left, count, target)


@compiled
def combine_second(
    row: Table,
    first: int,
    last: int,
    top: int,
    bottom: int,
    operators: Operators,
    transposed: int,
    target: Plane,
    add: bool,
) -> None:
    """Second half of a blur, for some groups of its rows and the columns that were rows of the first half."""
    band, source = operators.bands[row[SECOND_BAND]], Plane(transposed, row[STRIDE])
    _clear_margins(band, first, last, operators, source, Box(row[LEFT], row[RIGHT], top, bottom))
    padding = (top - bottom) % COLUMN_MULTIPLE
    if padding:  # the last vector also adds these columns to the target, which holds other results there
        begin = operators.starts[band[STARTS] + first]
        stop = operators.starts[band[STARTS] + last - 1] + band[TAPS]
        clear_window(operators.workspace, source, Box(begin, stop, bottom, bottom + padding))
    rows = Plane(target.offset + GROUP_ROWS * first * target.stride, target.stride)
    _combine(band, first, last - first, operators, source, rows, top, bottom, add)


@compiled
def _combine(
    band: Table,
    first: int,
    count: int,
    operators: Operators,
    source: Plane,
    target: Plane,
    left: int,
    right: int,
    add: bool,
) -> None:
    """Write, or add, `count` groups of rows of a band's product with a plane, from the group `first` on."""
    weights, starts, workspace = operators.weights, operators.starts, operators.workspace
    taps = band[TAPS]
    right = left + (right - left + COLUMN_MULTIPLE - 1) // COLUMN_MULTIPLE * COLUMN_MULTIPLE
    for begin in range(left, right, TILE_COLUMNS):
        width = min(TILE_COLUMNS, right - begin)
        for group in range(first, first + count):
            start = source.offset + starts[band[STARTS] + group] * source.stride + begin
            rows = Plane(target.offset + GROUP_ROWS * (group - first) * target.stride + begin, target.stride)
            if band[FIRST_SYMMETRIC] <= group < band[LAST_SYMMETRIC]:
                kernel = weights[band[KERNEL] : band[KERNEL] + band[KERNEL_LENGTH]]
                above, below = start + band[ABOVE] * source.stride, start + band[BELOW] * source.stride
                combine_pairs(kernel, workspace, above, below, source.stride, rows, width, add)
            else:
                offset = band[WEIGHTS] + group * taps * GROUP_ROWS
                group_weights = weights[offset : offset + taps * GROUP_ROWS]
                _combine_rows(group_weights, workspace, Plane(start, source.stride), rows, width, add)


@compiled
def _combine_rows(weights: Floats, workspace: Floats, source: Plane, target: Plane, width: int, add: bool) -> None:
    """Compute a group of rows, each with its own weights of the same source rows."""
    offset, target_stride = target
    row0 = workspace[offset : offset + width]
    row1 = workspace[offset + target_stride : offset + target_stride + width]
    row2 = workspace[offset + 2 * target_stride : offset + 2 * target_stride + width]
    row3 = workspace[offset + 3 * target_stride : offset + 3 * target_stride + width]
    for tap in range(0, weights.size // GROUP_ROWS, TAPS_PER_STEP):
        start = source.offset + tap * source.stride
        source0 = workspace[start : start + width]
        source1 = workspace[start + source.stride : start + source.stride + width]
        source2 = workspace[start + 2 * source.stride : start + 2 * source.stride + width]
        w = weights[tap * GROUP_ROWS :]
        a0, a1, a2, a3 = w[0], w[1], w[2], w[3]
        b0, b1, b2, b3 = w[4], w[5], w[6], w[7]
        c0, c1, c2, c3 = w[8], w[9], w[10], w[11]
        if tap == 0 and not add:
            for x in range(width):
                a, b, c = source0[x], source1[x], source2[x]
                row0[x] = a0 * a + b0 * b + c0 * c
                row1[x] = a1 * a + b1 * b + c1 * c
                row2[x] = a2 * a + b2 * b + c2 * c
                row3[x] = a3 * a + b3 * b + c3 * c
        else:
            for x in range(width):
                a, b, c = source0[x], source1[x], source2[x]
                row0[x] += a0 * a + b0 * b + c0 * c
                row1[x] += a1 * a + b1 * b + c1 * c
                row2[x] += a2 * a + b2 * b + c2 * c
                row3[x] += a3 * a + b3 * b + c3 * c


@compiled
def clear_window(workspace: Floats, plane: Plane, box: Box) -> None:
    """Set a window of a plane to zero, up to the end of the last vector of each row."""
    width = (box.right - box.left + COLUMN_MULTIPLE - 1) // COLUMN_MULTIPLE * COLUMN_MULTIPLE
    for y in range(box.top, box.bottom):
        start = plane.offset + y * plane.stride + box.left
        workspace[start : start + width] = 0


@compiled
def _clear_margins(band: Table, first: int, last: int, operators: Operators, plane: Plane, box: Box) -> None:
    """Set the rows above and below a window to zero, as far as the groups `first` to `last` of a band read."""
    begin = operators.starts[band[STARTS] + first]
    stop = operators.starts[band[STARTS] + last - 1] + band[TAPS]
    clear_window(operators.workspace, plane, Box(begin, min(box.top, stop), box.left, box.right))
    clear_window(operators.workspace, plane, Box(max(box.bottom, begin), stop, box.left, box.right))

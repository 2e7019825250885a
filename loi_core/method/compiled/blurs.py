"""Separable blurs of windows of planes in an arena, compiled by Numba.

A blur is twice the same: rows are combined, and what comes out is written down transposed, so that its columns are rows
the second time. So after one blur a plane is transposed, and after two it is not; nothing here depends on which it is.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.method.compiled.compiling import compiled
from loi_core.method.compiled.records import GROUP, LANES, LINE, PAIRS, SIDE, STRIP, TAPS, BandColumn, PassColumn
from loi_core.method.compiled.vectors import add_product, filled, load_lines, load_sides, plus, store_rows, turned

__all__ = [
    "Floats",
    "Table",
    "blur_rows",
    "blur_window",
    "clear_window",
    "combine_turned",
    "transpose",
    "turn_combined",
]

Floats: TypeAlias = np.ndarray[Any, Any]
Table: TypeAlias = np.ndarray[Any, np.dtype[np.int64]]

TILE: Final = 512  # columns at a time, so that all rows that a kernel sees stay in the nearest cache

SEEN: Final = GROUP + PAIRS - 1  # rows on either side that a group needs for PAIRS distances

# Numba knows plain numbers only.
WEIGHTS, STARTS, BAND_TAPS, HALF, HALVES, ABOVE, BELOW, FIRST_ALIKE, LAST_ALIKE = map(int, BandColumn)
BAND, FIRST, LAST, TOP, BOTTOM, LEFT, RIGHT, GROUPS, STRIDE, BAND_AFTER, FIRST_AFTER, LAST_AFTER = map(int, PassColumn)


@compiled
def blur_window(
    way: Table,
    weights: Floats,
    starts: Table,
    bands: Table,
    arena: Floats,
    source: int,
    source_stride: int,
    target: int,
    target_stride: int,
    turned: int,
    strip: int,
    add: bool,
) -> None:
    """Blur a window of a plane; what lies in that of the result is the result, or has it added to it."""
    for first in range(way[FIRST], way[LAST], way[GROUPS]):
        blur_rows(
            way, first, min(first + way[GROUPS], way[LAST]), weights, starts, bands, arena, source, source_stride,
            target, target_stride, turned, strip, add,
        )  # fmt: skip


@compiled
def blur_rows(
    way: Table,
    first: int,
    last: int,
    weights: Floats,
    starts: Table,
    bands: Table,
    arena: Floats,
    source: int,
    source_stride: int,
    target: int,
    target_stride: int,
    turned: int,
    strip: int,
    add: bool,
) -> None:
    """Take some groups of rows both ways, few enough for what lies between to stay in a near cache.

    They become columns of the result, of which column 0 lies at `target`, whether it is written or not.
    """
    there = turned - GROUP * first
    turn_combined(
        way, first, last, way[LEFT], way[RIGHT], weights, starts, bands, arena, source, source_stride, there, strip
    )
    combine_turned(
        way, way[FIRST_AFTER], way[LAST_AFTER], GROUP * first, GROUP * last, weights, starts, bands, arena, there,
        target, target_stride, add,
    )  # fmt: skip


@compiled
def turn_combined(
    way: Table,
    first: int,
    last: int,
    left: int,
    right: int,
    weights: Floats,
    starts: Table,
    bands: Table,
    arena: Floats,
    source: int,
    source_stride: int,
    turned: int,
    strip: int,
) -> None:
    """The first half of a blur, for some groups of its rows and some columns: combine rows, and write them as columns.

    Column 0 of what is written lies at `turned`, whether it is written or not.
    """
    band, stride = bands[way[BAND]], way[STRIDE]
    _clear_beside(band, first, last, starts, arena, source, source_stride, way[TOP], way[BOTTOM], left, right)
    per_strip = STRIP // GROUP
    for group in range(first, last, per_strip):
        count = min(per_strip, last - group)
        to = strip - left
        _combine(
            band, group, count, weights, starts, arena, source, source_stride, to, source_stride, left, right, False
        )
        transpose(arena, strip, source_stride, right - left, count, turned + left * stride + GROUP * group, stride)


@compiled
def combine_turned(
    way: Table,
    first: int,
    last: int,
    top: int,
    bottom: int,
    weights: Floats,
    starts: Table,
    bands: Table,
    arena: Floats,
    turned: int,
    target: int,
    target_stride: int,
    add: bool,
) -> None:
    """The second half, for some groups of its rows and some columns, which the first half made of rows."""
    band, stride = bands[way[BAND_AFTER]], way[STRIDE]
    _clear_beside(band, first, last, starts, arena, turned, stride, way[LEFT], way[RIGHT], top, bottom)
    spare = (top - bottom) % LANES
    if spare:  # columns of the last vector, which would be added to what others have made there
        begin = starts[band[STARTS] + first]
        end = starts[band[STARTS] + last - 1] + band[BAND_TAPS]
        clear_window(arena, turned, stride, begin, end, bottom, bottom + spare)
    to = target + GROUP * first * target_stride
    _combine(band, first, last - first, weights, starts, arena, turned, stride, to, target_stride, top, bottom, add)


@compiled
def _combine(
    band: Table,
    first: int,
    count: int,
    weights: Floats,
    starts: Table,
    arena: Floats,
    source: int,
    source_stride: int,
    target: int,
    target_stride: int,
    left: int,
    right: int,
    add: bool,
) -> None:
    """Write rows of a band's product with a plane, from its group `first` on, or add them."""
    taps = band[BAND_TAPS]
    right = left + (right - left + LANES - 1) // LANES * LANES
    for begin in range(left, right, TILE):
        width = min(TILE, right - begin)
        for group in range(first, first + count):
            seen = source + starts[band[STARTS] + group] * source_stride + begin
            made = target + GROUP * (group - first) * target_stride + begin
            if band[FIRST_ALIKE] <= group < band[LAST_ALIKE]:
                half = weights[band[HALF] : band[HALF] + band[HALVES]]
                above, below = seen + band[ABOVE] * source_stride, seen + band[BELOW] * source_stride
                _combine_pairs(half, arena, above, below, source_stride, made, target_stride, width, add)
            else:
                w = weights[band[WEIGHTS] + group * taps * GROUP : band[WEIGHTS] + (group + 1) * taps * GROUP]
                _combine_rows(w, arena, seen, source_stride, made, target_stride, width, add)


@compiled
def _combine_rows(
    weights: Floats,
    arena: Floats,
    seen: int,
    source_stride: int,
    made: int,
    target_stride: int,
    width: int,
    add: bool,
) -> None:
    """Make a group of rows, each with weights of its own for the rows that all of them see."""
    row0 = arena[made : made + width]
    row1 = arena[made + target_stride : made + target_stride + width]
    row2 = arena[made + 2 * target_stride : made + 2 * target_stride + width]
    row3 = arena[made + 3 * target_stride : made + 3 * target_stride + width]
    for tap in range(0, weights.size // GROUP, TAPS):
        at = seen + tap * source_stride
        seen0 = arena[at : at + width]
        seen1 = arena[at + source_stride : at + source_stride + width]
        seen2 = arena[at + 2 * source_stride : at + 2 * source_stride + width]
        w = weights[tap * GROUP :]
        a0, a1, a2, a3 = w[0], w[1], w[2], w[3]
        b0, b1, b2, b3 = w[4], w[5], w[6], w[7]
        c0, c1, c2, c3 = w[8], w[9], w[10], w[11]
        if tap == 0 and not add:
            for x in range(width):
                a, b, c = seen0[x], seen1[x], seen2[x]
                row0[x] = a0 * a + b0 * b + c0 * c
                row1[x] = a1 * a + b1 * b + c1 * c
                row2[x] = a2 * a + b2 * b + c2 * c
                row3[x] = a3 * a + b3 * b + c3 * c
        else:
            for x in range(width):
                a, b, c = seen0[x], seen1[x], seen2[x]
                row0[x] += a0 * a + b0 * b + c0 * c
                row1[x] += a1 * a + b1 * b + c1 * c
                row2[x] += a2 * a + b2 * b + c2 * c
                row3[x] += a3 * a + b3 * b + c3 * c


@compiled
def _combine_pairs(
    half: Floats,
    arena: Floats,
    above: int,
    below: int,
    source_stride: int,
    made: int,
    target_stride: int,
    width: int,
    add: bool,
) -> None:
    """Make a group of rows, each with the same weights for what lies above and below it: half as many products."""
    nothing = filled(arena, arena.dtype.type(0))
    for x in range(0, width, LINE // arena.itemsize):
        sum0, sum1, sum2, sum3 = nothing, nothing, nothing, nothing
        if add:
            sum0, sum1, sum2, sum3 = load_lines(arena, made + x, target_stride, GROUP)
        up, down = above + x, below + x
        for pair in range(0, half.size, PAIRS):
            up0, up1, up2, up3, up4, up5 = load_lines(arena, up, source_stride, SEEN)
            down0, down1, down2, down3, down4, down5 = load_lines(arena, down, source_stride, SEEN)
            weight = filled(arena, half[pair])
            sum0 = add_product(sum0, weight, plus(up2, down0))
            sum1 = add_product(sum1, weight, plus(up3, down1))
            sum2 = add_product(sum2, weight, plus(up4, down2))
            sum3 = add_product(sum3, weight, plus(up5, down3))
            weight = filled(arena, half[pair + 1])
            sum0 = add_product(sum0, weight, plus(up1, down1))
            sum1 = add_product(sum1, weight, plus(up2, down2))
            sum2 = add_product(sum2, weight, plus(up3, down3))
            sum3 = add_product(sum3, weight, plus(up4, down4))
            weight = filled(arena, half[pair + 2])
            sum0 = add_product(sum0, weight, plus(up0, down2))
            sum1 = add_product(sum1, weight, plus(up1, down3))
            sum2 = add_product(sum2, weight, plus(up2, down4))
            sum3 = add_product(sum3, weight, plus(up3, down5))
            up, down = up - PAIRS * source_stride, down + PAIRS * source_stride
        store_rows(arena, made + x, target_stride, (sum0, sum1, sum2, sum3))


@compiled
def transpose(
    arena: Floats, source: int, source_stride: int, width: int, groups: int, target: int, target_stride: int
) -> None:
    """Write down `groups` groups of rows as columns; up to SIDE - 1 columns more than there are, and rows."""
    for x in range(0, width, SIDE):
        for y in range(0, GROUP * groups, SIDE):  # next to each other where they are written
            columns = turned(load_sides(arena, source + y * source_stride + x, source_stride, SIDE))
            store_rows(arena, target + x * target_stride + y, target_stride, columns)


@compiled
def clear_window(arena: Floats, plane: int, stride: int, top: int, bottom: int, left: int, right: int) -> None:
    """Write zeros to a window of a plane, and to what is left of the last vector of each row."""
    width = (right - left + LANES - 1) // LANES * LANES
    for y in range(top, bottom):
        at = plane + y * stride + left
        arena[at : at + width] = 0


@compiled
def _clear_beside(
    band: Table,
    first: int,
    last: int,
    starts: Table,
    arena: Floats,
    plane: int,
    stride: int,
    top: int,
    bottom: int,
    left: int,
    right: int,
) -> None:
    """Write zeros above and below a window of a plane, as far as some rows of a band see."""
    begin = starts[band[STARTS] + first]
    end = starts[band[STARTS] + last - 1] + band[BAND_TAPS]
    clear_window(arena, plane, stride, begin, min(top, end), left, right)
    clear_window(arena, plane, stride, max(bottom, begin), end, left, right)

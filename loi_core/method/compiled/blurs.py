"""Separable blurs of windows of planes in an arena, compiled by Numba.

A blur is twice the same: rows are combined, and what comes out is written down transposed, so that its columns are rows
the second time. So after one blur a plane is transposed, and after two it is not; nothing here depends on which it is.
"""

from __future__ import annotations

from typing import Final

from loi_core.method.compiled.compiling import compiled
from loi_core.method.compiled.records import (
    GROUP,
    LANES,
    STRIP,
    TAPS,
    BandColumn,
    Box,
    Floats,
    Operators,
    PassColumn,
    Plane,
    Table,
)
from loi_core.method.compiled.rows import combine_pairs, transpose

__all__ = [
    "Floats",
    "Table",
    "blur_rows",
    "blur_window",
    "clear_window",
    "combine_turned",
    "turn_combined",
]

TILE: Final = 512  # columns at a time, so that all rows that a kernel sees stay in the nearest cache

# Numba knows plain numbers only.
WEIGHTS, STARTS, BAND_TAPS, HALF, HALVES, ABOVE, BELOW, FIRST_ALIKE, LAST_ALIKE = map(int, BandColumn)
BAND, FIRST, LAST, TOP, BOTTOM, LEFT, RIGHT, GROUPS, STRIDE, BAND_AFTER, FIRST_AFTER, LAST_AFTER = map(int, PassColumn)


@compiled
def blur_window(
    way: Table, operators: Operators, source: Plane, target: Plane, turned: int, strip: int, add: bool
) -> None:
    """Blur a window of a plane; what lies in that of the result is the result, or has it added to it."""
    for first in range(way[FIRST], way[LAST], way[GROUPS]):
        last = min(first + way[GROUPS], way[LAST])
        blur_rows(way, first, last, operators, source, target, turned, strip, add)


@compiled
def blur_rows(
    way: Table,
    first: int,
    last: int,
    operators: Operators,
    source: Plane,
    target: Plane,
    turned: int,
    strip: int,
    add: bool,
) -> None:
    """Take some groups of rows both ways, few enough for what lies between to stay in a near cache.

    They become columns of the result, of which column 0 lies at `target`, whether it is written or not.
    """
    there = turned - GROUP * first
    turn_combined(way, first, last, way[LEFT], way[RIGHT], operators, source, there, strip)
    combine_turned(
        way, way[FIRST_AFTER], way[LAST_AFTER], GROUP * first, GROUP * last, operators, there, target, add
    )  # fmt: skip


@compiled
def turn_combined(
    way: Table,
    first: int,
    last: int,
    left: int,
    right: int,
    operators: Operators,
    source: Plane,
    turned: int,
    strip: int,
) -> None:
    """The first half of a blur, for some groups of its rows and some columns: combine rows, and write them as columns.

    Column 0 of what is written lies at `turned`, whether it is written or not.
    """
    band, stride = operators.bands[way[BAND]], way[STRIDE]
    _clear_beside(band, first, last, operators, source, Box(way[TOP], way[BOTTOM], left, right))
    per_strip = STRIP // GROUP
    for group in range(first, last, per_strip):
        count = min(per_strip, last - group)
        _combine(band, group, count, operators, source, Plane(strip - left, source.stride), left, right, False)
        to = turned + left * stride + GROUP * group
        transpose(operators.arena, Plane(strip, source.stride), right - left, count, Plane(to, stride))


@compiled
def combine_turned(
    way: Table,
    first: int,
    last: int,
    top: int,
    bottom: int,
    operators: Operators,
    turned: int,
    target: Plane,
    add: bool,
) -> None:
    """The second half, for some groups of its rows and some columns, which the first half made of rows."""
    band, source = operators.bands[way[BAND_AFTER]], Plane(turned, way[STRIDE])
    _clear_beside(band, first, last, operators, source, Box(way[LEFT], way[RIGHT], top, bottom))
    spare = (top - bottom) % LANES
    if spare:  # columns of the last vector, which would be added to what others have made there
        begin = operators.starts[band[STARTS] + first]
        end = operators.starts[band[STARTS] + last - 1] + band[BAND_TAPS]
        clear_window(operators.arena, source, Box(begin, end, bottom, bottom + spare))
    to = Plane(target.at + GROUP * first * target.stride, target.stride)
    _combine(band, first, last - first, operators, source, to, top, bottom, add)


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
    """Write rows of a band's product with a plane, from its group `first` on, or add them."""
    weights, starts, arena = operators.weights, operators.starts, operators.arena
    taps = band[BAND_TAPS]
    right = left + (right - left + LANES - 1) // LANES * LANES
    for begin in range(left, right, TILE):
        width = min(TILE, right - begin)
        for group in range(first, first + count):
            seen = source.at + starts[band[STARTS] + group] * source.stride + begin
            made = Plane(target.at + GROUP * (group - first) * target.stride + begin, target.stride)
            if band[FIRST_ALIKE] <= group < band[LAST_ALIKE]:
                half = weights[band[HALF] : band[HALF] + band[HALVES]]
                above, below = seen + band[ABOVE] * source.stride, seen + band[BELOW] * source.stride
                combine_pairs(half, arena, above, below, source.stride, made, width, add)
            else:
                w = weights[band[WEIGHTS] + group * taps * GROUP : band[WEIGHTS] + (group + 1) * taps * GROUP]
                _combine_rows(w, arena, Plane(seen, source.stride), made, width, add)


@compiled
def _combine_rows(weights: Floats, arena: Floats, source: Plane, target: Plane, width: int, add: bool) -> None:
    """Make a group of rows, each with weights of its own for the rows that all of them see."""
    seen, source_stride = source
    made, target_stride = target
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
def clear_window(arena: Floats, plane: Plane, box: Box) -> None:
    """Write zeros to a window of a plane, and to what is left of the last vector of each row."""
    width = (box.right - box.left + LANES - 1) // LANES * LANES
    for y in range(box.top, box.bottom):
        at = plane.at + y * plane.stride + box.left
        arena[at : at + width] = 0


@compiled
def _clear_beside(band: Table, first: int, last: int, operators: Operators, plane: Plane, box: Box) -> None:
    """Write zeros above and below a window of a plane, as far as some rows of a band see."""
    begin = operators.starts[band[STARTS] + first]
    end = operators.starts[band[STARTS] + last - 1] + band[BAND_TAPS]
    clear_window(operators.arena, plane, Box(begin, min(box.top, end), box.left, box.right))
    clear_window(operators.arena, plane, Box(max(box.bottom, begin), end, box.left, box.right))

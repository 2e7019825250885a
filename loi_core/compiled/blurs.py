"""Separable blurs of windows of planes in an arena, compiled by Numba.

A blur is twice the same: rows are combined, and what comes out is written down transposed, so that its columns are rows
the second time. So after one blur a plane is transposed, and after two it is not; nothing here depends on which it is.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.compiled.compiling import compiled
from loi_core.compiled.tables import GROUP, LANES, STRIP, TAPS, BandColumn, PassColumn

__all__ = ["Floats", "Table", "blur_window", "clear_window"]

Floats: TypeAlias = np.ndarray[Any, Any]
Table: TypeAlias = np.ndarray[Any, np.dtype[np.int64]]

TILE: Final = 512  # columns at a time, so that all rows that a kernel sees stay in the nearest cache

# Numba knows plain numbers only.
WEIGHTS, STARTS, BAND_TAPS = map(int, BandColumn)
BAND, FIRST, LAST, TOP, BOTTOM, LEFT, RIGHT, STRIDE, BAND_AFTER, FIRST_AFTER, LAST_AFTER = map(int, PassColumn)


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
    transposed: int,
    strip: int,
    add: bool,
) -> None:
    """Blur a window of a plane; what lies in that of the result is the result, or has it added to it."""
    left, right, stride = way[LEFT], way[RIGHT], way[STRIDE]
    band = bands[way[BAND]]
    _clear_beside(band, way[FIRST], way[LAST], starts, arena, source, source_stride, way[TOP], way[BOTTOM], left, right)
    per_strip = STRIP // GROUP
    for group in range(way[FIRST], way[LAST], per_strip):
        count = min(per_strip, way[LAST] - group)
        to = strip - left
        _combine(
            band, group, count, weights, starts, arena, source, source_stride, to, source_stride, left, right, False
        )
        _transpose(arena, strip, source_stride, right - left, count, transposed + left * stride + GROUP * group, stride)
    top, bottom = GROUP * way[FIRST], GROUP * way[LAST]
    after = bands[way[BAND_AFTER]]
    _clear_beside(after, way[FIRST_AFTER], way[LAST_AFTER], starts, arena, transposed, stride, left, right, top, bottom)
    spare = (top - bottom) % LANES
    if spare:  # columns of the last vector, which would be added to what others have made there
        begin = starts[after[STARTS] + way[FIRST_AFTER]]
        end = starts[after[STARTS] + way[LAST_AFTER] - 1] + after[BAND_TAPS]
        clear_window(arena, transposed, stride, begin, end, bottom, bottom + spare)
    first = way[FIRST_AFTER]
    to = target + GROUP * first * target_stride
    _combine(
        after, first, way[LAST_AFTER] - first, weights, starts, arena, transposed, stride, to, target_stride,
        top, bottom, add,
    )  # fmt: skip


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
        for group in range(count):
            of = first + group
            seen = source + starts[band[STARTS] + of] * source_stride + begin
            made = target + GROUP * group * target_stride + begin
            row0 = arena[made : made + width]
            row1 = arena[made + target_stride : made + target_stride + width]
            row2 = arena[made + 2 * target_stride : made + 2 * target_stride + width]
            row3 = arena[made + 3 * target_stride : made + 3 * target_stride + width]
            for tap in range(0, taps, TAPS):
                at = seen + tap * source_stride
                seen0 = arena[at : at + width]
                seen1 = arena[at + source_stride : at + source_stride + width]
                seen2 = arena[at + 2 * source_stride : at + 2 * source_stride + width]
                w = weights[band[WEIGHTS] + (of * taps + tap) * GROUP :]
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
def _transpose(
    arena: Floats, source: int, source_stride: int, width: int, groups: int, target: int, target_stride: int
) -> None:
    """Write down `groups` groups of rows as columns; up to GROUP - 1 columns more than there are."""
    for group in range(groups):
        for x in range(0, width, GROUP):
            at = source + GROUP * group * source_stride + x
            to = target + x * target_stride + GROUP * group
            row0, row1 = arena[at : at + GROUP], arena[at + source_stride : at + source_stride + GROUP]
            at += 2 * source_stride
            row2, row3 = arena[at : at + GROUP], arena[at + source_stride : at + source_stride + GROUP]
            # All are read before any is written, so that a compiler sees a square to be turned within registers.
            a0, a1, a2, a3 = row0[0], row0[1], row0[2], row0[3]
            b0, b1, b2, b3 = row1[0], row1[1], row1[2], row1[3]
            c0, c1, c2, c3 = row2[0], row2[1], row2[2], row2[3]
            d0, d1, d2, d3 = row3[0], row3[1], row3[2], row3[3]
            _write(arena, to, a0, b0, c0, d0)
            _write(arena, to + target_stride, a1, b1, c1, d1)
            _write(arena, to + 2 * target_stride, a2, b2, c2, d2)
            _write(arena, to + 3 * target_stride, a3, b3, c3, d3)


@compiled
def _write(arena: Floats, at: int, a: Any, b: Any, c: Any, d: Any) -> None:
    """Four numbers beside each other."""
    row = arena[at : at + GROUP]
    row[0], row[1], row[2], row[3] = a, b, c, d


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

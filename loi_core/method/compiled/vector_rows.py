"""Rows that are combined in pairs, and transposed, in vectors: faster than loops that Numba has to understand."""

from __future__ import annotations

from typing import Final

from loi_core.method.compiled.compiling import compiled
from loi_core.method.compiled.records import GROUP, LINE, PAIRS, SIDE, Floats, Plane
from loi_core.method.compiled.vectors import add_product, filled, load_lines, load_sides, plus, store_rows, turned

__all__ = ["combine_pairs", "transpose"]


SEEN: Final = GROUP + PAIRS - 1  # rows on either side that a group needs for PAIRS distances


@compiled
def combine_pairs(
    half: Floats,
    arena: Floats,
    above: int,
    below: int,
    source_stride: int,
    target: Plane,
    width: int,
    add: bool,
) -> None:
    """Make a group of rows, each with the same weights for what lies above and below it: half as many products."""
    made, target_stride = target
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
def transpose(arena: Floats, source: Plane, width: int, groups: int, target: Plane) -> None:
    """Write down `groups` groups of rows as columns; up to SIDE - 1 columns more than there are, and rows."""
    for x in range(0, width, SIDE):
        for y in range(0, GROUP * groups, SIDE):  # next to each other where they are written
            columns = turned(load_sides(arena, source.at + y * source.stride + x, source.stride, SIDE))
            store_rows(arena, target.at + x * target.stride + y, target.stride, columns)

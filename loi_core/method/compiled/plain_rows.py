"""Rows that are combined in pairs, and transposed, by plain loops: for a Numba whose vectors are not those we know."""

from __future__ import annotations

from loi_core.method.compiled.compiling import compiled
from loi_core.method.compiled.records import GROUP, SIDE, Floats, Plane

__all__ = ["combine_pairs", "transpose"]


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
    for row in range(GROUP):
        made = arena[target.at + row * target.stride : target.at + row * target.stride + width]
        up, down = above + (2 + row) * source_stride, below + row * source_stride
        for pair in range(half.size):
            weight, one, other = half[pair], arena[up : up + width], arena[down : down + width]
            if pair == 0 and not add:
                for x in range(width):
                    made[x] = weight * (one[x] + other[x])
            else:
                for x in range(width):
                    made[x] += weight * (one[x] + other[x])
            up, down = up - source_stride, down + source_stride


@compiled
def transpose(arena: Floats, source: Plane, width: int, groups: int, target: Plane) -> None:
    """Write down `groups` groups of rows as columns; up to SIDE - 1 columns more than there are, and rows."""
    for left in range(0, width, SIDE):
        for top in range(0, GROUP * groups, SIDE):
            for x in range(left, left + SIDE):
                for y in range(top, top + SIDE):
                    arena[target.at + x * target.stride + y] = arena[source.at + y * source.stride + x]

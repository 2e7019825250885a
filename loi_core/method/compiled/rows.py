"""Combine pairs of rows, and transpose rows: the two loops that take most of the time.

The plain loops below run with any Numba. Where the private API behind :mod:`loi_core.method.compiled.simd` works, its
hand-written vectors replace them.
"""

from __future__ import annotations

from loi_core.method.compiled.compiling import compiled
from loi_core.method.compiled.tables import GROUP_ROWS, SQUARE_SIDE, Floats, Plane

__all__ = ["combine_pairs", "plain_combine_pairs", "plain_transpose", "transpose"]


@compiled
def plain_combine_pairs(
    kernel: Floats,
    workspace: Floats,
    above: int,
    below: int,
    source_stride: int,
    target: Plane,
    width: int,
    add: bool,
) -> None:
    """Compute a group of rows with one symmetric kernel: one product for each pair of source rows above and below."""
    for row in range(GROUP_ROWS):
        start = target.offset + row * target.stride
        sums = workspace[start : start + width]
        up, down = above + (2 + row) * source_stride, below + row * source_stride
        for pair in range(kernel.size):
            weight, first, second = kernel[pair], workspace[up : up + width], workspace[down : down + width]
            if pair == 0 and not add:
                for x in range(width):
                    sums[x] = weight * (first[x] + second[x])
            else:
                for x in range(width):
                    sums[x] += weight * (first[x] + second[x])
            up, down = up - source_stride, down + source_stride


@compiled
def plain_transpose(workspace: Floats, source: Plane, width: int, groups: int, target: Plane) -> None:
    """Write groups of rows as columns, in whole squares: up to SQUARE_SIDE - 1 more rows and columns."""
    for left in range(0, width, SQUARE_SIDE):
        for top in range(0, GROUP_ROWS * groups, SQUARE_SIDE):
            for x in range(left, left + SQUARE_SIDE):
                for y in range(top, top + SQUARE_SIDE):
                    workspace[target.offset + x * target.stride + y] = workspace[source.offset + y * source.stride + x]


def _simd_works() -> bool:
    try:
        from loi_core.method.compiled import simd

        return simd.computes_correctly()
    except Exception:  # noqa: BLE001  # another Numba may fail in any way
        return False


if _simd_works():
    from loi_core.method.compiled.simd import combine_pairs, transpose
else:
    combine_pairs, transpose = plain_combine_pairs, plain_transpose

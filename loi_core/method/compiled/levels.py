"""The loss at one inner scale of one plane, level by level, compiled by Numba: each plane stays in a core's cache.

Planes lie in one arena, each at an offset, with a stride from row to row. All else are indices into tables;
:mod:`loi_core.method.compiled.records` says what they mean.
"""

from __future__ import annotations

import math
from typing import Any

from loi_core.method.compiled.blurs import (
    Floats,
    Table,
    blur_rows,
    blur_window,
    clear_window,
    combine_turned,
    turn_combined,
)
from loi_core.method.compiled.compiling import compiled, compiled_sums
from loi_core.method.compiled.exponential import exponential
from loi_core.method.compiled.misplacement import sum_misplaced, take_sums
from loi_core.method.compiled.records import GROUP, BandColumn, EdgeColumn, NodeColumn, PassColumn

__all__ = ["compare_levels"]

# Numba knows plain numbers only.
SOURCE, TARGET, FORTH, BACK = map(int, EdgeColumn)
DIFFERENCES, PULLED, NODE_STRIDE, NODE_TOP, NODE_BOTTOM, NODE_LEFT, NODE_RIGHT = map(int, NodeColumn)
BAND, FIRST, LAST, TOP, BOTTOM, LEFT, RIGHT, GROUPS, STRIDE, BAND_AFTER, FIRST_AFTER, LAST_AFTER = map(int, PassColumn)
STARTS, BAND_TAPS = map(int, (BandColumn.STARTS, BandColumn.TAPS))


@compiled
def compare_levels(
    image: Floats,
    reference: Floats,
    levels: Table,
    settings: Floats,
    weights: Floats,
    starts: Table,
    bands: Table,
    nodes: Table,
    edges: Table,
    places: Table,
    arena: Floats,
    samplings: Floats,
    sums: Floats,
    costs: Floats,
    doubts: Floats,
    cotangent: Floats,
) -> None:
    """Add the costs of some levels of one plane to `costs`, and their slope by the image to `cotangent`.

    Parameters
    ----------
    image, reference : array, shape (h, w)
        Intensities in units of the distance of two levels.
    levels : array, shape (3,)
        The level that accumulation starts from, the first that is compared, and where to stop.
    settings : array, shape (5 + E,)
        One over the tonal scale times the root of 2; the logarithm of a level's share of the CDF at its peak; the least
        such logarithm that counts; the largest difference that is a tie; the power of differences that is their cost;
        and the weight of every extent.
    weights : array, shape (W,)
    starts : array, shape (S,)
    bands, nodes, edges : array, shape (B, 9), (N, 7), (M, 2 + 2 * 12)
        Matrices, samplings and blurs. Rungs come first, one from each node to the next; then the extents.
    places : array, shape (5,)
        Offsets in the arena: of the slope of the CDF, of what is transposed, of a strip, of what is compared, and of
        what is transposed on its way back from there.
    arena : array, shape (A,)
        Finite numbers.
    samplings : array, shape (E, 2)
        float64: the spacing of the samples of each extent, along its rows' axis and its columns' as they lie there; 0
        where every pixel is compared.
    sums : array, shape (S,)
        float64 zeros: room for :func:`loi_core.method.compiled.misplacement.sum_misplaced`.
    costs : array, shape (E,)
        float64.
    doubts : array, shape (E, 2)
        float64: what :func:`loi_core.method.sampling_error.misplaced` gives for each extent is added to it.
    cotangent : array, shape (h, w) or (0, 0)
        Of size 0 if it is not wanted.
    """
    steps = nodes.shape[0] - 1
    home = nodes[0]
    differences, stride = home[DIFFERENCES], home[NODE_STRIDE]
    slope, turned, strip = places[0], places[1], places[2]
    clear_window(arena, differences, stride, home[NODE_TOP], home[NODE_BOTTOM], home[NODE_LEFT], home[NODE_RIGHT])
    clear_window(arena, slope, stride, home[NODE_TOP], home[NODE_BOTTOM], home[NODE_LEFT], home[NODE_RIGHT])
    if cotangent.size:
        clear_window(arena, home[PULLED], stride, home[NODE_TOP], home[NODE_BOTTOM], home[NODE_LEFT], home[NODE_RIGHT])
    for level in range(levels[0], levels[2]):
        _accumulate(
            image, reference, image.dtype.type(level), settings, arena, differences, slope, home, cotangent,
            cotangent.size > 0 and level > levels[1],
        )  # fmt: skip
        if level < levels[1]:
            continue
        for index in range(steps):
            edge = edges[index]
            source, target = nodes[edge[SOURCE]], nodes[edge[TARGET]]
            blur_window(
                edge[FORTH:BACK], weights, starts, bands, arena,
                source[DIFFERENCES], source[NODE_STRIDE], target[DIFFERENCES], target[NODE_STRIDE],
                turned, strip, False,
            )  # fmt: skip
        if cotangent.size:
            for node in nodes[1:]:
                clear_window(
                    arena, node[PULLED], node[NODE_STRIDE],
                    node[NODE_TOP], node[NODE_BOTTOM], node[NODE_LEFT], node[NODE_RIGHT],
                )  # fmt: skip
        for index in range(steps, edges.shape[0]):
            edge = edges[index]
            source, extent = nodes[edge[SOURCE]], edge[TARGET]
            costs[extent] += _compare_extent(
                edge, weights, starts, bands, arena, places, source, settings[3], settings[4], settings[5 + extent],
                samplings[extent], sums, doubts[extent], cotangent.size > 0,
            )  # fmt: skip
        if cotangent.size:
            for index in range(steps - 1, -1, -1):
                edge = edges[index]
                source, target = nodes[edge[SOURCE]], nodes[edge[TARGET]]
                blur_window(
                    edge[BACK:], weights, starts, bands, arena,
                    target[PULLED], target[NODE_STRIDE], source[PULLED], source[NODE_STRIDE], turned, strip, True,
                )  # fmt: skip
    if cotangent.size:
        _pull(arena, home, slope, cotangent)


@compiled
def _accumulate(
    image: Floats,
    reference: Floats,
    level: Any,
    settings: Floats,
    arena: Floats,
    differences: int,
    slope: int,
    node: Table,
    cotangent: Floats,
    pulls: bool,
) -> None:
    """Add what a level adds to the difference of the CDFs, and to the slope of the image's.

    What the level before pulled back is taken first, row by row, as its slope is about to change.
    """
    scale, peak, least = settings[0], settings[1], settings[2]
    stride, left, right = node[NODE_STRIDE], node[NODE_LEFT], node[NODE_RIGHT]
    for y in range(node[NODE_TOP], node[NODE_BOTTOM]):
        at = y * stride + left
        difference = arena[differences + at : differences + at + right - left]
        slopes = arena[slope + at : slope + at + right - left]
        ours, theirs = image[y, left:right], reference[y, left:right]
        if pulls:
            _pull_row(arena[node[PULLED] + at : node[PULLED] + at + right - left], slopes, cotangent[y, left:right])
        for x in range(right - left):
            offset = (level - ours[x]) * scale
            weight = exponential(max(peak - offset * offset, least))
            other = (level - theirs[x]) * scale
            difference[x] += weight - exponential(max(peak - other * other, least))
            slopes[x] += offset * weight


@compiled
def _compare_extent(
    edge: Table,
    weights: Floats,
    starts: Table,
    bands: Table,
    arena: Floats,
    places: Table,
    source: Table,
    tie: Any,
    power: Any,
    weight: Any,
    spacings: Floats,
    sums: Floats,
    doubt: Floats,
    gradient: bool,
) -> float:
    """The cost of one extent; its slope is added to what is pulled back to its node.

    Some rows at a time go all the way there, and as far back as they can without the others: they stay in a near cache.
    """
    forth, back = edge[FORTH:BACK], edge[BACK:]
    differences, pulled, stride = source[DIFFERENCES], source[PULLED], source[NODE_STRIDE]
    turned, strip, compared, returned = places[1], places[2], places[3], places[4]
    after = bands[back[BAND_AFTER]]
    total, done = 0.0, back[FIRST_AFTER]
    for first in range(forth[FIRST], forth[LAST], forth[GROUPS]):
        last = min(first + forth[GROUPS], forth[LAST])
        begin, end = GROUP * first, GROUP * last
        blur_rows(
            forth, first, last, weights, starts, bands, arena, differences, stride, compared - begin, forth[STRIDE],
            turned, strip, False,
        )  # fmt: skip
        left, right = max(begin, back[LEFT]), min(end, back[RIGHT])
        if gradient and spacings[0] > 0:
            sum_misplaced(
                arena, compared - begin, forth[STRIDE], back[TOP], back[BOTTOM], back[LEFT], back[RIGHT], left,
                right, spacings, tie, sums,
            )  # fmt: skip
        total += _cost(arena, compared - begin, forth[STRIDE], back[TOP], back[BOTTOM], left, right, tie, power, weight)
        if gradient:
            turn_combined(
                back, back[FIRST], back[LAST], left, right, weights, starts, bands, arena, compared - begin,
                forth[STRIDE], returned, strip,
            )  # fmt: skip
            ready = done
            while ready < back[LAST_AFTER] and (
                right == back[RIGHT] or starts[after[STARTS] + ready] + after[BAND_TAPS] <= right
            ):
                ready += 1
            if ready > done:
                combine_turned(
                    back, done, ready, GROUP * back[FIRST], GROUP * back[LAST], weights, starts, bands, arena, returned,
                    pulled, stride, True,
                )  # fmt: skip
            done = ready
    if gradient and spacings[0] > 0:
        take_sums(sums, back[BOTTOM] - back[TOP], doubt)
    return total


@compiled
def _cost(
    arena: Floats,
    plane: int,
    stride: int,
    top: int,
    bottom: int,
    left: int,
    right: int,
    tie: Any,
    power: Any,
    weight: Any,
) -> float:
    """The sum of a power of all magnitudes beyond the tie, times `weight`; its slopes replace the differences."""
    total = 0.0
    for y in range(top, bottom):
        row = arena[plane + y * stride + left : plane + y * stride + right]
        total += _sum_of_sizes(row, tie, weight) if power == 1 else _sum_of_powers(row, tie, power, weight)
    cost: float = total * weight
    return cost


@compiled_sums
def _sum_of_sizes(row: Floats, tie: Any, weight: Any) -> Any:
    """The sum of all magnitudes beyond the tie; `weight` with their signs replaces them.

    It is what :func:`_sum_of_powers` does for a power of 1, on its own since one loop for both makes all slower by a
    tenth.
    """
    nothing = weight - weight
    total = nothing
    for x in range(row.size):
        difference = row[x]
        magnitude = abs(difference)
        counts = magnitude > tie
        total += magnitude if counts else nothing
        row[x] = (weight if difference > nothing else -weight) if counts else nothing
    return total


@compiled_sums
def _sum_of_powers(row: Floats, tie: Any, power: Any, weight: Any) -> Any:
    """The sum of a power of all magnitudes beyond the tie; its slopes, times `weight`, replace the differences."""
    nothing = weight - weight
    total = nothing
    for x in range(row.size):
        difference = row[x]
        magnitude = abs(difference)
        counts = magnitude > tie
        size = magnitude if counts else row.dtype.type(1)
        if power == 0.5:
            slope = power / math.sqrt(size)
        elif power == 2:
            slope = power * size
        else:
            slope = power * size ** (power - row.dtype.type(1))
        total += size * slope if counts else nothing
        slope *= weight
        row[x] = (slope if difference > nothing else -slope) if counts else nothing
    return total / power


@compiled
def _pull(arena: Floats, node: Table, slope: int, cotangent: Floats) -> None:
    """Add what is pulled back through the tonal scale to the cotangent."""
    stride, left, right = node[NODE_STRIDE], node[NODE_LEFT], node[NODE_RIGHT]
    for y in range(node[NODE_TOP], node[NODE_BOTTOM]):
        at = y * stride + left
        pulled = arena[node[PULLED] + at : node[PULLED] + at + right - left]
        _pull_row(pulled, arena[slope + at : slope + at + right - left], cotangent[y, left:right])


@compiled
def _pull_row(pulled: Floats, slopes: Floats, row: Floats) -> None:
    """Add a row of it to a row of the cotangent, and make room for the next level's."""
    for x in range(row.size):
        row[x] += pulled[x] * slopes[x]
        pulled[x] = 0

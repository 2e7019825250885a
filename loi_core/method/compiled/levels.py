"""The loss at one inner scale of one plane, level by level, compiled by Numba: each plane stays in a core's cache.

Planes lie in one arena, each at an offset, with a stride from row to row. All else are indices into tables;
:mod:`loi_core.method.compiled.records` says what they mean.
"""

from __future__ import annotations

import math
from typing import Any

from loi_core.method.compiled.blurs import blur_rows, blur_window, clear_window, combine_turned, turn_combined
from loi_core.method.compiled.compiling import compiled, compiled_sums
from loi_core.method.compiled.exponential import exponential
from loi_core.method.compiled.misplacement import sum_misplaced, take_sums
from loi_core.method.compiled.records import (
    GROUP,
    BandColumn,
    Box,
    EdgeColumn,
    Floats,
    NodeColumn,
    Operators,
    PassColumn,
    Plane,
    Results,
    Table,
    Tables,
    Tonal,
)

__all__ = ["compare_levels", "sum_of_powers", "sum_of_sizes"]

# Numba knows plain numbers only.
SOURCE, TARGET, FORTH, BACK = map(int, EdgeColumn)
DIFFERENCES, PULLED, NODE_STRIDE, NODE_TOP, NODE_BOTTOM, NODE_LEFT, NODE_RIGHT = map(int, NodeColumn)
BAND, FIRST, LAST, TOP, BOTTOM, LEFT, RIGHT, GROUPS, STRIDE, BAND_AFTER, FIRST_AFTER, LAST_AFTER = map(int, PassColumn)
STARTS, BAND_TAPS = map(int, (BandColumn.STARTS, BandColumn.TAPS))


@compiled
def compare_levels(
    image: Floats,
    reference: Floats,
    shares: Floats,
    levels: Table,
    numbers: Floats,
    extents: Floats,
    weights: Floats,
    starts: Table,
    bands: Table,
    arena: Floats,
    nodes: Table,
    edges: Table,
    places: Table,
    spacings: Floats,
    costs: Floats,
    doubts: Floats,
    cotangent: Floats,
    sums: Floats,
) -> None:
    """Add the costs of some levels of one plane to the results, and their slope by the image.

    Only arrays pass from Python to here: Numba takes longer to look at named tuples than a small image to compare.

    Parameters
    ----------
    image, reference : array, shape (h, w)
        Intensities in units of the distance of two levels.
    shares : array, shape (h, w) or (0, 0)
        How much each pixel counts; empty if all count alike.
    levels : array, shape (3,)
        The level that accumulation starts from, the first that is compared, and where to stop.
    numbers, extents
        The fields of :class:`~loi_core.method.compiled.records.Tonal`, but the last, which is `extents`.
    weights, starts, bands, arena
        Those of :class:`~loi_core.method.compiled.records.Operators`; the arena holds finite numbers.
    nodes, edges, places, spacings
        Those of :class:`~loi_core.method.compiled.records.Tables`.
    costs, doubts, cotangent, sums
        Those of :class:`~loi_core.method.compiled.records.Results`.
    """
    _compare(
        image,
        reference,
        shares,
        levels,
        Tonal(numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], extents),
        Operators(weights, starts, bands, arena),
        Tables(nodes, edges, places, spacings),
        Results(costs, doubts, cotangent, sums),
    )


@compiled
def _compare(
    image: Floats,
    reference: Floats,
    shares: Floats,
    levels: Table,
    tonal: Tonal,
    operators: Operators,
    tables: Tables,
    results: Results,
) -> None:
    nodes, edges, places, cotangent = tables.nodes, tables.edges, tables.places, results.cotangent
    arena = operators.arena
    steps = nodes.shape[0] - 1
    start, first, stop = levels
    home = nodes[0]
    difference, slope, turned, strip = _difference(home), Plane(places[0], home[NODE_STRIDE]), places[1], places[2]
    clear_window(arena, difference, _box(home))
    clear_window(arena, slope, _box(home))
    gradient = cotangent.size > 0
    if gradient:
        clear_window(arena, _pulled(home), _box(home))
    for level in range(start, stop):
        _accumulate(
            image, reference, shares, image.dtype.type(level), tonal, arena, difference, slope, home, cotangent,
            gradient and level > first,
        )  # fmt: skip
        if level < first:
            continue
        for index in range(steps):
            edge = edges[index]
            source, target = _difference(nodes[edge[SOURCE]]), _difference(nodes[edge[TARGET]])
            blur_window(edge[FORTH:BACK], operators, source, target, turned, strip, False)
        if gradient:
            for node in nodes[1:]:
                clear_window(arena, _pulled(node), _box(node))
        for index in range(steps, edges.shape[0]):
            edge = edges[index]
            extent = edge[TARGET]
            results.costs[extent] += _compare_extent(
                edge, operators, places, nodes[edge[SOURCE]], tonal, tonal.weights[extent], tables.spacings[extent],
                results.sums, results.doubts[extent], gradient,
            )  # fmt: skip
        if gradient:
            for index in range(steps - 1, -1, -1):
                edge = edges[index]
                source, target = _pulled(nodes[edge[SOURCE]]), _pulled(nodes[edge[TARGET]])
                blur_window(edge[BACK:], operators, target, source, turned, strip, True)
    if gradient:
        _pull(arena, home, slope, cotangent)


@compiled
def _difference(node: Table) -> Plane:
    """Where the difference of the CDFs lies on a sampling."""
    return Plane(node[DIFFERENCES], node[NODE_STRIDE])


@compiled
def _pulled(node: Table) -> Plane:
    """Where what is pulled back to a sampling lies."""
    return Plane(node[PULLED], node[NODE_STRIDE])


@compiled
def _box(node: Table) -> Box:
    """Outside of which what is pulled back is 0."""
    return Box(node[NODE_TOP], node[NODE_BOTTOM], node[NODE_LEFT], node[NODE_RIGHT])


@compiled
def _accumulate(
    image: Floats,
    reference: Floats,
    shares: Floats,
    level: Any,
    tonal: Tonal,
    arena: Floats,
    differences: Plane,
    slope: Plane,
    node: Table,
    cotangent: Floats,
    pulls: bool,
) -> None:
    """Add what a level adds to the difference of the CDFs, and to the slope of the image's.

    What the level before pulled back is taken first, row by row, as its slope is about to change.
    """
    scale, peak, least = tonal.scale, tonal.peak, tonal.least
    left, right = node[NODE_LEFT], node[NODE_RIGHT]
    for y in range(node[NODE_TOP], node[NODE_BOTTOM]):
        at = y * slope.stride + left
        difference = arena[differences.at + at : differences.at + at + right - left]
        slopes = arena[slope.at + at : slope.at + at + right - left]
        ours, theirs = image[y, left:right], reference[y, left:right]
        if pulls:
            _pull_row(arena[node[PULLED] + at : node[PULLED] + at + right - left], slopes, cotangent[y, left:right])
        if shares.size > 0:
            share = shares[y, left:right]
            for x in range(right - left):
                offset = (level - ours[x]) * scale
                weight = exponential(max(peak - offset * offset, least)) * share[x]
                other = (level - theirs[x]) * scale
                difference[x] += weight - exponential(max(peak - other * other, least)) * share[x]
                slopes[x] += offset * weight
            continue
        for x in range(right - left):
            offset = (level - ours[x]) * scale
            weight = exponential(max(peak - offset * offset, least))
            other = (level - theirs[x]) * scale
            difference[x] += weight - exponential(max(peak - other * other, least))
            slopes[x] += offset * weight


@compiled
def _compare_extent(
    edge: Table,
    operators: Operators,
    places: Table,
    node: Table,
    tonal: Tonal,
    weight: Any,
    spacings: Floats,
    sums: Floats,
    doubt: Floats,
    gradient: bool,
) -> float:
    """The cost of one extent; its slope is added to what is pulled back to its node.

    Some rows at a time go all the way there, and as far back as they can without the others: they stay in a near cache.
    """
    forth, back, arena, starts = edge[FORTH:BACK], edge[BACK:], operators.arena, operators.starts
    turned, strip, compared, returned = places[1], places[2], places[3], places[4]
    after = operators.bands[back[BAND_AFTER]]
    total, done = 0.0, back[FIRST_AFTER]
    for first in range(forth[FIRST], forth[LAST], forth[GROUPS]):
        last = min(first + forth[GROUPS], forth[LAST])
        begin, end = GROUP * first, GROUP * last
        here = Plane(compared - begin, forth[STRIDE])
        blur_rows(forth, first, last, operators, _difference(node), here, turned, strip, False)
        left, right = max(begin, back[LEFT]), min(end, back[RIGHT])
        box = Box(back[TOP], back[BOTTOM], left, right)
        if gradient and spacings[0] > 0:
            sum_misplaced(arena, here, box, back[LEFT], back[RIGHT], spacings, tonal.tie, sums)
        total += _cost(arena, here, box, tonal.tie, tonal.power, weight)
        if gradient:
            turn_combined(back, back[FIRST], back[LAST], left, right, operators, here, returned, strip)
            ready = done
            while ready < back[LAST_AFTER] and (
                right == back[RIGHT] or starts[after[STARTS] + ready] + after[BAND_TAPS] <= right
            ):
                ready += 1
            if ready > done:
                top, bottom = GROUP * back[FIRST], GROUP * back[LAST]
                combine_turned(back, done, ready, top, bottom, operators, returned, _pulled(node), True)
            done = ready
    if gradient and spacings[0] > 0:
        take_sums(sums, back[BOTTOM] - back[TOP], doubt)
    return total


@compiled
def _cost(arena: Floats, plane: Plane, box: Box, tie: Any, power: Any, weight: Any) -> float:
    """The sum of a power of all magnitudes beyond the tie, times `weight`; its slopes replace the differences."""
    total = 0.0
    for y in range(box.top, box.bottom):
        at = plane.at + y * plane.stride
        row = arena[at + box.left : at + box.right]
        total += sum_of_sizes(row, tie, weight) if power == 1 else sum_of_powers(row, tie, power, weight)
    cost: float = total * weight
    return cost


@compiled_sums
def sum_of_sizes(row: Floats, tie: Any, weight: Any) -> Any:
    """The sum of all magnitudes beyond the tie; `weight` with their signs replaces them.

    It is what :func:`sum_of_powers` does for a power of 1, on its own since one loop for both makes all slower by a
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
def sum_of_powers(row: Floats, tie: Any, power: Any, weight: Any) -> Any:
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
def _pull(arena: Floats, node: Table, slope: Plane, cotangent: Floats) -> None:
    """Add what is pulled back through the tonal scale to the cotangent."""
    left, right = node[NODE_LEFT], node[NODE_RIGHT]
    for y in range(node[NODE_TOP], node[NODE_BOTTOM]):
        at = y * slope.stride + left
        pulled = arena[node[PULLED] + at : node[PULLED] + at + right - left]
        _pull_row(pulled, arena[slope.at + at : slope.at + at + right - left], cotangent[y, left:right])


@compiled
def _pull_row(pulled: Floats, slopes: Floats, row: Floats) -> None:
    """Add a row of it to a row of the cotangent, and make room for the next level's."""
    for x in range(row.size):
        row[x] += pulled[x] * slopes[x]
        pulled[x] = 0

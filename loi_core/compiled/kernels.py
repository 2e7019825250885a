"""The loss at one inner scale of one plane, level by level, compiled by Numba: each plane stays in a core's cache.

Planes lie in one arena, each at an offset, with a stride from row to row. All else are indices into tables;
:mod:`loi_core.compiled.tables` says what they mean.
"""

from __future__ import annotations

import math
from typing import Any

from loi_core.compiled.blurs import Floats, Table, blur_window, clear_window
from loi_core.compiled.compiling import compiled, compiled_sums
from loi_core.compiled.exponential import exponential
from loi_core.compiled.tables import EdgeColumn, NodeColumn

__all__ = ["compare_levels"]

# Numba knows plain numbers only.
SOURCE, TARGET, EDGE_STRIDE, EDGE_TOP, EDGE_BOTTOM, EDGE_LEFT, EDGE_RIGHT, FORTH, BACK = map(int, EdgeColumn)
HELD, PULLED, NODE_STRIDE, NODE_TOP, NODE_BOTTOM, NODE_LEFT, NODE_RIGHT = map(int, NodeColumn)


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
    costs: Floats,
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
    bands, nodes, edges : array, shape (B, 9), (N, 7), (M, 7 + 2 * 11)
        Matrices, samplings and blurs. Rungs come first, one from each node to the next; then the extents.
    places : array, shape (4,)
        Offsets in the arena: of the slope of the CDF, of a transposed plane, of planes that are compared, of a strip.
    arena : array, shape (A,)
        Finite numbers.
    costs : array, shape (E,)
        float64.
    cotangent : array, shape (h, w) or (0, 0)
        Of size 0 if it is not wanted.
    """
    rungs = nodes.shape[0] - 1
    home = nodes[0]
    held, stride = home[HELD], home[NODE_STRIDE]
    slope, transposed, compared, strip = places[0], places[1], places[2], places[3]
    clear_window(arena, held, stride, home[NODE_TOP], home[NODE_BOTTOM], home[NODE_LEFT], home[NODE_RIGHT])
    clear_window(arena, slope, stride, home[NODE_TOP], home[NODE_BOTTOM], home[NODE_LEFT], home[NODE_RIGHT])
    for level in range(levels[0], levels[2]):
        _accumulate(image, reference, image.dtype.type(level), settings, arena, held, slope, home)
        if level < levels[1]:
            continue
        for index in range(rungs):
            edge = edges[index]
            source, target = nodes[edge[SOURCE]], nodes[edge[TARGET]]
            blur_window(
                edge[FORTH:BACK], weights, starts, bands, arena,
                source[HELD], source[NODE_STRIDE], target[HELD], target[NODE_STRIDE], transposed, strip, False,
            )  # fmt: skip
        if cotangent.size:
            for node in nodes:
                clear_window(
                    arena, node[PULLED], node[NODE_STRIDE],
                    node[NODE_TOP], node[NODE_BOTTOM], node[NODE_LEFT], node[NODE_RIGHT],
                )  # fmt: skip
        for index in range(rungs, edges.shape[0]):
            edge = edges[index]
            source, extent = nodes[edge[SOURCE]], edge[TARGET]
            blur_window(
                edge[FORTH:BACK], weights, starts, bands, arena,
                source[HELD], source[NODE_STRIDE], compared, edge[EDGE_STRIDE], transposed, strip, False,
            )  # fmt: skip
            costs[extent] += _cost(arena, compared, edge, settings[3], settings[4], settings[5 + extent])
            if cotangent.size:
                blur_window(
                    edge[BACK:], weights, starts, bands, arena,
                    compared, edge[EDGE_STRIDE], source[PULLED], source[NODE_STRIDE], transposed, strip, True,
                )  # fmt: skip
        if cotangent.size:
            for index in range(rungs - 1, -1, -1):
                edge = edges[index]
                source, target = nodes[edge[SOURCE]], nodes[edge[TARGET]]
                blur_window(
                    edge[BACK:], weights, starts, bands, arena,
                    target[PULLED], target[NODE_STRIDE], source[PULLED], source[NODE_STRIDE], transposed, strip, True,
                )  # fmt: skip
            _pull(arena, home, slope, cotangent)


@compiled
def _accumulate(
    image: Floats, reference: Floats, level: Any, settings: Floats, arena: Floats, held: int, slope: int, node: Table
) -> None:
    """Add what a level adds to the difference of the CDFs, and to the slope of the image's."""
    scale, peak, least = settings[0], settings[1], settings[2]
    stride, left, right = node[NODE_STRIDE], node[NODE_LEFT], node[NODE_RIGHT]
    for y in range(node[NODE_TOP], node[NODE_BOTTOM]):
        at = y * stride + left
        difference = arena[held + at : held + at + right - left]
        slopes = arena[slope + at : slope + at + right - left]
        ours, theirs = image[y, left:right], reference[y, left:right]
        for x in range(right - left):
            offset = (level - ours[x]) * scale
            weight = exponential(max(peak - offset * offset, least))
            other = (level - theirs[x]) * scale
            difference[x] += weight - exponential(max(peak - other * other, least))
            slopes[x] += offset * weight


@compiled
def _cost(arena: Floats, planes: int, edge: Table, tie: Any, power: Any, weight: Any) -> float:
    """The sum of a power of all magnitudes beyond the tie, times `weight`; its slopes replace the differences."""
    total = 0.0
    for y in range(edge[EDGE_TOP], edge[EDGE_BOTTOM]):
        at = planes + y * edge[EDGE_STRIDE]
        row = arena[at + edge[EDGE_LEFT] : at + edge[EDGE_RIGHT]]
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
        slopes = arena[slope + at : slope + at + right - left]
        row = cotangent[y, left:right]
        for x in range(right - left):
            row[x] += pulled[x] * slopes[x]

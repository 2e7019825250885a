"""Compare the tonal levels of one plane at one inner scale, compiled by Numba: each plane stays in a core's cache.

These kernels interpret a :class:`~loi_core.method.compiled.schedule.Schedule`; the columns of its tables are in
:mod:`loi_core.method.compiled.tables`. All planes lie in one workspace, each at an offset, with a stride.
"""

from __future__ import annotations

import math
from typing import Any

from loi_core.method.compiled.blurs import blur_rows, blur_window, clear_window, combine_first, combine_second
from loi_core.method.compiled.compiling import compiled, compiled_sums
from loi_core.method.compiled.exponential import exponential
from loi_core.method.compiled.sign_errors import add_sign_errors, reduce_block_sums
from loi_core.method.compiled.tables import (
    GROUP_ROWS,
    BandColumn,
    BlurColumn,
    Box,
    Floats,
    Offset,
    Operators,
    PassColumn,
    Plane,
    PyramidColumn,
    Results,
    Table,
    Tables,
    TonalScale,
)

__all__ = ["compare_levels"]

# Numba does not know enums, only plain integers.
SOURCE, TARGET, FORWARD, ADJOINT = map(int, BlurColumn)
DIFFERENCE, COTANGENT, PLANE_STRIDE, PLANE_TOP, PLANE_BOTTOM, PLANE_LEFT, PLANE_RIGHT = map(int, PyramidColumn)
BAND, FIRST, LAST, TOP, BOTTOM, LEFT, RIGHT, GROUPS, STRIDE, SECOND_BAND, SECOND_FIRST, SECOND_LAST = map(
    int, PassColumn
)
SLOPE, TRANSPOSED, STRIP, COMPARED, RETURNED, ACCUMULATED = map(int, Offset)
STARTS, TAPS = map(int, (BandColumn.STARTS, BandColumn.TAPS))


@compiled
def compare_levels(
    planes: tuple[Floats, Floats, Floats],
    levels: tuple[int, int, int],
    tonal_scale: tuple[Floats, Floats],
    operators: tuple[Any, ...],
    tables: tuple[Any, ...],
    results: tuple[Any, ...],
) -> None:
    """Add the costs of some tonal levels of one plane to the results, and their gradient with respect to the image.

    Structs arrive as plain tuples: Numba unpacks named tuples three times more slowly.

    Parameters
    ----------
    planes : tuple of array
        The image and the reference, shape (h, w), in units of the spacing of two levels; and the weights of pixels,
        shape (h, w), or (0, 0) without weights.
    levels : tuple of int
        The first level to accumulate, the first to compare, and the end (exclusive).
    tonal_scale : tuple of array
        The scalar fields of :class:`~loi_core.method.compiled.tables.TonalScale`, shape (5,), and its extent weights.
    operators, tables, results : tuple
        The fields of :class:`~loi_core.method.compiled.tables.Operators`, `Tables` and `Results`.
    """
    numbers, extent_weights = tonal_scale
    tonal = TonalScale(numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], extent_weights)
    _compare(planes, levels, tonal, Operators(*operators), Tables(*tables), Results(*results))


@compiled
def _compare(
    planes: tuple[Floats, Floats, Floats],
    levels: tuple[int, int, int],
    tonal: TonalScale,
    operators: Operators,
    tables: Tables,
    results: Results,
) -> None:
    pyramid, blurs, offsets, cotangent = tables.pyramid, tables.blurs, tables.offsets, results.cotangent
    workspace = operators.workspace
    steps = pyramid.shape[0] - 1
    start, first, stop = levels
    base = pyramid[0]
    slope = Plane(offsets[SLOPE], base[PLANE_STRIDE])
    transposed, strip = offsets[TRANSPOSED], offsets[STRIP]
    accumulated = Plane(offsets[ACCUMULATED], base[PLANE_STRIDE])
    centred = accumulated.offset != base[DIFFERENCE]
    clear_window(workspace, accumulated, _cotangent_box(base))
    clear_window(workspace, _difference(base), _cotangent_box(base))
    clear_window(workspace, slope, _cotangent_box(base))
    gradient = cotangent.size > 0
    if gradient:
        clear_window(workspace, _cotangent(base), _cotangent_box(base))
    for level in range(start, stop):
        position = planes[0].dtype.type(level)
        _accumulate(planes, position, tonal, workspace, accumulated, slope, base, cotangent, gradient and level > first)
        if level < first:
            continue
        if centred:
            _centre_difference(workspace, accumulated, _difference(base), _cotangent_box(base), planes[2])
        for index in range(steps):
            blur = blurs[index]
            source, target = _difference(pyramid[blur[SOURCE]]), _difference(pyramid[blur[TARGET]])
            blur_window(blur[FORWARD:ADJOINT], operators, source, target, transposed, strip, False)
        if gradient:
            for coarse in pyramid[1:]:
                clear_window(workspace, _cotangent(coarse), _cotangent_box(coarse))
        for index in range(steps, blurs.shape[0]):
            blur = blurs[index]
            extent = blur[TARGET]
            results.costs[extent] += _compare_extent(
                blur, operators, offsets, pyramid[blur[SOURCE]], tonal, tonal.extent_weights[extent],
                tables.spacings[extent], results.block_sums, results.sign_errors[extent], gradient,
            )  # fmt: skip
        if gradient:
            for index in range(steps - 1, -1, -1):
                blur = blurs[index]
                source, target = _cotangent(pyramid[blur[SOURCE]]), _cotangent(pyramid[blur[TARGET]])
                blur_window(blur[ADJOINT:], operators, target, source, transposed, strip, True)
            if centred:
                _centre_cotangent(workspace, _cotangent(base), _cotangent_box(base), planes[2])
    if gradient:
        _pull_back(workspace, base, slope, cotangent)


@compiled
def _difference(level: Table) -> Plane:
    """Return the plane of a pyramid level's difference of CDFs."""
    return Plane(level[DIFFERENCE], level[PLANE_STRIDE])


@compiled
def _cotangent(level: Table) -> Plane:
    """Return the plane of a pyramid level's cotangent."""
    return Plane(level[COTANGENT], level[PLANE_STRIDE])


@compiled
def _cotangent_box(level: Table) -> Box:
    """Return the window outside which a pyramid level's cotangent is 0."""
    return Box(level[PLANE_TOP], level[PLANE_BOTTOM], level[PLANE_LEFT], level[PLANE_RIGHT])


@compiled
def _accumulate(
    planes: tuple[Floats, Floats, Floats],
    position: Any,
    tonal: TonalScale,
    workspace: Floats,
    accumulated: Plane,
    slope: Plane,
    base: Table,
    cotangent: Floats,
    pulls_back: bool,
) -> None:
    """Add one tonal level to the difference of the CDFs, and to the slope of the image's CDF.

    The cotangent of the level before is pulled back first, row by row, because its slope is about to change.
    """
    image, reference, weights = planes
    inverse_width, log_peak, min_log = tonal.inverse_width, tonal.log_peak, tonal.min_log
    left, right = base[PLANE_LEFT], base[PLANE_RIGHT]
    for y in range(base[PLANE_TOP], base[PLANE_BOTTOM]):
        begin, stop = y * slope.stride + left, y * slope.stride + right
        difference = workspace[accumulated.offset + begin : accumulated.offset + stop]
        slopes = workspace[slope.offset + begin : slope.offset + stop]
        image_row, reference_row = image[y, left:right], reference[y, left:right]
        if pulls_back:
            _pull_back_row(
                workspace[base[COTANGENT] + begin : base[COTANGENT] + stop], slopes, cotangent[y, left:right]
            )
        if weights.size > 0:
            weights_row = weights[y, left:right]
            for x in range(right - left):
                offset = (position - image_row[x]) * inverse_width
                density = exponential(max(log_peak - offset * offset, min_log)) * weights_row[x]
                reference_offset = (position - reference_row[x]) * inverse_width
                reference_density = exponential(max(log_peak - reference_offset * reference_offset, min_log))
                difference[x] += density - reference_density * weights_row[x]
                slopes[x] += offset * density
            continue
        for x in range(right - left):
            offset = (position - image_row[x]) * inverse_width
            density = exponential(max(log_peak - offset * offset, min_log))
            reference_offset = (position - reference_row[x]) * inverse_width
            difference[x] += density - exponential(max(log_peak - reference_offset * reference_offset, min_log))
            slopes[x] += offset * density


@compiled
def _centre_difference(workspace: Floats, source: Plane, target: Plane, box: Box, weights: Floats) -> None:
    """Write a weighted plane less its mean, times the weights, to another plane."""
    total, mass = 0.0, 0.0
    for y in range(box.top, box.bottom):
        start = source.offset + y * source.stride
        total += _sum(workspace[start + box.left : start + box.right])
        mass += _sum(weights[y, box.left : box.right]) if weights.size > 0 else box.right - box.left
    mean = workspace.dtype.type(total / mass if mass > 0 else 0.0)
    for y in range(box.top, box.bottom):
        start, stop = y * source.stride + box.left, y * source.stride + box.right
        row, centred_row = workspace[source.offset + start : source.offset + stop], workspace[target.offset + start :]
        if weights.size > 0:
            weights_row = weights[y, box.left : box.right]
            for x in range(row.size):
                centred_row[x] = row[x] - mean * weights_row[x]
        else:
            for x in range(row.size):
                centred_row[x] = row[x] - mean


@compiled
def _centre_cotangent(workspace: Floats, plane: Plane, box: Box, weights: Floats) -> None:
    """Subtract the weighted mean from a plane."""
    total, mass = 0.0, 0.0
    for y in range(box.top, box.bottom):
        start = plane.offset + y * plane.stride
        row = workspace[start + box.left : start + box.right]
        if weights.size > 0:
            weights_row = weights[y, box.left : box.right]
            total += _sum_of_products(row, weights_row)
            mass += _sum(weights_row)
        else:
            total += _sum(row)
            mass += row.size
    mean = workspace.dtype.type(total / mass if mass > 0 else 0.0)
    for y in range(box.top, box.bottom):
        start = plane.offset + y * plane.stride
        row = workspace[start + box.left : start + box.right]
        for x in range(row.size):
            row[x] -= mean


@compiled_sums
def _sum(row: Floats) -> float:
    """Return the sum of a row in float64."""
    total = 0.0
    for x in range(row.size):
        total += row[x]
    return total


@compiled_sums
def _sum_of_products(row: Floats, weights: Floats) -> float:
    """Return the sum of the products of two rows in float64."""
    total = 0.0
    for x in range(row.size):
        total += row[x] * weights[x]
    return total


@compiled
def _compare_extent(
    blur: Table,
    operators: Operators,
    offsets: Table,
    level: Table,
    tonal: TonalScale,
    weight: Any,
    spacings: Floats,
    block_sums: Floats,
    sign_errors: Floats,
    gradient: bool,
) -> float:
    """Return the cost of one extent; add its gradient to the cotangent of its pyramid level.

    Some rows at a time go all the way there, and back as far as they can without the other rows: they stay in a near
    cache.
    """
    forward, adjoint, workspace, starts = blur[FORWARD:ADJOINT], blur[ADJOINT:], operators.workspace, operators.starts
    transposed, strip, returned = offsets[TRANSPOSED], offsets[STRIP], offsets[RETURNED]
    second_band = operators.bands[adjoint[SECOND_BAND]]
    total, done = 0.0, adjoint[SECOND_FIRST]
    for first in range(forward[FIRST], forward[LAST], forward[GROUPS]):
        last = min(first + forward[GROUPS], forward[LAST])
        begin, stop = GROUP_ROWS * first, GROUP_ROWS * last
        compared = Plane(offsets[COMPARED] - begin, forward[STRIDE])
        blur_rows(forward, first, last, operators, _difference(level), compared, transposed, strip, False)
        left, right = max(begin, adjoint[LEFT]), min(stop, adjoint[RIGHT])
        box = Box(adjoint[TOP], adjoint[BOTTOM], left, right)
        if gradient and spacings[0] > 0:
            add_sign_errors(
                workspace, compared, box, adjoint[LEFT], adjoint[RIGHT], spacings, tonal.tie, block_sums
            )  # fmt: skip
        total += _cost(workspace, compared, box, tonal.tie, tonal.power, weight)
        if gradient:
            combine_first(adjoint, adjoint[FIRST], adjoint[LAST], left, right, operators, compared, returned, strip)
            ready = done
            while ready < adjoint[SECOND_LAST] and (
                right == adjoint[RIGHT] or starts[second_band[STARTS] + ready] + second_band[TAPS] <= right
            ):
                ready += 1
            if ready > done:
                top, bottom = GROUP_ROWS * adjoint[FIRST], GROUP_ROWS * adjoint[LAST]
                combine_second(adjoint, done, ready, top, bottom, operators, returned, _cotangent(level), True)
            done = ready
    if gradient and spacings[0] > 0:
        reduce_block_sums(block_sums, adjoint[BOTTOM] - adjoint[TOP], sign_errors)
    return total


@compiled
def _cost(workspace: Floats, plane: Plane, box: Box, tie: Any, power: Any, weight: Any) -> float:
    """Return `weight` times the sum of a power of magnitudes beyond the tie; replace differences by its gradient."""
    total = 0.0
    for y in range(box.top, box.bottom):
        start = plane.offset + y * plane.stride
        row = workspace[start + box.left : start + box.right]
        total += _sum_magnitudes(row, tie, weight) if power == 1 else _sum_powers(row, tie, power, weight)
    cost: float = total * weight
    return cost


@compiled_sums
def _sum_magnitudes(row: Floats, tie: Any, weight: Any) -> Any:
    """Return the sum of the magnitudes beyond the tie; replace each difference by `weight` with its sign.

    This is :func:`_sum_powers` for a power of 1; one loop for both would make all powers slower by a tenth.
    """
    zero = weight - weight
    total = zero
    for x in range(row.size):
        difference = row[x]
        magnitude = abs(difference)
        counts = magnitude > tie
        total += magnitude if counts else zero
        row[x] = (weight if difference > zero else -weight) if counts else zero
    return total


@compiled_sums
def _sum_powers(row: Floats, tie: Any, power: Any, weight: Any) -> Any:
    """Return the sum of a power of the magnitudes beyond the tie; replace differences by `weight` times its slope."""
    zero = weight - weight
    total = zero
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
        total += size * slope if counts else zero
        slope *= weight
        row[x] = (slope if difference > zero else -slope) if counts else zero
    return total / power


@compiled
def _pull_back(workspace: Floats, base: Table, slope: Plane, cotangent: Floats) -> None:
    """Pull the cotangent of the base level back through the tonal scale."""
    left, right = base[PLANE_LEFT], base[PLANE_RIGHT]
    for y in range(base[PLANE_TOP], base[PLANE_BOTTOM]):
        begin, stop = y * slope.stride + left, y * slope.stride + right
        row = workspace[base[COTANGENT] + begin : base[COTANGENT] + stop]
        _pull_back_row(row, workspace[slope.offset + begin : slope.offset + stop], cotangent[y, left:right])


@compiled
def _pull_back_row(pulled: Floats, slopes: Floats, cotangent: Floats) -> None:
    """Add a row of cotangents times slopes to the image's cotangent, and clear it for the next level."""
    for x in range(cotangent.size):
        cotangent[x] += pulled[x] * slopes[x]
        pulled[x] = 0

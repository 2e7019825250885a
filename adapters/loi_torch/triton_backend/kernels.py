"""The kernels: products with banded matrices along one axis, and loops over tonal levels that keep CDFs in registers.

A stack of levels has the shape (L, N, h, w) and is contiguous. Offsets between planes are computed in 64 bits. Products
are in full float32 (``"ieee"``): TF32 would lose the signs of small differences.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import triton
import triton.language as tl

__all__ = [
    "blur",
    "compare_near",
    "compare_rows",
    "compare_stack",
    "difference_columns",
    "difference_stack",
    "pull_columns",
    "pull_stack",
]


def _kernel(function: Callable[..., object]) -> Any:
    return triton.jit(function)


@_kernel
def _position(intensity: tl.tensor, first: tl.tensor, per_spacing: tl.tensor, count: tl.tensor) -> tl.tensor:
    """Return intensities in units of the spacing of two levels, as `level_positions` of the core."""
    return tl.minimum(tl.maximum((intensity - first) * per_spacing, -1.0), count)


@_kernel
def _density(level: tl.tensor, position: tl.tensor, per_width: tl.tensor, peak: tl.tensor) -> tl.tensor:
    offset = (level - position) * per_width
    return tl.exp(peak - offset * offset)


@_kernel
def _density_difference(
    level: tl.tensor, position: tl.tensor, reference_position: tl.tensor, per_width: tl.tensor, peak: tl.tensor
) -> tl.tensor:
    return _density(level, position, per_width, peak) - _density(level, reference_position, per_width, peak)


@_kernel
def _slope(level: tl.tensor, position: tl.tensor, per_width: tl.tensor, peak: tl.tensor) -> tl.tensor:
    offset = (level - position) * per_width
    return tl.exp(peak - offset * offset) * offset


@_kernel
def blur(
    source: tl.tensor,
    target: tl.tensor,
    starts: tl.tensor,
    table: tl.tensor,
    size: tl.tensor,
    cells: tl.tensor,
    lines: tl.tensor,
    depth: tl.tensor,
    source_axis: tl.tensor,
    source_line: tl.tensor,
    target_axis: tl.tensor,
    target_line: tl.tensor,
    offset: tl.tensor,
    BLOCK: tl.constexpr,
    LINES: tl.constexpr,
    DEPTH: tl.constexpr,
    OFFSET: tl.constexpr,
    ADD: tl.constexpr,
) -> None:
    """Multiply one axis of planes by a banded matrix; OFFSET subtracts from the source, ADD adds to the target."""
    plane = tl.program_id(0).to(tl.int64)
    block = tl.program_id(1)
    line = tl.program_id(2) * LINES + tl.arange(0, LINES)
    column = tl.arange(0, BLOCK)
    start = tl.load(starts + block)
    source += plane * size * lines
    total = tl.zeros((BLOCK, LINES), tl.float32)
    for step in range(0, depth, DEPTH):
        inner = step + tl.arange(0, DEPTH)
        matrix = tl.load(table + (block * depth + inner[None, :]) * BLOCK + column[:, None])
        index = start + inner
        inside = (index < size)[:, None] & (line < lines)[None, :]
        values = tl.load(source + index[:, None] * source_axis + line[None, :] * source_line, inside, 0.0)
        if OFFSET:
            values = tl.where(inside, values - offset, 0.0)
        total = tl.dot(matrix, values, total, input_precision="ieee")
    cell = block * BLOCK + column
    inside = (cell < cells)[:, None] & (line < lines)[None, :]
    target += plane * cells * lines + cell[:, None] * target_axis + line[None, :] * target_line
    if ADD:
        total += tl.load(target, inside, 0.0)
    tl.store(target, total, inside)


@_kernel
def difference_stack(
    image: tl.tensor,
    reference: tl.tensor,
    weights: tl.tensor,
    target: tl.tensor,
    pixels: tl.tensor,
    planes: tl.tensor,
    first_level: tl.tensor,
    last_level: tl.tensor,
    first: tl.tensor,
    per_spacing: tl.tensor,
    count: tl.tensor,
    per_width: tl.tensor,
    peak: tl.tensor,
    BLOCK: tl.constexpr,
    WEIGHTED: tl.constexpr,
) -> None:
    """Write the weighted differences of two images' CDFs at the levels `first_level` to `last_level`."""
    plane = tl.program_id(0).to(tl.int64)
    index = tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    inside = index < pixels
    pixel = plane * pixels + index
    position = _position(tl.load(image + pixel, inside, 0.0), first, per_spacing, count)
    reference_position = _position(tl.load(reference + pixel, inside, 0.0), first, per_spacing, count)
    total = tl.zeros((BLOCK,), tl.float32)
    for level in range(first_level):
        total += _density_difference(level, position, reference_position, per_width, peak)
    if WEIGHTED:
        weight = tl.load(weights + pixel, inside, 0.0)
    for level in range(first_level, last_level):
        total += _density_difference(level, position, reference_position, per_width, peak)
        value = total
        if WEIGHTED:
            value = total * weight
        tl.store(target + ((level - first_level) * planes + plane) * pixels + index, value, inside)


@_kernel
def difference_columns(
    image: tl.tensor,
    reference: tl.tensor,
    weights: tl.tensor,
    target: tl.tensor,
    starts: tl.tensor,
    table: tl.tensor,
    height: tl.tensor,
    width: tl.tensor,
    cells: tl.tensor,
    depth: tl.tensor,
    planes: tl.tensor,
    first_level: tl.tensor,
    last_level: tl.tensor,
    first: tl.tensor,
    per_spacing: tl.tensor,
    count: tl.tensor,
    per_width: tl.tensor,
    peak: tl.tensor,
    LEVELS: tl.constexpr,
    ROWS: tl.constexpr,
    BLOCK: tl.constexpr,
    DEPTH: tl.constexpr,
    WEIGHTED: tl.constexpr,
) -> None:
    """Blur the differences of two images' CDFs along columns, without writing them at the resolution of the images."""
    plane = tl.program_id(0).to(tl.int64)
    row = tl.program_id(1) * ROWS + tl.arange(0, ROWS)
    block = tl.program_id(2)
    start = tl.load(starts + block)
    level = (first_level + tl.arange(0, LEVELS))[:, None, None]
    column = tl.arange(0, BLOCK)
    total = tl.zeros((LEVELS * ROWS, BLOCK), tl.float32)
    for step in range(0, depth, DEPTH):
        inner = step + tl.arange(0, DEPTH)
        index = start + inner
        inside = (row < height)[:, None] & (index < width)[None, :]
        pixel = plane * height * width + row[:, None] * width + index[None, :]
        position = _position(tl.load(image + pixel, inside, 0.0), first, per_spacing, count)
        reference_position = _position(tl.load(reference + pixel, inside, 0.0), first, per_spacing, count)
        lower_levels = tl.zeros((ROWS, DEPTH), tl.float32)
        for lower in range(first_level):
            lower_levels += _density_difference(lower, position, reference_position, per_width, peak)
        density = _density_difference(level, position[None, :, :], reference_position[None, :, :], per_width, peak)
        difference = tl.cumsum(density, 0) + lower_levels[None, :, :]
        if WEIGHTED:
            difference *= tl.load(weights + pixel, inside, 0.0)[None, :, :]
        matrix = tl.load(table + (block * depth + inner[:, None]) * BLOCK + column[None, :])
        flat = tl.reshape(difference, (LEVELS * ROWS, DEPTH))
        total = tl.dot(flat, matrix, total, input_precision="ieee")
    flat_index = tl.arange(0, LEVELS * ROWS)
    level_index = flat_index // ROWS
    row_index = tl.program_id(1) * ROWS + flat_index % ROWS
    cell = block * BLOCK + column
    inside = ((level_index < last_level - first_level) & (row_index < height))[:, None] & (cell < cells)[None, :]
    line = (level_index * planes + plane) * height + row_index
    tl.store(target + line[:, None] * cells + cell[None, :], total, inside)


@_kernel
def _cost_and_slope(
    difference: tl.tensor, tie: tl.tensor, weight: tl.tensor, power: tl.tensor, PLAIN: tl.constexpr
) -> tl.tensor:
    """Return ``weight * |difference| ** power`` and its derivative; both are 0 at a tie."""
    magnitude = tl.abs(difference)
    differs = magnitude > tie
    sign = tl.where(difference > 0.0, weight, -weight)
    if PLAIN:
        slope = tl.where(differs, sign, 0.0)
        return difference * slope, slope
    safe = tl.where(differs, magnitude, 1.0)
    cost = tl.exp2(power * tl.log2(safe))
    return tl.where(differs, weight * cost, 0.0), tl.where(differs, sign * power * cost / safe, 0.0)


@_kernel
def compare_stack(
    stack: tl.tensor,
    costs: tl.tensor,
    size: tl.tensor,
    tie: tl.tensor,
    weight: tl.tensor,
    power: tl.tensor,
    BLOCK: tl.constexpr,
    STEPS: tl.constexpr,
    PLAIN: tl.constexpr,
    GRADIENT: tl.constexpr,
) -> None:
    """Replace blurred differences by the slopes of their costs, and write each program's sum of costs."""
    start = tl.program_id(0).to(tl.int64) * BLOCK * STEPS
    total = tl.zeros((BLOCK,), tl.float32)
    for step in range(STEPS):
        index = start + step * BLOCK + tl.arange(0, BLOCK)
        inside = index < size
        cost, slope = _cost_and_slope(tl.load(stack + index, inside, 0.0), tie, weight, power, PLAIN)
        total += cost
        if GRADIENT:
            tl.store(stack + index, slope, inside)
    tl.store(costs + tl.program_id(0), tl.sum(total))


@_kernel
def compare_rows(
    stack: tl.tensor,
    target: tl.tensor,
    costs: tl.tensor,
    windows: tl.tensor,
    matrices: tl.tensor,
    rows: tl.tensor,
    width: tl.tensor,
    cells: tl.tensor,
    tie: tl.tensor,
    weight: tl.tensor,
    power: tl.tensor,
    CELLS: tl.constexpr,
    ROWS: tl.constexpr,
    COLUMNS: tl.constexpr,
    PLAIN: tl.constexpr,
    GRADIENT: tl.constexpr,
) -> None:
    """Blur coarse rows up to the compared ones, and write the adjoint of that blur, applied to the slopes.

    Neither the blurred differences nor their slopes leave the registers. A program writes the coarse rows of one window
    and some columns of one plane, from all compared rows that depend on them; it counts the costs of its own rows.
    """
    plane = tl.program_id(0).to(tl.int64)
    window = tl.program_id(1)
    column = tl.program_id(2) * COLUMNS + tl.arange(0, COLUMNS)
    start = tl.load(windows + window * 5)
    first_own = tl.load(windows + window * 5 + 3)
    last_own = tl.load(windows + window * 5 + 4)
    cell = start + tl.arange(0, CELLS)
    offset = plane * cells * width + cell[:, None] * width + column[None, :]
    narrow = tl.load(stack + offset, (cell < cells)[:, None] & (column < width)[None, :], 0.0)
    matrices += window * rows * CELLS
    pulled = tl.zeros((CELLS, COLUMNS), tl.float32)
    total = tl.zeros((COLUMNS,), tl.float32)
    for step in range(0, rows, ROWS):
        row = step + tl.arange(0, ROWS)
        weights = tl.load(matrices + row[:, None] * CELLS + tl.arange(0, CELLS)[None, :])
        blurred = tl.dot(weights, narrow, input_precision="ieee")
        cost, slope = _cost_and_slope(blurred, tie, weight, power, PLAIN)
        total += tl.sum(tl.where(((row >= first_own) & (row < last_own))[:, None], cost, 0.0), 0)
        if GRADIENT:
            pulled = tl.dot(tl.trans(weights), slope, pulled, input_precision="ieee")
    if GRADIENT:
        is_core = (cell >= tl.load(windows + window * 5 + 1)) & (cell < tl.load(windows + window * 5 + 2))
        tl.store(target + offset, pulled, is_core[:, None] & (column < width)[None, :])
    program = (plane * tl.num_programs(1) + window) * tl.num_programs(2) + tl.program_id(2)
    tl.store(costs + program, tl.sum(total))


@_kernel
def compare_near(
    image: tl.tensor,
    reference: tl.tensor,
    weights: tl.tensor,
    cotangent: tl.tensor,
    costs: tl.tensor,
    row_matrices: tl.tensor,
    column_matrices: tl.tensor,
    height: tl.tensor,
    width: tl.tensor,
    row_radius: tl.tensor,
    column_radius: tl.tensor,
    first_level: tl.tensor,
    last_level: tl.tensor,
    first: tl.tensor,
    per_spacing: tl.tensor,
    count: tl.tensor,
    per_width: tl.tensor,
    peak: tl.tensor,
    scale: tl.tensor,
    tie: tl.tensor,
    weight: tl.tensor,
    power: tl.tensor,
    TILE: tl.constexpr,
    WEIGHTED: tl.constexpr,
    PLAIN: tl.constexpr,
    GRADIENT: tl.constexpr,
    ADD: tl.constexpr,
) -> None:
    """Compare a narrow extent at all levels in registers, from the images to the cotangent.

    A tile overlaps its neighbours by four radii of the blur: the blurred differences are right one radius within it,
    and their adjoint two radii within it.
    """
    plane = tl.program_id(0).to(tl.int64)
    inner = tl.arange(0, TILE)
    row = tl.program_id(1) * (TILE - 4 * row_radius) - 2 * row_radius + inner
    column = tl.program_id(2) * (TILE - 4 * column_radius) - 2 * column_radius + inner
    is_row = (row >= 0) & (row < height)
    is_column = (column >= 0) & (column < width)
    inside = is_row[:, None] & is_column[None, :]
    own_row = is_row & (inner >= 2 * row_radius) & (inner < TILE - 2 * row_radius)
    own_column = is_column & (inner >= 2 * column_radius) & (inner < TILE - 2 * column_radius)
    own = own_row[:, None] & own_column[None, :]
    entry = inner[:, None] * TILE + inner[None, :]
    row_matrix = tl.load(row_matrices + tl.program_id(1) * TILE * TILE + entry)
    column_matrix = tl.load(column_matrices + tl.program_id(2) * TILE * TILE + entry)
    pixel = plane * height * width + row[:, None] * width + column[None, :]
    position = _position(tl.load(image + pixel, inside, 0.0), first, per_spacing, count)
    reference_position = _position(tl.load(reference + pixel, inside, 0.0), first, per_spacing, count)
    if WEIGHTED:
        pixel_weight = tl.load(weights + pixel, inside, 0.0)
    cdf_difference = tl.zeros((TILE, TILE), tl.float32)
    slope = tl.zeros((TILE, TILE), tl.float32)
    pulled = tl.zeros((TILE, TILE), tl.float32)
    total = tl.zeros((TILE,), tl.float32)
    for level in range(last_level):
        cdf_difference += _density_difference(level, position, reference_position, per_width, peak)
        slope += _slope(level, position, per_width, peak)
        if level >= first_level:
            weighted = cdf_difference
            if WEIGHTED:
                weighted = cdf_difference * pixel_weight
            blurred = tl.dot(row_matrix, weighted, input_precision="ieee")
            blurred = tl.dot(blurred, tl.trans(column_matrix), input_precision="ieee")
            cost, cost_slope = _cost_and_slope(blurred, tie, weight, power, PLAIN)
            total += tl.sum(tl.where(own, cost, 0.0), 0)
            if GRADIENT:
                adjoint = tl.dot(tl.trans(row_matrix), cost_slope, input_precision="ieee")
                pulled += slope * tl.dot(adjoint, column_matrix, input_precision="ieee")
    if GRADIENT:
        pulled *= scale
        if WEIGHTED:
            pulled *= pixel_weight
        if ADD:
            pulled += tl.load(cotangent + pixel, own, 0.0)
        tl.store(cotangent + pixel, pulled, own)
    program = (plane * tl.num_programs(1) + tl.program_id(1)) * tl.num_programs(2) + tl.program_id(2)
    tl.store(costs + program, tl.sum(total))


@_kernel
def pull_stack(
    stack: tl.tensor,
    image: tl.tensor,
    weights: tl.tensor,
    cotangent: tl.tensor,
    pixels: tl.tensor,
    planes: tl.tensor,
    first_level: tl.tensor,
    last_level: tl.tensor,
    first: tl.tensor,
    per_spacing: tl.tensor,
    count: tl.tensor,
    per_width: tl.tensor,
    peak: tl.tensor,
    scale: tl.tensor,
    BLOCK: tl.constexpr,
    WEIGHTED: tl.constexpr,
    ADD: tl.constexpr,
) -> None:
    """Pull cotangents of the CDFs back to the image: the sum over levels of their product with the CDFs' slopes."""
    plane = tl.program_id(0).to(tl.int64)
    index = tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    inside = index < pixels
    pixel = plane * pixels + index
    position = _position(tl.load(image + pixel, inside, 0.0), first, per_spacing, count)
    slope = tl.zeros((BLOCK,), tl.float32)
    total = tl.zeros((BLOCK,), tl.float32)
    for level in range(first_level):
        slope += _slope(level, position, per_width, peak)
    for level in range(first_level, last_level):
        slope += _slope(level, position, per_width, peak)
        total += slope * tl.load(stack + ((level - first_level) * planes + plane) * pixels + index, inside, 0.0)
    total *= scale
    if WEIGHTED:
        total *= tl.load(weights + pixel, inside, 0.0)
    if ADD:
        total += tl.load(cotangent + pixel, inside, 0.0)
    tl.store(cotangent + pixel, total, inside)


@_kernel
def pull_columns(
    stack: tl.tensor,
    image: tl.tensor,
    weights: tl.tensor,
    cotangent: tl.tensor,
    starts: tl.tensor,
    table: tl.tensor,
    height: tl.tensor,
    width: tl.tensor,
    cells: tl.tensor,
    depth: tl.tensor,
    planes: tl.tensor,
    first_level: tl.tensor,
    last_level: tl.tensor,
    first: tl.tensor,
    per_spacing: tl.tensor,
    count: tl.tensor,
    per_width: tl.tensor,
    peak: tl.tensor,
    scale: tl.tensor,
    ROWS: tl.constexpr,
    BLOCK: tl.constexpr,
    DEPTH: tl.constexpr,
    WEIGHTED: tl.constexpr,
    ADD: tl.constexpr,
) -> None:
    """Do as `pull_stack` for the adjoint of a blur along columns, without writing its result."""
    plane = tl.program_id(0).to(tl.int64)
    row = tl.program_id(1) * ROWS + tl.arange(0, ROWS)
    block = tl.program_id(2)
    column = block * BLOCK + tl.arange(0, BLOCK)
    start = tl.load(starts + block)
    inside = (row < height)[:, None] & (column < width)[None, :]
    pixel = plane * height * width + row[:, None] * width + column[None, :]
    position = _position(tl.load(image + pixel, inside, 0.0), first, per_spacing, count)
    slope = tl.zeros((ROWS, BLOCK), tl.float32)
    total = tl.zeros((ROWS, BLOCK), tl.float32)
    for level in range(first_level):
        slope += _slope(level, position, per_width, peak)
    for level in range(first_level, last_level):
        slope += _slope(level, position, per_width, peak)
        pulled = tl.zeros((ROWS, BLOCK), tl.float32)
        line = ((level - first_level) * planes + plane) * height + row
        for step in range(0, depth, DEPTH):
            inner = step + tl.arange(0, DEPTH)
            index = start + inner
            is_cell = (row < height)[:, None] & (index < cells)[None, :]
            narrow = tl.load(stack + line[:, None] * cells + index[None, :], is_cell, 0.0)
            matrix = tl.load(table + (block * depth + inner[:, None]) * BLOCK + tl.arange(0, BLOCK)[None, :])
            pulled = tl.dot(narrow, matrix, pulled, input_precision="ieee")
        total += slope * pulled
    total *= scale
    if WEIGHTED:
        total *= tl.load(weights + pixel, inside, 0.0)
    if ADD:
        total += tl.load(cotangent + pixel, inside, 0.0)
    tl.store(cotangent + pixel, total, inside)

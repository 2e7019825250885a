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
    "compare_rows",
    "difference_columns",
    "difference_stack",
    "difference_wide_columns",
    "pull_columns",
    "pull_signs",
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
) -> None:
    """Write the differences of two images' CDFs at the levels `first_level` to `last_level`."""
    plane = tl.program_id(0).to(tl.int64)
    index = tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    inside = index < pixels
    pixel = plane * pixels + index
    position = _position(tl.load(image + pixel, inside, 0.0), first, per_spacing, count)
    reference_position = _position(tl.load(reference + pixel, inside, 0.0), first, per_spacing, count)
    total = tl.zeros((BLOCK,), tl.float32)
    for level in range(first_level):
        total += _density_difference(level, position, reference_position, per_width, peak)
    for level in range(first_level, last_level):
        total += _density_difference(level, position, reference_position, per_width, peak)
        tl.store(target + ((level - first_level) * planes + plane) * pixels + index, total, inside)


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
    own: tl.tensor,
    planes: tl.tensor,
    first_level: tl.tensor,
    last_level: tl.tensor,
    first: tl.tensor,
    per_spacing: tl.tensor,
    count: tl.tensor,
    per_width: tl.tensor,
    peak: tl.tensor,
    ROWS: tl.constexpr,
    BLOCK: tl.constexpr,
    DEPTH: tl.constexpr,
    WEIGHTED: tl.constexpr,
) -> None:
    """Blur the differences of two images' CDFs along columns, without writing them at the resolution of the images.

    All columns of a block of the matrix are in one tile, so the CDFs are summed from level to level.
    """
    plane = tl.program_id(0).to(tl.int64)
    row = tl.program_id(1) * ROWS + tl.arange(0, ROWS)
    block = tl.program_id(2)
    inner = tl.arange(0, DEPTH)
    column = tl.arange(0, BLOCK)
    cell = block * own + column
    index = tl.load(starts + block) + inner
    inside = (row < height)[:, None] & (index < width)[None, :]
    pixel = plane * height * width + row[:, None] * width + index[None, :]
    position = _position(tl.load(image + pixel, inside, 0.0), first, per_spacing, count)
    reference_position = _position(tl.load(reference + pixel, inside, 0.0), first, per_spacing, count)
    if WEIGHTED:
        weight = tl.load(weights + pixel, inside, 0.0)
    matrix = tl.load(table + (block * DEPTH + inner[:, None]) * BLOCK + column[None, :])
    is_own = (row < height)[:, None] & ((column < own) & (cell < cells))[None, :]
    difference = tl.zeros((ROWS, DEPTH), tl.float32)
    for level in range(first_level):
        difference += _density_difference(level, position, reference_position, per_width, peak)
    for level in range(first_level, last_level):
        difference += _density_difference(level, position, reference_position, per_width, peak)
        weighted = difference
        if WEIGHTED:
            weighted = difference * weight
        blurred = tl.dot(weighted, matrix, input_precision="ieee")
        line = ((level - first_level) * planes + plane) * height + row
        tl.store(target + line[:, None] * cells + cell[None, :], blurred, is_own)


@_kernel
def difference_wide_columns(
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
    """Do as `difference_columns` for a blur too wide for one tile: the sums of all levels stay in registers instead."""
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
def compare_rows(
    source: tl.tensor,
    slopes: tl.tensor,
    costs: tl.tensor,
    starts: tl.tensor,
    table: tl.tensor,
    size: tl.tensor,
    cells: tl.tensor,
    width: tl.tensor,
    depth: tl.tensor,
    tie: tl.tensor,
    weight: tl.tensor,
    power: tl.tensor,
    BLOCK: tl.constexpr,
    COLUMNS: tl.constexpr,
    DEPTH: tl.constexpr,
    PLAIN: tl.constexpr,
    GRADIENT: tl.constexpr,
) -> None:
    """Blur differences along rows, and write each program's sum of their costs, and the slopes of the costs.

    Slopes of a plain distance are signs, which are written in 2 bits each, 16 rows to a word; others are written whole.
    """
    plane = tl.program_id(0).to(tl.int64)
    block = tl.program_id(1)
    column = tl.program_id(2) * COLUMNS + tl.arange(0, COLUMNS)
    inner_row = tl.arange(0, BLOCK)
    start = tl.load(starts + block)
    source += plane * size * width
    blurred = tl.zeros((BLOCK, COLUMNS), tl.float32)
    for step in range(0, depth, DEPTH):
        inner = step + tl.arange(0, DEPTH)
        matrix = tl.load(table + (block * depth + inner[None, :]) * BLOCK + inner_row[:, None])
        index = start + inner
        inside = (index < size)[:, None] & (column < width)[None, :]
        values = tl.load(source + index[:, None] * width + column[None, :], inside, 0.0)
        blurred = tl.dot(matrix, values, blurred, input_precision="ieee")
    # Rows and columns outside have the difference 0, and neither cost nor slope.
    cost, slope = _cost_and_slope(blurred, tie, weight, power, PLAIN)
    if GRADIENT:
        if PLAIN:
            codes = tl.where(slope > 0.0, 1, tl.where(slope < 0.0, 2, 0))
            codes = codes << (2 * (inner_row % 16))[:, None]
            words = tl.sum(tl.reshape(codes, (BLOCK // 16, 16, COLUMNS)), 1)
            word = block * (BLOCK // 16) + tl.arange(0, BLOCK // 16)
            count = (cells + 15) // 16
            inside = (word < count)[:, None] & (column < width)[None, :]
            tl.store(slopes + (plane * count + word[:, None]) * width + column[None, :], words, inside)
        else:
            row = block * BLOCK + inner_row
            inside = (row < cells)[:, None] & (column < width)[None, :]
            tl.store(slopes + (plane * cells + row[:, None]) * width + column[None, :], slope, inside)
    program = (plane * tl.num_programs(1) + block) * tl.num_programs(2) + tl.program_id(2)
    tl.store(costs + program, tl.sum(cost))


@_kernel
def pull_signs(
    words: tl.tensor,
    target: tl.tensor,
    starts: tl.tensor,
    table: tl.tensor,
    count: tl.tensor,
    cells: tl.tensor,
    width: tl.tensor,
    depth: tl.tensor,
    weight: tl.tensor,
    BLOCK: tl.constexpr,
    COLUMNS: tl.constexpr,
) -> None:
    """Multiply rows of signs by a banded matrix whose blocks start at multiples of 16 rows, and by a weight."""
    plane = tl.program_id(0).to(tl.int64)
    block = tl.program_id(1)
    column = tl.program_id(2) * COLUMNS + tl.arange(0, COLUMNS)
    inner_cell = tl.arange(0, BLOCK)
    bit = tl.arange(0, 16)
    start = tl.load(starts + block) // 16
    words += plane * count * width
    total = tl.zeros((BLOCK, COLUMNS), tl.float32)
    for step in range(depth // 16):
        matrix = tl.load(table + (block * depth + step * 16 + bit[None, :]) * BLOCK + inner_cell[:, None])
        word = tl.load(words + (start + step) * width + column, (column < width) & (start + step < count), 0)
        codes = word[None, :] >> (2 * bit)[:, None]
        signs = ((codes & 1) - ((codes >> 1) & 1)).to(tl.float32)
        total = tl.dot(matrix, signs, total, input_precision="ieee")
    cell = block * BLOCK + inner_cell
    inside = (cell < cells)[:, None] & (column < width)[None, :]
    tl.store(target + (plane * cells + cell[:, None]) * width + column[None, :], total * weight, inside)


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

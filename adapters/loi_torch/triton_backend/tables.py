"""Blur matrices as the kernels read them: for each block of rows, the columns from a start, in one common number."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from torch import Tensor

from loi_core.method.gaussian import MATRICES, AxisBlur
from loi_core.support.cache import ARRAY_OVERHEAD

__all__ = ["DEPTH", "Band", "aligned_band", "band", "power_of_two", "tile_band"]

DEPTH: Final = 16  # columns in one step of a product
BLOCKS: Final = (16, 32, 64)
BLOCK_COST: Final = 16.0  # reading a column for a block costs about as much as multiplying it with this many rows

TILE_DEPTHS: Final = (32, 64)  # columns that `difference_columns` holds in registers
DIFFERENCE_COST: Final = 16.0  # a difference of two densities, in multiplications


@dataclass(frozen=True)
class Band:
    """A matrix of shape (cells, size), in blocks of rows.

    Attributes
    ----------
    size, cells : int
    own : int
        Rows of each block but the last; the others of the block are 0.
    starts : Tensor of int32, shape (blocks,)
        The first column of each block.
    table : Tensor, shape (blocks, depth, block)
        The transposed blocks, from their first column.
    """

    size: int
    cells: int
    own: int
    starts: Tensor
    table: Tensor

    @property
    def blocks(self) -> int:
        """Number of blocks of rows."""
        return int(self.table.shape[0])

    @property
    def depth(self) -> int:
        """Number of columns of a block, a multiple of DEPTH."""
        return int(self.table.shape[1])

    @property
    def block(self) -> int:
        """Number of rows of a block."""
        return int(self.table.shape[2])

    @property
    def warps(self) -> int:
        """Number of warps that hold a block of products in registers."""
        return 8 if self.block == max(BLOCKS) else 4


def band(blur: AxisBlur, device: torch.device, *, adjoint: bool) -> Band:
    """Return the matrix of a blur, or its transpose, on a device."""
    adjoint = adjoint and not blur.is_symmetric
    return _prepared(blur, device, "adjoint" if adjoint else "forward", lambda: _step_layout(blur, adjoint=adjoint))


def aligned_band(blur: AxisBlur, device: torch.device) -> Band:
    """Return the transpose of a blur in blocks that start at multiples of DEPTH, for `pull_signs`."""
    return _prepared(blur, device, "aligned", lambda: _step_layout(blur, adjoint=True, alignment=DEPTH))


def tile_band(blur: AxisBlur, device: torch.device) -> Band | None:
    """Return the matrix of a blur in blocks as deep as a tile, for `difference_columns`; None if it is too wide."""
    layout = _tile_layout(blur)
    return None if layout is None else _prepared(blur, device, "tile", lambda: layout)


def power_of_two(number: int, smallest: int = DEPTH) -> int:
    """Return the smallest power of two that is at least `number` and `smallest`."""
    return max(smallest, 1 << (number - 1).bit_length())


@dataclass(frozen=True)
class _Layout:
    """Blocks of rows of a matrix, or of its transpose, and the columns that each needs."""

    adjoint: bool
    block: int
    depth: int
    own: int
    rows: tuple[range, ...]
    columns: tuple[range, ...]

    @classmethod
    def of(cls, blur: AxisBlur, block: int, own: int, *, adjoint: bool = False, alignment: int = 1) -> _Layout:
        cells = (blur.source if adjoint else blur.target).cells
        rows = tuple(range(start, min(start + own, cells)) for start in range(0, cells, own))
        needed = [blur.rows_of(some) if adjoint else blur.columns_of(some) for some in rows]
        columns = tuple(range(some.start - some.start % alignment, some.stop) for some in needed)
        depth = -(-max(map(len, columns)) // DEPTH) * DEPTH
        return cls(adjoint, block, depth, own, rows, columns)

    def cost(self, of_column: float) -> float:
        """Return the cost of a product, where each column of a block costs as much as some rows."""
        return len(self.rows) * self.depth * (self.block + of_column)


def _step_layout(blur: AxisBlur, *, adjoint: bool, alignment: int = 1) -> _Layout:
    layouts = [_Layout.of(blur, block, block, adjoint=adjoint, alignment=alignment) for block in BLOCKS]
    return min(layouts, key=lambda layout: layout.cost(BLOCK_COST))


@functools.lru_cache(maxsize=64)
def _tile_layout(blur: AxisBlur) -> _Layout | None:
    layouts = []
    for block, depth in itertools.product(BLOCKS, TILE_DEPTHS):
        for own in range(block, block // 2, -1):
            layout = _Layout.of(blur, block, own)
            if layout.depth <= depth:
                layouts.append(replace(layout, depth=depth))
                break
    return min(layouts, key=lambda layout: layout.cost(BLOCK_COST + DIFFERENCE_COST), default=None)


def _prepared(blur: AxisBlur, device: torch.device, kind: str, layout_of: Callable[[], _Layout]) -> Band:
    key = (blur, "triton", kind, str(device))
    prepared: Band | None = MATRICES.get(key)
    if prepared is None:
        layout = layout_of()
        table = np.zeros((len(layout.rows), layout.depth, layout.block), np.float32)
        for index, (rows, columns) in enumerate(zip(layout.rows, layout.columns, strict=True)):
            entries = blur.entries(columns, rows) if layout.adjoint else blur.entries(rows, columns).T
            table[index, : len(columns), : len(rows)] = entries
        starts = np.asarray([columns.start for columns in layout.columns], np.int32)
        source, target = (blur.target, blur.source) if layout.adjoint else (blur.source, blur.target)
        tensors = (torch.as_tensor(array, device=device) for array in (starts, table))
        prepared = Band(source.cells, target.cells, layout.own, *tensors)
        MATRICES.put(key, prepared, prepared.table.numel() + ARRAY_OVERHEAD)
    return prepared

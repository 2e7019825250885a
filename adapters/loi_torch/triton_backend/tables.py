"""Blur matrices as the kernels read them: for each block of rows, the columns from a start, in one common number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor

from loi_core.method.gaussian import MATRICES, AxisBlur, Matrix
from loi_core.support.cache import ARRAY_OVERHEAD

__all__ = ["DEPTH", "TILE", "WINDOW_ROWS", "Band", "Tiles", "Windows", "band", "power_of_two", "tiles", "windows"]

DEPTH: Final = 16  # columns in one step of a product
BLOCKS: Final = (16, 32, 64)
BLOCK_COST: Final = 16.0  # reading a column for a block costs about as much as multiplying it with this many rows

WINDOW_CELLS: Final = 64  # that `compare_rows` holds in registers
WINDOW_ROWS: Final = 32  # in one step of `compare_rows`
CORES: Final = (48, 32, 16)  # cells that a window writes, where there is more than one
TILE: Final = 64
MIN_CORE: Final = 32  # pixels of a tile that are its own


@dataclass(frozen=True)
class Band:
    """A matrix of shape (cells, size), in blocks of rows.

    Attributes
    ----------
    size, cells : int
    starts : Tensor of int32, shape (blocks,)
        The first column of each block.
    table : Tensor, shape (blocks, depth, block)
        The transposed blocks, from their first column.
    """

    size: int
    cells: int
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
    key = (blur, "triton", "adjoint" if adjoint else "forward", str(device))
    prepared: Band | None = MATRICES.get(key)
    if prepared is None:
        prepared = _band(blur, device, adjoint=adjoint)
        MATRICES.put(key, prepared, prepared.table.numel() + ARRAY_OVERHEAD)
    return prepared


@dataclass(frozen=True)
class Windows:
    """A matrix that maps few cells to many rows, in windows of cells, for `compare_rows`.

    Attributes
    ----------
    windows : Tensor of int32, shape (count, 5)
        The first cell of each window; the first and last of the cells that it writes; and the first and last of its own
        rows, counted from the first that its cells are for.
    matrices : Tensor, shape (count, rows, columns)
        For each window, from `columns` cells to `rows` rows, which include all that the written cells are for.
    """

    windows: Tensor
    matrices: Tensor

    @property
    def count(self) -> int:
        """Number of windows."""
        return int(self.matrices.shape[0])


def windows(blur: AxisBlur, device: torch.device) -> Windows | None:
    """Return the matrix of a blur in windows of at most WINDOW_CELLS cells; None if they would write too few cells."""
    if blur.is_identity:
        return None
    key = (blur, "triton", "windows", str(device))
    prepared: Windows | None = MATRICES.get(key)
    if prepared is None:
        matrix = blur.matrix()
        cells = matrix.shape[1]
        for core in (cells, *CORES) if cells <= WINDOW_CELLS else CORES:
            prepared = _windows(matrix, core, device)
            if prepared is not None:
                MATRICES.put(key, prepared, prepared.matrices.numel() + ARRAY_OVERHEAD)
                break
    return prepared


def _windows(matrix: Matrix, core: int, device: torch.device) -> Windows | None:
    """Return the windows of `core` cells that are written, each from at most WINDOW_CELLS; None if that is too few."""
    height, cells = matrix.shape
    filled = matrix != 0.0
    bounds = []
    for start in range(0, cells, core):
        stop = min(start + core, cells)
        first_own, last_own = height * start // cells, height * stop // cells
        (rows,) = np.nonzero(filled[:, start:stop].any(axis=1))
        first_row, last_row = int(min([first_own, *rows[:1]])), int(max([last_own, *(rows[-1:] + 1)]))
        (columns,) = np.nonzero(filled[first_row:last_row].any(axis=0))
        first, last = int(min([start, *columns[:1]])), int(max([stop, *(columns[-1:] + 1)]))
        if last - first > WINDOW_CELLS:
            return None
        bounds.append((first, last, start, stop, first_row, last_row, first_own, last_own))
    width = power_of_two(max(last - first for first, last, *_ in bounds))
    depth = -(-max(bound[5] - bound[4] for bound in bounds) // WINDOW_ROWS) * WINDOW_ROWS
    matrices = np.zeros((len(bounds), depth, width))
    for index, (first, last, _, _, first_row, last_row, _, _) in enumerate(bounds):
        matrices[index, : last_row - first_row, : last - first] = matrix[first_row:last_row, first:last]
    table = [
        (first, start, stop, first_own - first_row, last_own - first_row)
        for first, _, start, stop, first_row, _, first_own, last_own in bounds
    ]
    return Windows(torch.as_tensor(np.asarray(table, np.int32), device=device), _tensor(matrices, device))


@dataclass(frozen=True)
class Tiles:
    """A narrow blur of an axis, as the matrices of overlapping tiles of it, for `compare_near`.

    Attributes
    ----------
    radius : int
        Radius of the kernel; tiles overlap by four of it.
    matrices : Tensor, shape (count, TILE, TILE)
        The rows whose kernel lies in the tile; the others are 0.
    """

    radius: int
    matrices: Tensor

    @property
    def count(self) -> int:
        """Number of tiles."""
        return int(self.matrices.shape[0])


def tiles(blur: AxisBlur, device: torch.device) -> Tiles | None:
    """Return the tiles of a blur; None if it is too wide for them, or changes the sampling."""
    if blur.source != blur.target or blur.radius + 1.0 > TILE / 4:
        return None
    key = (blur, "triton", "tiles", str(device))
    prepared: Tiles | None = MATRICES.get(key)
    if prepared is None:
        size = blur.source.cells
        radius = 0 if blur.is_identity else int(blur.radius)
        core = TILE - 4 * radius
        if core < MIN_CORE:
            return None
        matrices = np.zeros((-(-size // core), TILE, TILE))
        for index, tile in enumerate(matrices):
            origin = index * core - 2 * radius
            first, last = max(origin, 0), min(origin + TILE, size)
            first_row, last_row = max(origin + radius, 0), min(origin + TILE - radius, size)
            entries = blur.entries(range(first_row, last_row), range(first, last))
            tile[first_row - origin : last_row - origin, first - origin : last - origin] = entries
        prepared = Tiles(radius, _tensor(matrices, device))
        MATRICES.put(key, prepared, prepared.matrices.numel() + ARRAY_OVERHEAD)
    return prepared


def power_of_two(number: int, smallest: int = DEPTH) -> int:
    """Return the smallest power of two that is at least `number` and `smallest`."""
    return max(smallest, 1 << (number - 1).bit_length())


def _band(blur: AxisBlur, device: torch.device, *, adjoint: bool) -> Band:
    source, target = (blur.target, blur.source) if adjoint else (blur.source, blur.target)
    layouts = []
    for block in BLOCKS:
        rows = [range(start, min(start + block, target.cells)) for start in range(0, target.cells, block)]
        columns = [blur.rows_of(some) if adjoint else blur.columns_of(some) for some in rows]
        depth = -(-max(map(len, columns)) // DEPTH) * DEPTH
        layouts.append((len(rows) * depth * (block + BLOCK_COST), block, depth, rows, columns))
    _, block, depth, rows, columns = min(layouts, key=lambda layout: layout[0])
    table = np.zeros((len(rows), depth, block))
    for index, (some, needed) in enumerate(zip(rows, columns, strict=True)):
        table[index, : len(needed), : len(some)] = (
            blur.entries(needed, some) if adjoint else blur.entries(some, needed).T
        )
    starts = np.asarray([needed.start for needed in columns], np.int32)
    return Band(source.cells, target.cells, torch.as_tensor(starts, device=device), _tensor(table, device))


def _tensor(matrix: Matrix, device: torch.device) -> Tensor:
    return torch.as_tensor(matrix.astype(np.float32), device=device)

"""Blur matrices as the kernels read them: for each block of rows, the columns from a start, in one common number."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor

from loi_core.method.gaussian import MATRICES, AxisBlur, Matrix
from loi_core.support.cache import ARRAY_OVERHEAD

__all__ = ["DEPTH", "Band", "band", "dense", "power_of_two"]

DEPTH: Final = 16  # columns in one step of a product
BLOCKS: Final = (16, 32, 64)
BLOCK_COST: Final = 16.0  # reading a column for a block costs about as much as multiplying it with this many rows


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
        matrix = blur.matrix()
        prepared = _band(matrix.T if adjoint else matrix, device)
        MATRICES.put(key, prepared, prepared.table.numel() + ARRAY_OVERHEAD)
    return prepared


def dense(blur: AxisBlur, device: torch.device) -> Tensor:
    """Return the matrix of a blur, shape (target.cells, columns), padded by zeros to a power of two columns."""
    key = (blur, "triton", "dense", str(device))
    prepared: Tensor | None = MATRICES.get(key)
    if prepared is None:
        matrix = blur.matrix()
        padded = np.zeros((matrix.shape[0], power_of_two(matrix.shape[1])))
        padded[:, : matrix.shape[1]] = matrix
        prepared = _tensor(padded, device)
        MATRICES.put(key, prepared, prepared.numel() + ARRAY_OVERHEAD)
    return prepared


def power_of_two(number: int, smallest: int = DEPTH) -> int:
    """Return the smallest power of two that is at least `number` and `smallest`."""
    return max(smallest, 1 << (number - 1).bit_length())


def _band(matrix: Matrix, device: torch.device) -> Band:
    cells, size = matrix.shape
    filled = matrix != 0.0
    some = filled.any(axis=1)
    first = np.where(some, filled.argmax(axis=1), size - 1)
    stop = np.where(some, size - filled[:, ::-1].argmax(axis=1), 0)
    layouts = []
    for block in BLOCKS:
        edges = np.arange(0, cells, block)
        starts = np.minimum.reduceat(first, edges)
        widest = int(np.max(np.maximum.reduceat(stop, edges) - starts))
        depth = max(1, math.ceil(widest / DEPTH)) * DEPTH
        layouts.append((len(edges) * depth * (block + BLOCK_COST), block, depth, starts))
    _, block, depth, starts = min(layouts, key=lambda layout: layout[0])
    table = np.zeros((len(starts), depth, block))
    for index, start in enumerate(starts):
        entries = matrix[index * block : (index + 1) * block, start : start + depth]
        table[index, : entries.shape[1], : entries.shape[0]] = entries.T
    return Band(size, cells, torch.as_tensor(starts.astype(np.int32), device=device), _tensor(table, device))


def _tensor(matrix: Matrix, device: torch.device) -> Tensor:
    return torch.as_tensor(matrix.astype(np.float32), device=device)

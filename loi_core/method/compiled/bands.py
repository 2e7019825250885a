"""Band matrices of blurs in the layout of the kernels: a few rows at a time, and only their nonzero columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.method.compiled.tables import GROUP_ROWS, PAIRS_PER_STEP, TAPS_PER_STEP, BandColumn, Floats, Table
from loi_core.method.gaussian import MATRICES, AxisBlur, Matrix
from loi_core.support.cache import ARRAY_OVERHEAD

__all__ = ["Band", "BandTable", "SymmetricGroups", "adjoint_band", "forward_band"]

CHUNK_ROWS: Final = 16 * GROUP_ROWS  # rows of a matrix that are computed together

Entries: TypeAlias = Callable[[range], tuple[range, Matrix]]
"""From some rows of a matrix to their nonzero columns, and the entries there."""


@dataclass(frozen=True)
class SymmetricGroups:
    """Groups of rows that share one symmetric kernel, which needs half as many products.

    Attributes
    ----------
    groups : range
    kernel : array, shape (P,)
        Weights at the distances `nearest`, `nearest` + 1, ..., on either side; P is a multiple of PAIRS_PER_STEP.
        Distances below 0 are padding, with weights of 0. Distance 0 is met twice, so its weight is halved.
    nearest : int
    centre : int
        Kernel centre of a group's first row, counted from the group's start.
    """

    groups: range
    kernel: Floats
    nearest: int
    centre: int

    @property
    def table_row(self) -> tuple[int, ...]:
        """The columns of the table from BandColumn.KERNEL_LENGTH on."""
        above, below = self.centre - self.nearest - (PAIRS_PER_STEP - 1), self.centre + self.nearest
        return len(self.kernel), above, below, self.groups.start, self.groups.stop

    @classmethod
    def of(cls, weights: Floats, starts: Table) -> SymmetricGroups:
        """Return the groups around the middle group of a band that share its kernel; none if it is not symmetric."""
        middle = len(starts) // 2
        none = cls(range(0), weights[:0, 0, 0], 0, 0)
        (nonzero,) = np.nonzero(weights[middle, :, 0])
        if (
            len(nonzero) < 2 * PAIRS_PER_STEP - 1
            or len(nonzero) % 2 == 0
            or nonzero[-1] + GROUP_ROWS > weights.shape[1]
        ):
            return none
        kernel = weights[middle, nonzero[0] : nonzero[-1] + 1, 0]
        shifted = np.zeros_like(weights[middle])
        for row in range(GROUP_ROWS):
            shifted[nonzero[0] + row : nonzero[0] + row + len(kernel), row] = kernel
        if not (np.array_equal(kernel, kernel[::-1]) and np.array_equal(shifted, weights[middle])):
            return none
        steps = GROUP_ROWS * (np.arange(len(starts)) - middle)
        different = np.flatnonzero(~(np.all(weights == shifted, axis=(1, 2)) & (starts - starts[middle] == steps)))
        groups = range(
            max(different[different < middle], default=-1) + 1, min(different[different > middle], default=len(starts))
        )
        radius = len(kernel) // 2
        padding = -(radius + 1) % PAIRS_PER_STEP
        half = np.concat([np.zeros(padding, kernel.dtype), kernel[radius:]])
        half[padding] *= 0.5
        return cls(groups, half, -padding, int(nonzero[0]) + radius)


@dataclass(frozen=True)
class Band:
    """A band matrix, in groups of rows.

    Attributes
    ----------
    rows, columns : int
        Shape of the matrix.
    weights : array, shape (G, T, GROUP_ROWS)
        T nonzero columns of GROUP_ROWS rows at a time; 0 for rows beyond the matrix.
    starts : array, shape (G,)
        The first of these columns, never decreasing. They may reach beyond the last column, with weights of 0.
    symmetric : SymmetricGroups
    """

    rows: int
    columns: int
    weights: Floats
    starts: Table
    symmetric: SymmetricGroups

    @property
    def taps(self) -> int:
        """Number of columns of each group."""
        return int(self.weights.shape[1])

    @property
    def height(self) -> int:
        """Number of rows of a plane to allocate as input of the band or output of its transpose.

        Kernels read and write whole groups of rows, also beyond the last column of the band.
        """
        return max(-(-self.columns // GROUP_ROWS) * GROUP_ROWS, int(self.starts[-1]) + self.taps)

    @classmethod
    def of(cls, rows: int, columns: int, entries: Entries, dtype: np.dtype[Any]) -> Band:
        """Return the band of a matrix of `rows` by `columns`, from its entries."""
        groups = []
        for first in range(0, rows, CHUNK_ROWS):
            chunk = range(first, min(first + CHUNK_ROWS, rows))
            support, matrix = entries(chunk)
            groups += [
                _group(support.start, matrix[row : row + GROUP_ROWS], dtype) for row in range(0, len(chunk), GROUP_ROWS)
            ]
        starts = np.asarray([start for start, _ in groups], np.int64)
        stops = np.asarray([start + len(weights) for start, weights in groups], np.int64)
        starts = np.minimum.accumulate(starts[::-1])[::-1]
        taps = -(-int(np.max(stops - starts)) // TAPS_PER_STEP) * TAPS_PER_STEP
        # Near the end of the axis a group would often reach beyond it by a column or two.
        starts = np.minimum(starts, max(columns - taps, 0))
        table = np.zeros((len(groups), taps, GROUP_ROWS), dtype)
        for index, (start, weights) in enumerate(groups):
            shift = start - int(starts[index])
            table[index, shift : shift + len(weights), : weights.shape[1]] = weights
        return cls(rows, columns, table, starts, SymmetricGroups.of(table, starts))


def _group(first: int, matrix: Matrix, dtype: np.dtype[Any]) -> tuple[int, Floats]:
    """Return the first nonzero column of a few rows, and the rows from there to the last one, transposed."""
    # Subnormal weights change nothing, and products with them may take a processor a hundred times as long.
    normal = np.abs(matrix) >= np.finfo(dtype).tiny
    (nonzero,) = np.nonzero(np.any(normal, axis=0))
    start, stop = (int(nonzero[0]), int(nonzero[-1]) + 1) if len(nonzero) else (0, 0)
    return first + start, np.where(normal, matrix, 0.0)[:, start:stop].astype(dtype).T


@dataclass(frozen=True)
class BandTable:
    """Several bands, with their arrays concatenated.

    Attributes
    ----------
    bands : tuple of Band
    weights : array, shape (W,)
    starts : array, shape (S,)
    table : array, shape (B, 9)
        See :class:`loi_core.method.compiled.tables.BandColumn`.
    """

    bands: tuple[Band, ...]
    weights: Floats
    starts: Table
    table: Table

    @classmethod
    def of(cls, bands: Sequence[Band]) -> BandTable:
        """Return the table of some bands."""
        table = np.zeros((len(bands), len(BandColumn)), np.int64)
        arrays: list[Floats] = []
        weights = starts = 0
        for row, band in zip(table, bands, strict=True):
            row[:] = weights, starts, band.taps, weights + band.weights.size, *band.symmetric.table_row
            arrays += [band.weights.ravel(), band.symmetric.kernel]
            weights += band.weights.size + band.symmetric.kernel.size
            starts += band.starts.size
        return cls(tuple(bands), np.concat(arrays), np.concat([band.starts for band in bands]), table)


def forward_band(blur: AxisBlur, dtype: np.dtype[Any]) -> Band:
    """Return the matrix of a blur."""

    def entries(rows: range) -> tuple[range, Matrix]:
        columns = blur.columns_of(rows)
        return columns, blur.entries(rows, columns)

    return _cached(blur, dtype, entries, adjoint=False)


def adjoint_band(blur: AxisBlur, dtype: np.dtype[Any]) -> Band:
    """Return the transposed matrix of a blur."""
    if blur.is_symmetric:
        return forward_band(blur, dtype)

    def entries(columns: range) -> tuple[range, Matrix]:
        rows = blur.rows_of(columns)
        return rows, blur.entries(rows, columns).T

    return _cached(blur, dtype, entries, adjoint=True)


def _cached(blur: AxisBlur, dtype: np.dtype[Any], entries: Entries, *, adjoint: bool) -> Band:
    key = (blur, "numba", dtype, adjoint)
    band: Band | None = MATRICES.get(key)
    if band is None:
        shape = (blur.source.cells, blur.target.cells) if adjoint else (blur.target.cells, blur.source.cells)
        band = Band.of(*shape, entries, dtype)
        MATRICES.put(key, band, band.weights.size + ARRAY_OVERHEAD)
    return band

"""The matrices of blurs as the kernels want them: a few rows at a time, and only the columns that they see."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.method.compiled.records import GROUP, PAIRS, TAPS, BandColumn
from loi_core.method.gaussian import AxisBlur, Matrix
from loi_core.support.cache import ARRAY_OVERHEAD, Cache

__all__ = ["Band", "Bands", "Numbers", "Pairs", "band_back", "band_forth"]

Numbers: TypeAlias = np.ndarray[Any, Any]

CHUNK: Final = 16 * GROUP  # rows of a matrix that are computed together
CACHED_ELEMENTS: Final = 2**22


@dataclass(frozen=True)
class Pairs:
    """Weights that are the same for all rows of some groups, and for what lies above and below each row.

    Attributes
    ----------
    groups : range
    half : array, shape (P,)
        Of the rows at the distances `nearest`, `nearest` + 1 and so on, either way. P is a multiple of PAIRS; what
        there is too many has distances below 0 and weights of 0. A row itself, which is met twice, has half its weight.
    nearest : int
    middle : int
        What the first row of a group has as its middle, counted from the first that the group sees.
    """

    groups: range
    half: Numbers
    nearest: int
    middle: int

    @property
    def row(self) -> tuple[int, ...]:
        """What the table says of them, from BandColumn.HALVES on."""
        above, below = self.middle - self.nearest - (PAIRS - 1), self.middle + self.nearest
        return len(self.half), above, below, self.groups.start, self.groups.stop

    @classmethod
    def among(cls, weights: Numbers, starts: np.ndarray[Any, np.dtype[np.int64]]) -> Pairs:
        """Those groups about the middle one of a band that have such weights; maybe none."""
        about = len(starts) // 2
        none = cls(range(0), weights[:0, 0, 0], 0, 0)
        (seen,) = np.nonzero(weights[about, :, 0])
        if len(seen) < 2 * PAIRS - 1 or len(seen) % 2 == 0 or seen[-1] + GROUP > weights.shape[1]:
            return none
        kernel = weights[about, seen[0] : seen[-1] + 1, 0]
        alike = np.zeros_like(weights[about])
        for row in range(GROUP):
            alike[seen[0] + row : seen[0] + row + len(kernel), row] = kernel
        if not (np.array_equal(kernel, kernel[::-1]) and np.array_equal(alike, weights[about])):
            return none
        same = np.all(weights == alike, axis=(1, 2)) & (
            starts - starts[about] == GROUP * (np.arange(len(starts)) - about)
        )
        others = np.flatnonzero(~same)
        groups = range(max(others[others < about], default=-1) + 1, min(others[others > about], default=len(starts)))
        distance = len(kernel) // 2
        filling = -(distance + 1) % PAIRS
        half = np.concat([np.zeros(filling, kernel.dtype), kernel[distance:]])
        half[filling] *= 0.5
        return cls(groups, half, -filling, int(seen[0]) + distance)


@dataclass(frozen=True)
class Band:
    """A matrix that is 0 away from a band, in groups of rows.

    Attributes
    ----------
    rows, columns : int
        Shape of the matrix.
    weights : array, shape (G, T, GROUP)
        Of GROUP rows at a time and the T columns that they see; 0 for rows that the matrix does not have.
    starts : array, shape (G,)
        The first of these columns, never decreasing. They may reach beyond the last, with weights of 0.
    pairs : Pairs
        The same weights, where they take half as many products.
    """

    rows: int
    columns: int
    weights: Numbers
    starts: np.ndarray[Any, np.dtype[np.int64]]
    pairs: Pairs

    @property
    def taps(self) -> int:
        """How many columns each group sees."""
        return int(self.weights.shape[1])

    @property
    def height(self) -> int:
        """How many rows there have to be of planes that it is multiplied with, or that are made in their place."""
        return max(-(-self.columns // GROUP) * GROUP, int(self.starts[-1]) + self.taps)

    @classmethod
    def of(cls, rows: int, columns: int, part: Callable[[range], tuple[range, Matrix]], dtype: np.dtype[Any]) -> Band:
        """The band of a matrix of which `part` gives some rows: the columns that they see, and what is there."""
        groups = []
        for first in range(0, rows, CHUNK):
            within = range(first, min(first + CHUNK, rows))
            seen, matrix = part(within)
            groups += [_group(seen.start, matrix[at : at + GROUP], dtype) for at in range(0, len(within), GROUP)]
        starts = np.asarray([start for start, _ in groups], np.int64)
        ends = np.asarray([start + len(weights) for start, weights in groups], np.int64)
        starts = np.minimum.accumulate(starts[::-1])[::-1]
        taps = -(-int(np.max(ends - starts)) // TAPS) * TAPS
        # Near the end of the axis a band would often reach beyond it by a column or two.
        starts = np.minimum(starts, max(columns - taps, 0))
        table = np.zeros((len(groups), taps, GROUP), dtype)
        for index, (start, weights) in enumerate(groups):
            at = start - int(starts[index])
            table[index, at : at + len(weights), : weights.shape[1]] = weights
        return cls(rows, columns, table, starts, Pairs.among(table, starts))


def _group(first: int, matrix: Matrix, dtype: np.dtype[Any]) -> tuple[int, Numbers]:
    """Where a few rows begin to differ from 0, and what they are from there to where they no longer do, transposed."""
    # What no longer has all digits of its dtype adds nothing, and may take a processor a hundred times as long.
    (seen,) = np.nonzero(np.any(np.abs(matrix) >= np.finfo(dtype).tiny, axis=0))
    start, stop = (int(seen[0]), int(seen[-1]) + 1) if len(seen) else (0, 0)
    within = matrix[:, start:stop]
    return first + start, np.where(np.abs(within) >= np.finfo(dtype).tiny, within, 0.0).astype(dtype).T


@dataclass(frozen=True)
class Bands:
    """Several bands, with all that they hold one after another.

    Attributes
    ----------
    each : tuple of Band
    weights : array, shape (W,)
    starts : array, shape (S,)
    table : array, shape (B, 9)
        A row for each; see :class:`loi_core.method.compiled.records.BandColumn`.
    """

    each: tuple[Band, ...]
    weights: Numbers
    starts: np.ndarray[Any, np.dtype[np.int64]]
    table: np.ndarray[Any, np.dtype[np.int64]]

    @classmethod
    def of(cls, bands: Sequence[Band]) -> Bands:
        """These bands."""
        table = np.zeros((len(bands), len(BandColumn)), np.int64)
        parts: list[Numbers] = []
        weights = starts = 0
        for row, band in zip(table, bands, strict=True):
            row[:] = weights, starts, band.taps, weights + band.weights.size, *band.pairs.row
            parts += [band.weights.ravel(), band.pairs.half]
            weights, starts = weights + band.weights.size + band.pairs.half.size, starts + band.starts.size
        return cls(tuple(bands), np.concat(parts), np.concat([band.starts for band in bands]), table)


_CACHE: Final = Cache[tuple[AxisBlur, np.dtype[Any], bool], Band](CACHED_ELEMENTS)


def band_forth(blur: AxisBlur, dtype: np.dtype[Any]) -> Band:
    """The matrix of a blur."""

    def part(rows: range) -> tuple[range, Matrix]:
        columns = blur.support(rows)
        return columns, blur.entries(rows, columns)

    return _kept(blur, dtype, part, back=False)


def band_back(blur: AxisBlur, dtype: np.dtype[Any]) -> Band:
    """The transpose of the matrix of a blur."""
    if blur.transposes:
        return band_forth(blur, dtype)

    def part(columns: range) -> tuple[range, Matrix]:
        rows = blur.support_of_columns(columns)
        return rows, blur.entries(rows, columns).T

    return _kept(blur, dtype, part, back=True)


def _kept(blur: AxisBlur, dtype: np.dtype[Any], part: Callable[[range], tuple[range, Matrix]], *, back: bool) -> Band:
    key = (blur, dtype, back)
    found = _CACHE.get(key)
    if found is None:
        sizes = (blur.source.cells, blur.target.cells) if back else (blur.target.cells, blur.source.cells)
        found = Band.of(*sizes, part, dtype)
        _CACHE.put(key, found, found.weights.size + ARRAY_OVERHEAD)
    return found

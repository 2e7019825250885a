"""Samplings of planes, and Gaussian blurs between them: descriptions of what to compute, with its cost."""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass
from typing import Final

from loi_core.method.gaussian import AxisBlur, AxisGrid
from loi_core.method.windows import Window

__all__ = ["PlaneBlur", "PlaneGrid", "row_blocks"]

BLOCK_SIZES: Final = (32, 64, 128, 256, 512)
MAX_BLOCKS: Final = 64
MIN_PRODUCT_SIZE: Final = 16  # a matrix product with fewer rows or columns costs about as much as with this many


@dataclass(frozen=True)
class PlaneGrid:
    """A sampling of the pixels of a plane."""

    rows: AxisGrid
    columns: AxisGrid

    @classmethod
    def pixels(cls, height: int, width: int) -> PlaneGrid:
        """Return the sampling whose samples are the pixels."""
        return cls(AxisGrid(height, height), AxisGrid(width, width))

    @property
    def cells(self) -> int:
        """Number of samples."""
        return self.rows.cells * self.columns.cells

    @property
    def transposed(self) -> PlaneGrid:
        """The sampling of the transposed plane."""
        return PlaneGrid(self.columns, self.rows)

    def __str__(self) -> str:
        return f"{self.rows}x{self.columns}"


@dataclass(frozen=True)
class PlaneBlur:
    """A Gaussian blur from one sampling of a plane to another."""

    rows: AxisBlur
    columns: AxisBlur

    @property
    def source(self) -> PlaneGrid:
        """Sampling of the input."""
        return PlaneGrid(self.rows.source, self.columns.source)

    @property
    def target(self) -> PlaneGrid:
        """Sampling of the output."""
        return PlaneGrid(self.rows.target, self.columns.target)

    @property
    def is_identity(self) -> bool:
        """Whether the blur changes nothing."""
        return self.rows.is_identity and self.columns.is_identity

    @property
    def columns_first(self) -> bool:
        """Whether blurring the horizontal axis first costs less."""
        return self._work(columns_first=True) <= self._work(columns_first=False)

    @property
    def work(self) -> float:
        """Multiplications and additions for one plane; the adjoint takes about as many."""
        return min(self._work(columns_first=True), self._work(columns_first=False))

    def support_of(self, window: Window) -> Window:
        """Return the window outside which blurred planes are 0 if the planes are 0 outside `window`."""
        if self.is_identity:
            return window
        if window.shape == (self.rows.source.cells, self.columns.source.cells):
            return Window.whole(self.rows.target.cells, self.columns.target.cells)
        return Window(self.rows.rows_of(window.rows), self.columns.rows_of(window.columns))

    def adjoint_support_of(self, window: Window) -> Window:
        """Return the window outside which the adjoint is 0 if its planes are 0 outside `window`."""
        if self.is_identity:
            return window
        if window.shape == (self.rows.target.cells, self.columns.target.cells):
            return Window.whole(self.rows.source.cells, self.columns.source.cells)
        return Window(self.rows.columns_of(window.rows), self.columns.columns_of(window.columns))

    def _work(self, *, columns_first: bool) -> float:
        if self.is_identity:
            return 0.0
        rows, columns = _blocking(self.rows).work, _blocking(self.columns).work
        if columns_first:
            return columns * self.rows.source.cells + rows * self.columns.target.cells
        return rows * self.columns.source.cells + columns * self.rows.target.cells


def row_blocks(blur: AxisBlur) -> tuple[range, ...]:
    """Return the blocks of rows in which the matrix of a blur is applied with the least work.

    Narrow kernels take narrow blocks and cost little per pixel; for a kernel as wide as the axis, one block remains.
    """
    return _blocking(blur).blocks


@dataclass(frozen=True)
class _Blocking:
    blocks: tuple[range, ...]
    work: float  # multiplications and additions for one line of the axis


@functools.lru_cache(maxsize=1024)
def _blocking(blur: AxisBlur) -> _Blocking:
    return min((_blocks_of(blur, size) for size in BLOCK_SIZES), key=lambda blocking: blocking.work)


def _blocks_of(blur: AxisBlur, size: int) -> _Blocking:
    cells = blur.target.cells
    count = min(max(1, round(cells / size)), MAX_BLOCKS)
    edges = [cells * index // count for index in range(count + 1)]
    blocks = tuple(range(start, stop) for start, stop in itertools.pairwise(edges))
    work = sum(
        2.0 * max(len(block), MIN_PRODUCT_SIZE) * (len(blur.columns_of(block)) + MIN_PRODUCT_SIZE) for block in blocks
    )
    return _Blocking(blocks, work)

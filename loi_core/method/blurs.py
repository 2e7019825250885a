"""Blurs of stacks of planes, as products with small matrices: the same code on every array library.

Per axis a blur is a matrix that is zero away from a band, so it is applied in blocks: some rows at a time, on the
part of the axis that they see. Narrow kernels take narrow blocks and cost little per pixel; where the kernel is as
wide as the axis one block remains, the dense matrix. Which blocks are best is reckoned from their sizes.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass
from typing import Final, Protocol, TypeAlias

import numpy as np

from loi_core.method.gaussian import AxisBlur, AxisGrid, Matrix
from loi_core.method.scales import Boundary
from loi_core.method.windows import Window
from loi_core.support.arrays import (
    Array,
    device,
    from_numpy,
    library_name,
    matrix_product,
    namespace,
    outlives_its_context,
)
from loi_core.support.cache import ARRAY_OVERHEAD, Cache

__all__ = ["Blur", "DenseBlur", "GaussianBlur", "PlaneBlur", "PlaneGrid", "blur_about", "gaussian_blur"]

BLOCK_SIZES: Final = (32, 64, 128, 256, 512)
MAX_BLOCKS: Final = 64
CACHED_ELEMENTS: Final = 2**24  # 64 MiB in float32, and as much memory on every device together
PANEL: Final = 16  # a product with fewer rows or columns than this costs about as much as with this many


class Blur(Protocol):
    """A linear map of planes, shape (..., H, W), to planes, shape (..., h, w)."""

    def apply(self, planes: Array) -> Array:
        """The blurred planes, shape (..., h, w)."""

    def adjoint(self, planes: Array) -> Array:
        """The transpose of :meth:`apply`: planes of shape (..., h, w) to shape (..., H, W)."""


@dataclass(frozen=True)
class PlaneGrid:
    """A sampling of the pixels of a plane."""

    rows: AxisGrid
    columns: AxisGrid

    @classmethod
    def pixels(cls, height: int, width: int) -> PlaneGrid:
        """The pixels themselves."""
        return cls(AxisGrid(height, height), AxisGrid(width, width))

    @property
    def cells(self) -> int:
        """Number of samples."""
        return self.rows.cells * self.columns.cells

    @property
    def transposed(self) -> PlaneGrid:
        """The same of the transposed plane."""
        return PlaneGrid(self.columns, self.rows)

    def __str__(self) -> str:
        return f"{self.rows}x{self.columns}"


@dataclass(frozen=True)
class PlaneBlur:
    """A Gaussian blur from one sampling of a plane to another: what is to be computed, not yet how."""

    rows: AxisBlur
    columns: AxisBlur

    @property
    def source(self) -> PlaneGrid:
        """Where its input is sampled."""
        return PlaneGrid(self.rows.source, self.columns.source)

    @property
    def target(self) -> PlaneGrid:
        """Where its output is sampled."""
        return PlaneGrid(self.rows.target, self.columns.target)

    @property
    def is_identity(self) -> bool:
        """Whether nothing changes."""
        return self.rows.is_identity and self.columns.is_identity

    @property
    def columns_first(self) -> bool:
        """Whether the horizontal axis comes first, which is where there is less to do then."""
        return self._work(columns_first=True) <= self._work(columns_first=False)

    @property
    def work(self) -> float:
        """Multiplications and additions for one plane, forwards; the adjoint takes about as many."""
        return min(self._work(columns_first=True), self._work(columns_first=False))

    def reached(self, window: Window) -> Window:
        """Where the blurred planes are not 0 if the planes are 0 outside `window`."""
        if self.is_identity:
            return window
        if window.shape == (self.rows.source.cells, self.columns.source.cells):
            return Window.whole(self.rows.target.cells, self.columns.target.cells)
        return Window(self.rows.support_of_columns(window.rows), self.columns.support_of_columns(window.columns))

    def reached_back(self, window: Window) -> Window:
        """Where the adjoint is not 0 if its planes are 0 outside `window`."""
        if self.is_identity:
            return window
        if window.shape == (self.rows.target.cells, self.columns.target.cells):
            return Window.whole(self.rows.source.cells, self.columns.source.cells)
        return Window(self.rows.support(window.rows), self.columns.support(window.columns))

    def _work(self, *, columns_first: bool) -> float:
        if self.is_identity:
            return 0.0
        rows, columns = _blocking(self.rows).work, _blocking(self.columns).work
        if columns_first:
            return columns * self.rows.source.cells + rows * self.columns.target.cells
        return rows * self.columns.source.cells + columns * self.rows.target.cells


@dataclass(frozen=True)
class _Blocking:
    """Which rows of an axis' matrix are applied together."""

    blocks: tuple[range, ...]
    work: float  # multiplications and additions for one line of the axis


@functools.lru_cache(maxsize=1024)
def _blocking(blur: AxisBlur) -> _Blocking:
    """The blocks that take the least work."""
    return min((_blocks_of(blur, size) for size in BLOCK_SIZES), key=lambda blocking: blocking.work)


def _blocks_of(blur: AxisBlur, size: int) -> _Blocking:
    cells = blur.target.cells
    count = min(max(1, round(cells / size)), MAX_BLOCKS)
    edges = [cells * index // count for index in range(count + 1)]
    blocks = tuple(range(start, stop) for start, stop in itertools.pairwise(edges))
    work = sum(2.0 * max(len(block), PANEL) * (len(blur.support(block)) + PANEL) for block in blocks)
    return _Blocking(blocks, work)


@dataclass(frozen=True)
class _Block:
    """Some rows of a matrix, the part of the axis that they see, and both ways to multiply with them."""

    rows: range
    seen: range
    left: Array
    right: Array

    @classmethod
    def of(cls, rows: range, seen: range, matrix: Matrix, like: Array) -> _Block:
        left = from_numpy(np.ascontiguousarray(matrix), like)
        return cls(rows, seen, left, from_numpy(np.ascontiguousarray(matrix.T), like))

    def within(self, given: range, wanted: range) -> _Block | None:
        """The part that makes `wanted` of `given`; None if it makes nothing of what is wanted."""
        rows, seen = _common(self.rows, wanted), _common(self.seen, given)
        if not rows:
            return None
        down = slice(rows.start - self.rows.start, rows.stop - self.rows.start)
        if not seen:
            return _Block(rows, range(1), 0.0 * self.left[down, :1], 0.0 * self.right[:1, down])
        across = slice(seen.start - self.seen.start, seen.stop - self.seen.start)
        moved = range(seen.start - given.start, seen.stop - given.start)
        return _Block(rows, moved, self.left[down, across], self.right[across, down])


def _common(one: range, other: range) -> range:
    return range(max(one.start, other.start), min(one.stop, other.stop))


@dataclass(frozen=True)
class _AxisProduct:
    """A matrix, in blocks of rows."""

    blocks: tuple[_Block, ...]

    @classmethod
    def forward(cls, blur: AxisBlur, like: Array) -> _AxisProduct:
        blocks = []
        for rows in _blocking(blur).blocks:
            columns = blur.support(rows)
            blocks.append(_Block.of(rows, columns, blur.entries(rows, columns), like))
        return cls(tuple(blocks))

    @classmethod
    def backward(cls, blur: AxisBlur, like: Array) -> _AxisProduct:
        mirror = AxisBlur(blur.target, blur.source, blur.scale, blur.boundary, blur.taps, blur.cut)
        blocks = []
        for columns in _blocking(mirror).blocks:
            rows = blur.support_of_columns(columns)
            blocks.append(_Block.of(columns, rows, blur.entries(rows, columns).T, like))
        return cls(tuple(blocks))

    def within(self, given: range, wanted: range) -> _AxisProduct:
        """What makes `wanted` of an axis of which only `given` is there, the rest being 0."""
        parts = (block.within(given, wanted) for block in self.blocks)
        return _AxisProduct(tuple(part for part in parts if part is not None))

    def along_rows(self, planes: Array) -> Array:
        """The product with the vertical axis of planes, shape (..., H, W)."""
        parts = [
            matrix_product(block.left, planes[..., block.seen.start : block.seen.stop, :]) for block in self.blocks
        ]
        return parts[0] if len(parts) == 1 else namespace(planes).concat(parts, axis=-2)

    def along_columns(self, planes: Array) -> Array:
        """The product with the horizontal axis of planes, shape (..., H, W)."""
        parts = [matrix_product(planes[..., block.seen.start : block.seen.stop], block.right) for block in self.blocks]
        return parts[0] if len(parts) == 1 else namespace(planes).concat(parts, axis=-1)

    @property
    def elements(self) -> int:
        """Numbers that it holds."""
        return sum(2 * math.prod(block.left.shape) for block in self.blocks)


_Key: TypeAlias = tuple[AxisBlur, str, str, str]


def _elements(pair: tuple[_AxisProduct, _AxisProduct]) -> int:
    forward, backward = pair
    return forward.elements + (0 if backward is forward else backward.elements)


_CACHE: Final = Cache[_Key, tuple[_AxisProduct, _AxisProduct]](CACHED_ELEMENTS)


def _products(blur: AxisBlur, like: Array) -> tuple[_AxisProduct, _AxisProduct]:
    """The matrix and its transpose, for arrays like `like`."""
    key = (blur, library_name(like), str(like.dtype), str(device(like)))
    found = _CACHE.get(key)
    if found is not None:
        return found
    forward = _AxisProduct.forward(blur, like)
    pair = (forward, forward if blur.transposes else _AxisProduct.backward(blur, like))
    if outlives_its_context(forward.blocks[0].left):
        _CACHE.put(key, pair, _elements(pair) + 2 * ARRAY_OVERHEAD)
    return pair


class GaussianBlur:
    """A blur that is ready to run on arrays like one array.

    Parameters
    ----------
    blur : PlaneBlur
        What to compute.
    like : array
        Its library, dtype and device are those of the matrices.
    """

    def __init__(self, blur: PlaneBlur, like: Array) -> None:
        self._blur = blur
        self._columns_first = blur.columns_first
        self._source = Window.whole(blur.source.rows.cells, blur.source.columns.cells)
        self._target = Window.whole(blur.target.rows.cells, blur.target.columns.cells)
        self._rows, self._rows_back = _products(blur.rows, like)
        self._columns, self._columns_back = _products(blur.columns, like)

    @property
    def blur(self) -> PlaneBlur:
        """What it computes."""
        return self._blur

    def apply(self, planes: Array, window: Window | None = None) -> Array:
        """The blurred planes, shape (..., h, w).

        With a `window`, `planes` are what lies in it of planes that are 0 elsewhere, and so is the result of
        :meth:`PlaneBlur.reached`.
        """
        if self._blur.is_identity:
            return planes
        rows, columns = self._rows, self._columns
        if window is not None and window != self._source:
            reached = self._blur.reached(window)
            rows = rows.within(window.rows, reached.rows)
            columns = columns.within(window.columns, reached.columns)
        if self._columns_first:
            return rows.along_rows(columns.along_columns(planes))
        return columns.along_columns(rows.along_rows(planes))

    def adjoint(self, planes: Array, window: Window | None = None) -> Array:
        """The transpose of :meth:`apply`: planes of shape (..., h, w) to shape (..., H, W).

        With a `window`, `planes` are what lies in it, and the result is what lies in its
        :meth:`PlaneBlur.reached_back`.
        """
        if self._blur.is_identity:
            return planes
        rows, columns = self._rows_back, self._columns_back
        if window is not None and window != self._target:
            reached = self._blur.reached_back(window)
            rows = rows.within(window.rows, reached.rows)
            columns = columns.within(window.columns, reached.columns)
        if self._columns_first:
            return columns.along_columns(rows.along_rows(planes))
        return rows.along_rows(columns.along_columns(planes))


@dataclass(frozen=True)
class DenseBlur:
    """A separable linear map as one dense matrix per axis.

    Attributes
    ----------
    rows : array, shape (h, H)
        Acts on the vertical axis.
    columns : array, shape (w, W)
        Acts on the horizontal axis.
    """

    rows: Array
    columns: Array

    def apply(self, planes: Array) -> Array:
        """``rows @ planes @ columns.T`` for every plane."""
        return _sandwich(self.rows, planes, self.columns)

    def adjoint(self, planes: Array) -> Array:
        """``rows.T @ planes @ columns`` for every plane."""
        return _sandwich(self.rows.T, planes, self.columns.T)


def _sandwich(left: Array, planes: Array, right: Array) -> Array:
    xp = namespace(planes)
    *stack, height, width = planes.shape
    across = matrix_product(xp.reshape(planes, (-1, width)), right.T)
    return matrix_product(left, xp.reshape(across, (*stack, height, right.shape[0])))


def blur_about(blur: Blur, planes: Array, padding: float) -> Array:
    """`planes` blurred as if `padding`, not 0, lay outside them. Its adjoint is that of the blur."""
    return blur.apply(planes) if padding == 0.0 else blur.apply(planes - padding) + padding


def gaussian_blur(
    height: int, width: int, scale: float, boundary: Boundary, *, like: Array, taps: int | None = None
) -> Blur:
    """The Gaussian blur of planes of `height` by `width` pixels, for arrays like `like`.

    Parameters
    ----------
    height, width : int
        Size of the planes.
    scale : float
        Standard deviation in pixels; 0 gives the identity.
    boundary, taps
        See :class:`loi_core.method.gaussian.AxisBlur`.
    like : array
        Its library, dtype and device are those of the operator.
    """
    pixels = PlaneGrid.pixels(height, width)
    rows = AxisBlur(pixels.rows, pixels.rows, scale, boundary, taps)
    columns = AxisBlur(pixels.columns, pixels.columns, scale, boundary, taps)
    return GaussianBlur(PlaneBlur(rows, columns), like)

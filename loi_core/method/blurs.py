"""Blurs of stacks of planes, as products with small matrices: one implementation for every array library.

Per axis, a blur is a band matrix. It is applied in blocks of rows, each to the part of the axis that it depends on
(:func:`loi_core.method.plane_blurs.row_blocks`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from loi_core.method.gaussian import MATRICES, AxisBlur, Matrix
from loi_core.method.plane_blurs import PlaneBlur, PlaneGrid, row_blocks
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
from loi_core.support.cache import ARRAY_OVERHEAD

__all__ = ["Blur", "DenseBlur", "GaussianBlur", "blur_about", "gaussian_blur"]


class Blur(Protocol):
    """A linear map of planes, shape (..., H, W), to planes, shape (..., h, w)."""

    def apply(self, planes: Array) -> Array:
        """Return the blurred planes, shape (..., h, w)."""

    def adjoint(self, planes: Array) -> Array:
        """Apply the transpose of :meth:`apply`: planes of shape (..., h, w) to shape (..., H, W)."""


@dataclass(frozen=True)
class _Block:
    """Some rows of a matrix, the columns where they are not 0, and both factors to multiply with them."""

    rows: range
    columns: range
    left: Array
    right: Array

    @classmethod
    def of(cls, rows: range, columns: range, matrix: Matrix, like: Array) -> _Block:
        left = from_numpy(np.ascontiguousarray(matrix), like)
        return cls(rows, columns, left, from_numpy(np.ascontiguousarray(matrix.T), like))

    def crop(self, source: range, target: range) -> _Block | None:
        """Return the submatrix from `source` to `target`; None if the block has no rows in `target`."""
        rows, columns = _intersection(self.rows, target), _intersection(self.columns, source)
        if not rows:
            return None
        vertical = slice(rows.start - self.rows.start, rows.stop - self.rows.start)
        if not columns:
            return _Block(rows, range(1), 0.0 * self.left[vertical, :1], 0.0 * self.right[:1, vertical])
        horizontal = slice(columns.start - self.columns.start, columns.stop - self.columns.start)
        shifted = range(columns.start - source.start, columns.stop - source.start)
        return _Block(rows, shifted, self.left[vertical, horizontal], self.right[horizontal, vertical])


def _intersection(first: range, second: range) -> range:
    return range(max(first.start, second.start), min(first.stop, second.stop))


@dataclass(frozen=True)
class _AxisProduct:
    """A matrix in blocks of rows."""

    blocks: tuple[_Block, ...]

    @classmethod
    def forward(cls, blur: AxisBlur, like: Array) -> _AxisProduct:
        blocks = []
        for rows in row_blocks(blur):
            columns = blur.columns_of(rows)
            blocks.append(_Block.of(rows, columns, blur.entries(rows, columns), like))
        return cls(tuple(blocks))

    @classmethod
    def adjoint(cls, blur: AxisBlur, like: Array) -> _AxisProduct:
        reverse = AxisBlur(blur.target, blur.source, blur.scale, blur.boundary, blur.taps, blur.truncate)
        blocks = []
        for columns in row_blocks(reverse):
            rows = blur.rows_of(columns)
            blocks.append(_Block.of(columns, rows, blur.entries(rows, columns).T, like))
        return cls(tuple(blocks))

    def crop(self, source: range, target: range) -> _AxisProduct:
        """Return the product that computes `target` for an axis that is 0 outside `source`."""
        blocks = (block.crop(source, target) for block in self.blocks)
        return _AxisProduct(tuple(block for block in blocks if block is not None))

    def along_rows(self, planes: Array) -> Array:
        """Multiply the vertical axis of planes, shape (..., H, W)."""
        products = [
            matrix_product(block.left, planes[..., block.columns.start : block.columns.stop, :])
            for block in self.blocks
        ]
        return products[0] if len(products) == 1 else namespace(planes).concat(products, axis=-2)

    def along_columns(self, planes: Array) -> Array:
        """Multiply the horizontal axis of planes, shape (..., H, W)."""
        products = [
            matrix_product(planes[..., block.columns.start : block.columns.stop], block.right) for block in self.blocks
        ]
        return products[0] if len(products) == 1 else namespace(planes).concat(products, axis=-1)

    @property
    def elements(self) -> int:
        """Number of elements of all factors."""
        return sum(2 * math.prod(block.left.shape) for block in self.blocks)


_Products: TypeAlias = tuple[_AxisProduct, _AxisProduct]


def _products(blur: AxisBlur, like: Array) -> _Products:
    """Return the matrix of a blur and its transpose, for arrays like `like`."""
    key = (blur, library_name(like), str(like.dtype), str(device(like)))
    products: _Products | None = MATRICES.get(key)
    if products is None:
        forward = _AxisProduct.forward(blur, like)
        products = (forward, forward if blur.is_symmetric else _AxisProduct.adjoint(blur, like))
        if outlives_its_context(forward.blocks[0].left):
            elements = forward.elements + (0 if blur.is_symmetric else products[1].elements)
            MATRICES.put(key, products, elements + 2 * ARRAY_OVERHEAD)
    return products


class GaussianBlur:
    """A Gaussian blur prepared for one kind of array.

    Parameters
    ----------
    blur : PlaneBlur
        The blur to compute.
    like : array
        Its library, dtype and device are used for the matrices.
    """

    def __init__(self, blur: PlaneBlur, like: Array) -> None:
        self._blur = blur
        self._columns_first = blur.columns_first
        self._source = Window.whole(blur.source.rows.cells, blur.source.columns.cells)
        self._target = Window.whole(blur.target.rows.cells, blur.target.columns.cells)
        self._rows, self._rows_adjoint = _products(blur.rows, like)
        self._columns, self._columns_adjoint = _products(blur.columns, like)

    @property
    def blur(self) -> PlaneBlur:
        """The blur that is computed."""
        return self._blur

    def apply(self, planes: Array, window: Window | None = None) -> Array:
        """Return the blurred planes, shape (..., h, w).

        With a `window`, `planes` are the part inside it of planes that are 0 elsewhere, and the result is the part
        inside :meth:`PlaneBlur.support_of`.
        """
        if self._blur.is_identity:
            return planes
        rows, columns = self._rows, self._columns
        if window is not None and window != self._source:
            support = self._blur.support_of(window)
            rows = rows.crop(window.rows, support.rows)
            columns = columns.crop(window.columns, support.columns)
        if self._columns_first:
            return rows.along_rows(columns.along_columns(planes))
        return columns.along_columns(rows.along_rows(planes))

    def adjoint(self, planes: Array, window: Window | None = None) -> Array:
        """Apply the transpose of :meth:`apply`: planes of shape (..., h, w) to shape (..., H, W).

        With a `window`, `planes` are the part inside it, and the result is the part inside
        :meth:`PlaneBlur.adjoint_support_of`.
        """
        if self._blur.is_identity:
            return planes
        rows, columns = self._rows_adjoint, self._columns_adjoint
        if window is not None and window != self._target:
            support = self._blur.adjoint_support_of(window)
            rows = rows.crop(window.rows, support.rows)
            columns = columns.crop(window.columns, support.columns)
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
        """Return ``rows @ planes @ columns.T`` for every plane."""
        return _sandwich(self.rows, planes, self.columns)

    def adjoint(self, planes: Array) -> Array:
        """Return ``rows.T @ planes @ columns`` for every plane."""
        return _sandwich(self.rows.T, planes, self.columns.T)


def _sandwich(left: Array, planes: Array, right: Array) -> Array:
    xp = namespace(planes)
    *stack, height, width = planes.shape
    product = matrix_product(xp.reshape(planes, (-1, width)), right.T)
    return matrix_product(left, xp.reshape(product, (*stack, height, right.shape[0])))


def blur_about(blur: Blur, planes: Array, padding: float) -> Array:
    """Blur planes as if `padding` instead of 0 surrounded them; the adjoint is the blur's own."""
    return blur.apply(planes) if padding == 0.0 else blur.apply(planes - padding) + padding


def gaussian_blur(
    height: int, width: int, scale: float, boundary: Boundary, *, like: Array, taps: int | None = None
) -> Blur:
    """Prepare the Gaussian blur of planes of `height` by `width` pixels, for arrays like `like`.

    Parameters
    ----------
    height, width : int
        Size of the planes.
    scale : float
        Standard deviation in pixels; 0 gives the identity.
    boundary, taps
        See :class:`loi_core.method.gaussian.AxisBlur`.
    like : array
        Its library, dtype and device are used for the operator.
    """
    pixels = PlaneGrid.pixels(height, width)
    rows = AxisBlur(pixels.rows, pixels.rows, scale, boundary, taps)
    columns = AxisBlur(pixels.columns, pixels.columns, scale, boundary, taps)
    return GaussianBlur(PlaneBlur(rows, columns), like)

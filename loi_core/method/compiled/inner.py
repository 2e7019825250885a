"""The blur of an inner scale, one plane at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from loi_core.method.compiled.bands import BandTable, adjoint_band, forward_band
from loi_core.method.compiled.blurs import blur_window
from loi_core.method.compiled.compiling import compiled
from loi_core.method.compiled.rows import transpose
from loi_core.method.compiled.schedule import Allocator, pass_row, transposed_shape
from loi_core.method.compiled.tables import (
    GROUP_ROWS,
    SQUARE_SIDE,
    STRIP_ROWS,
    Floats,
    Operators,
    Plane,
    Table,
    row_stride,
)
from loi_core.method.compiled.workspace import Workspace
from loi_core.method.plane_blurs import PlaneBlur
from loi_core.method.windows import Window

__all__ = ["InnerBlur"]

FORWARD = 0, 1  # bands of rows and of columns
ADJOINT = 2, 3


@dataclass(frozen=True)
class InnerBlur:
    """A blur and its adjoint, for planes of one size and dtype."""

    blur: PlaneBlur
    bands: BandTable
    offsets: Table  # of the source, the transposed result, the rows between the two bands, and a strip
    elements: int  # of the workspace

    @classmethod
    def of(cls, blur: PlaneBlur, dtype: np.dtype[Any]) -> InnerBlur:
        """Prepare a blur for planes of one dtype."""
        bands = [band(axis, dtype) for band in (forward_band, adjoint_band) for axis in (blur.rows, blur.columns)]
        allocator, pairs = Allocator(), [(bands[first], bands[second]) for first, second in (FORWARD, ADJOINT)]
        source = allocator.plane(
            *((first.height, second.columns) for first, second in pairs),
            *((first.rows + SQUARE_SIDE, second.rows) for first, second in pairs),
        )
        target = allocator.plane(*((GROUP_ROWS * len(second.starts), first.rows) for first, second in pairs))
        transposed = allocator.plane(*(transposed_shape(bands, pair) for pair in (FORWARD, ADJOINT)))
        strip = allocator.plane((STRIP_ROWS, max(band.columns for band in bands)))
        offsets = np.asarray((source, target, transposed, strip), np.int64)
        return cls(blur, BandTable.of(bands), offsets, allocator.elements)

    def apply(self, plane: Floats, workspace: Workspace) -> Floats:
        """Return the blurred plane, shape (h, w)."""
        return self._multiply(plane, FORWARD, workspace)

    def adjoint(self, plane: Floats, workspace: Workspace) -> Floats:
        """Apply the transpose of :meth:`apply`: shape (h, w) to shape (H, W)."""
        return self._multiply(plane, ADJOINT, workspace)

    def _multiply(self, plane: Floats, pair: tuple[int, int], workspace: Workspace) -> Floats:
        if self.blur.is_identity:
            return plane
        shape = tuple(self.bands.bands[band].rows for band in pair)
        row = pass_row(self.bands.bands, pair, Window.whole(*plane.shape), Window.whole(*shape))
        result = np.empty(shape, plane.dtype)
        strides = np.asarray([row_stride(size) for size in (plane.shape[1], shape[0], shape[1])], np.int64)
        operators = self.bands.weights, self.bands.starts, self.bands.table, workspace.of_size(self.elements)
        _blur_plane(plane, np.asarray(row, np.int64), operators, self.offsets, strides, result)
        return result


@compiled
def _blur_plane(
    plane: Floats, row: Table, operator_arrays: tuple[Any, ...], offsets: Table, strides: Table, result: Floats
) -> None:
    """Copy a plane to the workspace, blur it, and copy the transposed result back."""
    operators = Operators(*operator_arrays)
    workspace = operators.workspace
    source, target = Plane(offsets[0], strides[0]), Plane(offsets[1], strides[1])
    for y in range(plane.shape[0]):
        start = source.offset + y * source.stride
        workspace[start : start + plane.shape[1]] = plane[y]
    blur_window(row, operators, source, target, offsets[2], offsets[3], False)
    rows, columns = result.shape
    upright = Plane(source.offset, strides[2])  # the source is needed no more
    transpose(workspace, target, rows, (columns + GROUP_ROWS - 1) // GROUP_ROWS, upright)
    for y in range(rows):
        start = upright.offset + y * upright.stride
        result[y] = workspace[start : start + columns]

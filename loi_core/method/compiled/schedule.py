"""Schedules: tables of the blurs of a comparison, their windows, and the offsets of its planes.

The kernels of :mod:`loi_core.method.compiled.levels` are an interpreter of these int64 tables, so that no window is
compiled into them. The columns are described in :mod:`loi_core.method.compiled.tables`; ``print`` shows a schedule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Final

import numpy as np

from loi_core.method.compiled.bands import Band, BandTable, adjoint_band, forward_band
from loi_core.method.compiled.sign_errors import block_sums_size
from loi_core.method.compiled.tables import (
    COLUMN_MULTIPLE,
    GROUP_ROWS,
    MAX_CHUNK_BYTES,
    SQUARE_SIDE,
    STRIP_ROWS,
    BlurColumn,
    Floats,
    Offset,
    PassColumn,
    PyramidColumn,
    Table,
    row_stride,
)
from loi_core.method.plan import InnerPlan
from loi_core.method.plane_blurs import PlaneBlur
from loi_core.method.support import Supports
from loi_core.method.windows import Window
from loi_core.support.cache import Cache

__all__ = ["Allocator", "Schedule", "Scheduler", "pass_row", "transposed_shape"]

MAX_CACHED_SCHEDULES: Final = 16  # of one inner scale: windows change from step to step, but not between channels


@dataclass(frozen=True)
class Schedule:
    """The supports of one comparison, its tables, and the number of elements of its workspace."""

    supports: Supports
    pyramid: Table
    blurs: Table
    offsets: Table
    elements: int

    def __str__(self) -> str:
        offsets = ", ".join(f"{offset.name} {self.offsets[offset]}" for offset in Offset)
        lines = [f"workspace of {self.elements} elements; {offsets}"]
        lines += [f"level {index}: {_named(PyramidColumn, row)}" for index, row in enumerate(self.pyramid)]
        for index, row in enumerate(self.blurs):
            target = "level" if index + 1 < len(self.pyramid) else "extent"
            lines += [
                f"level {row[BlurColumn.SOURCE]} to {target} {row[BlurColumn.TARGET]}:",
                f"  forward: {_named(PassColumn, row[BlurColumn.FORWARD :])}",
                f"  adjoint: {_named(PassColumn, row[BlurColumn.ADJOINT :])}",
            ]
        return "\n".join(lines)


def _named(columns: type[IntEnum], row: Table) -> str:
    return ", ".join(f"{column.name} {row[column]}" for column in columns)


@dataclass(frozen=True)
class _Link:
    """A blur from a pyramid level to the next level, or to an extent: two bands each way, in order of application."""

    source: int
    target: int
    blur: PlaneBlur
    forward: tuple[int, int]
    adjoint: tuple[int, int]


@dataclass(frozen=True)
class Scheduler:
    """The bands of one inner scale and the order of its blurs: everything that does not depend on values.

    The blurs form a tree: each pyramid level follows from the one before, and extents start from any level. Every blur
    transposes its result, so odd levels are transposed, as are extents that start from an even level.
    """

    plan: InnerPlan
    bands: BandTable
    blurs: tuple[_Link, ...]
    spacings: Floats  # shape (E, 2): see `loi_core.method.compiled.tables.Tables`
    block_sums_size: int  # the largest of all extents
    centred: bool = False
    schedules: Cache[tuple[Window, bool], Schedule] = field(default_factory=lambda: Cache(MAX_CACHED_SCHEDULES))

    @classmethod
    def of(cls, plan: InnerPlan, dtype: np.dtype[Any], *, centred: bool = False) -> Scheduler:
        """Return the scheduler of a plan, for arrays of one dtype."""
        bands: list[Band] = []

        def index_of(band: Band) -> int:
            bands.append(band)
            return len(bands) - 1

        def with_bands(source: int, target: int, blur: PlaneBlur) -> _Link:
            first, second = (blur.columns, blur.rows) if source % 2 else (blur.rows, blur.columns)
            forward = index_of(forward_band(first, dtype)), index_of(forward_band(second, dtype))
            adjoint = index_of(adjoint_band(second, dtype)), index_of(adjoint_band(first, dtype))
            return _Link(source, target, blur, forward, adjoint)

        blurs = [with_bands(index, index + 1, step) for index, step in enumerate(plan.pyramid)]
        blurs += [with_bands(extent.start, index, extent.blur) for index, extent in enumerate(plan.extents)]
        grids = [extent.blur.target if extent.start % 2 else extent.blur.target.transposed for extent in plan.extents]
        spacings = [
            (grid.rows.spacing, grid.columns.spacing) if extent.is_sampled else (0.0, 0.0)
            for extent, grid in zip(plan.extents, grids, strict=True)
        ]
        sums = max(block_sums_size(grid.rows.cells, grid.columns.cells) for grid in grids)
        return cls(plan, BandTable.of(bands), tuple(blurs), np.asarray(spacings), sums, centred)

    def schedule(self, differing: Window, *, gradient: bool) -> Schedule:
        """Return the schedule of the comparison of a difference that is 0 outside a window."""
        schedule = self.schedules.get((differing, gradient))
        if schedule is None:
            schedule = self._make_schedule(Supports.of(differing, self.plan), gradient=gradient)
            self.schedules.put((differing, gradient), schedule, 1)
        return schedule

    @property
    def _steps(self) -> int:
        """Number of blurs that lead to pyramid levels; they come first."""
        return len(self.plan.pyramid)

    def _make_schedule(self, supports: Supports, *, gradient: bool) -> Schedule:
        allocator, bands = Allocator(), self.bands.bands
        image_window = supports.image_window(gradient=gradient)
        pyramid = np.zeros((self._steps + 1, len(PyramidColumn)), np.int64)
        for index, row in enumerate(pyramid):
            shape = self._level_shape(index)
            window = _whole_groups(_oriented(supports.cotangents[index], index)) if index else image_window
            row[:] = allocator.plane(shape), allocator.plane(shape), row_stride(shape[1]), *_edges(window)
        slope = allocator.plane(self._level_shape(0))
        blurs = np.zeros((len(self.blurs), BlurColumn.ADJOINT + len(PassColumn)), np.int64)
        for index, (row, link) in enumerate(zip(blurs, self.blurs, strict=True)):
            support = supports.differences[link.source]
            target = cotangent = link.blur.support_of(support)
            if index < self._steps:
                cotangent = supports.cotangents[link.target]
            returned = link.blur.adjoint_support_of(cotangent)
            support, target, cotangent, returned = (
                _oriented(window, link.source) for window in (support, target, cotangent, returned)
            )
            row[: BlurColumn.FORWARD] = link.source, link.target
            row[BlurColumn.FORWARD : BlurColumn.ADJOINT] = pass_row(bands, link.forward, support, target)
            row[BlurColumn.ADJOINT :] = pass_row(bands, link.adjoint, cotangent.transposed, returned.transposed)
            if index >= self._steps:  # an extent compares a few rows at a time, but keeps all that they return
                row[BlurColumn.ADJOINT + PassColumn.STRIDE] = row_stride(bands[link.adjoint[0]].rows)
        passes = [pair for link in self.blurs for pair in (link.forward, link.adjoint)]
        transposed = allocator.plane(*(transposed_shape(bands, pair) for pair in passes))
        strip = allocator.plane((STRIP_ROWS, max(band.columns for band in bands)))
        extents = self.blurs[self._steps :]
        compared = allocator.plane(
            *((bands[link.adjoint[0]].height, _rows_at_once(bands, link.forward)) for link in extents)
        )
        returned_rows = allocator.plane(
            *((bands[link.adjoint[1]].height + SQUARE_SIDE, bands[link.adjoint[0]].rows) for link in extents)
        )
        difference = int(pyramid[0, PyramidColumn.DIFFERENCE])
        accumulated = allocator.plane(self._level_shape(0)) if self.centred else difference
        offsets = np.asarray((slope, transposed, strip, compared, returned_rows, accumulated), np.int64)
        return Schedule(supports, pyramid, blurs, offsets, allocator.elements)

    def _level_shape(self, level: int) -> tuple[int, int]:
        """Return the rows to allocate for a pyramid level's planes, and their columns."""
        bands, leaving = self.bands.bands, [link for link in self.blurs if link.source == level]
        arriving = [bands[link.adjoint[0]] for link in self.blurs[: self._steps] if link.target == level]
        rows = max(band.height for band in [*(bands[link.forward[0]] for link in leaving), *arriving])
        (columns,) = {bands[link.forward[1]].columns for link in leaving}
        return rows, columns


def pass_row(bands: Sequence[Band], pair: tuple[int, int], source: Window, target: Window) -> list[int]:
    """Return the table row of a pass with two bands from a window to a window, both in the source's orientation."""
    first, second = pair
    rows = _rows_at_once(bands, pair)
    chunk = rows // GROUP_ROWS, row_stride(rows)
    return [first, *_groups(target.rows), *_edges(source), *chunk, second, *_groups(target.columns)]


def transposed_shape(bands: Sequence[Band], pair: tuple[int, int]) -> tuple[int, int]:
    """Return the rows to allocate for the transposed rows between two bands, and their columns."""
    return bands[pair[1]].height + SQUARE_SIDE, _rows_at_once(bands, pair)


def _rows_at_once(bands: Sequence[Band], pair: tuple[int, int]) -> int:
    """Return how many rows pass through both bands together: at most MAX_CHUNK_BYTES, in full vectors."""
    first, second = (bands[band] for band in pair)
    row_bytes: int = max(second.rows, second.columns) * second.weights.dtype.itemsize
    all_rows = -(-first.rows // COLUMN_MULTIPLE)
    return COLUMN_MULTIPLE * max(1, min(MAX_CHUNK_BYTES // row_bytes // COLUMN_MULTIPLE, all_rows))


class Allocator:
    """Offsets of planes in a workspace, one after another."""

    def __init__(self) -> None:
        self.elements = 0

    def plane(self, *shapes: tuple[int, int]) -> int:
        """Return the offset of memory for planes of these rows and columns, one at a time."""
        offset = self.elements
        self.elements += max(rows * row_stride(columns) for rows, columns in shapes)
        return offset


def _oriented(window: Window, level: int) -> Window:
    """Return a window in the orientation of a pyramid level's planes."""
    return window.transposed if level % 2 else window


def _edges(window: Window) -> tuple[int, int, int, int]:
    return window.rows.start, window.rows.stop, window.columns.start, window.columns.stop


def _groups(rows: range) -> tuple[int, int]:
    """Return the range of groups that computes some rows."""
    return rows.start // GROUP_ROWS, -(-rows.stop // GROUP_ROWS)


def _whole_groups(window: Window) -> Window:
    """Return a window extended to whole groups of rows and of columns."""
    rows, columns = (
        range(axis.start // GROUP_ROWS * GROUP_ROWS, -(-axis.stop // GROUP_ROWS) * GROUP_ROWS)
        for axis in (window.rows, window.columns)
    )
    return Window(rows, columns)

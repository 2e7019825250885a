"""The tables that tell the kernels what to compute: which bands, on which windows, and where planes lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.method.blurs import PlaneBlur
from loi_core.method.compiled.bands import Band, Bands, Numbers, band_back, band_forth
from loi_core.method.compiled.misplacement import room_for_sums
from loi_core.method.compiled.records import GROUP, LANES, NEAR, SIDE, STRIP, EdgeColumn, NodeColumn, PassColumn, padded
from loi_core.method.plan import InnerPlan
from loi_core.method.scope import Route, Scope
from loi_core.method.windows import Window
from loi_core.support.cache import Cache

__all__ = ["Places", "Program", "Table", "Wiring", "blur_pass", "turned_shape"]

Table: TypeAlias = np.ndarray[Any, np.dtype[np.int64]]

KEPT: Final = 16  # programs of one inner scale: windows change from step to step, but not from channel to channel


@dataclass(frozen=True)
class _Edge:
    """A blur from a node to the next, or to an extent, there and back: two bands each, in the order they act in."""

    source: int
    target: int
    blur: PlaneBlur
    forth: tuple[int, int]
    back: tuple[int, int]


@dataclass(frozen=True)
class Program:
    """Tables for :func:`loi_core.method.compiled.levels.compare_levels`, and how many elements its arena has."""

    nodes: Table
    edges: Table
    places: Table
    elements: int


@dataclass(frozen=True)
class Wiring:
    """The bands of one inner scale, and how they follow each other: all that does not depend on values.

    The samplings form a tree: one level of the pyramid after another, and extents from any of them. Every blur leaves
    its result transposed, so levels of odd number lie transposed, as do extents that start from one of even number.
    """

    plan: InnerPlan
    bands: Bands
    edges: tuple[_Edge, ...]
    samplings: Numbers  # shape (E, 2): see :func:`loi_core.method.compiled.levels.compare_levels`
    room: int  # for the sums over blocks of any of them
    routes: Cache[Window, Route] = field(default_factory=lambda: Cache(KEPT))
    programs: Cache[tuple[Window, Window], Program] = field(default_factory=lambda: Cache(KEPT))

    @classmethod
    def of(cls, plan: InnerPlan, dtype: np.dtype[Any]) -> Wiring:
        """The wiring for arrays of one dtype."""
        bands: list[Band] = []

        def number(made: Band) -> int:
            bands.append(made)
            return len(bands) - 1

        def edge(source: int, target: int, blur: PlaneBlur) -> _Edge:
            first, after = (blur.columns, blur.rows) if source % 2 else (blur.rows, blur.columns)
            forth = number(band_forth(first, dtype)), number(band_forth(after, dtype))
            back = number(band_back(after, dtype)), number(band_back(first, dtype))
            return _Edge(source, target, blur, forth, back)

        edges = [edge(index, index + 1, step) for index, step in enumerate(plan.pyramid)]
        edges += [edge(extent.start, index, extent.blur) for index, extent in enumerate(plan.extents)]
        grids = [extent.blur.target if extent.start % 2 else extent.blur.target.transposed for extent in plan.extents]
        spacings = [
            (grid.rows.spacing, grid.columns.spacing) if extent.is_sampled else (0.0, 0.0)
            for extent, grid in zip(plan.extents, grids, strict=True)
        ]
        room = max(room_for_sums(grid.rows.cells, grid.columns.cells) for grid in grids)
        return cls(plan, Bands.of(bands), tuple(edges), np.asarray(spacings), room)

    @property
    def pyramid_levels(self) -> int:
        """How many edges lead to levels of the pyramid; they come first."""
        return len(self.plan.pyramid)

    def route(self, start: Window) -> Route:
        """The route of a difference that is 0 outside `start`."""
        made = self.routes.get(start)
        if made is None:
            made = Route.of(start, self.plan)
            self.routes.put(start, made, 1)
        return made

    def program(self, scope: Scope) -> Program:
        """The tables for what is in a scope."""
        key = scope.route.support[0], scope.support
        made = self.programs.get(key)
        if made is None:
            made = self._make(scope)
            self.programs.put(key, made, 1)
        return made

    def _make(self, scope: Scope) -> Program:
        place, bands = Places(), self.bands.each
        nodes = np.zeros((self.pyramid_levels + 1, len(NodeColumn)), np.int64)
        for index, row in enumerate(nodes):
            shape = self._shape(index)
            window = scope.support if index == 0 else _rounded(_laid(scope.route.pulled[index], index))
            row[:] = place.plane(shape), place.plane(shape), padded(shape[1]), *_sides(window)
        slope = place.plane(self._shape(0))
        edges = np.zeros((len(self.edges), EdgeColumn.BACK + len(PassColumn)), np.int64)
        for index, (row, edge) in enumerate(zip(edges, self.edges, strict=True)):
            support = scope.route.support[edge.source]
            if index < self.pyramid_levels:
                reached, returning = edge.blur.reached(support), scope.route.pulled[edge.target]
            else:
                reached = returning = edge.blur.reached(support)
            source, out = _laid(support, edge.source), _laid(reached, edge.source)
            end, back = _laid(returning, edge.source), _laid(edge.blur.reached_back(returning), edge.source)
            row[: EdgeColumn.FORTH] = edge.source, edge.target
            row[EdgeColumn.FORTH : EdgeColumn.BACK] = blur_pass(bands, edge.forth, source, out)
            row[EdgeColumn.BACK :] = blur_pass(bands, edge.back, end.transposed, back.transposed)
            if index >= self.pyramid_levels:  # a few rows are compared at a time, but all that becomes of them is kept
                row[EdgeColumn.BACK + PassColumn.STRIDE] = padded(bands[edge.back[0]].rows)
        passes = [pair for edge in self.edges for pair in (edge.forth, edge.back)]
        turned = place.plane(*(turned_shape(bands, pair) for pair in passes))
        strip = place.plane((STRIP, max(band.columns for band in bands)))
        extents = self.edges[self.pyramid_levels :]
        compared = place.plane(*((bands[edge.back[0]].height, _rows_at_once(bands, edge.forth)) for edge in extents))
        returned = place.plane(*((bands[edge.back[1]].height + SIDE, bands[edge.back[0]].rows) for edge in extents))
        places = np.asarray((slope, turned, strip, compared, returned), np.int64)
        return Program(nodes, edges, places, place.elements)

    def _shape(self, node: int) -> tuple[int, int]:
        """Rows that there have to be of a node's planes, and columns."""
        leaving = [self.bands.each[edge.forth[0]] for edge in self.edges if edge.source == node]
        arriving = [self.bands.each[edge.back[0]] for edge in self.edges[: self.pyramid_levels] if edge.target == node]
        rows = max(band.height for band in leaving + arriving)
        (columns,) = {self.bands.each[edge.forth[1]].columns for edge in self.edges if edge.source == node}
        return rows, columns


def blur_pass(bands: Sequence[Band], pair: tuple[int, int], source: Window, out: Window) -> list[int]:
    """The row of a blur by two bands that makes `out` of `source`, both as the source lies."""
    first, after = pair
    rows = _rows_at_once(bands, pair)
    together = rows // GROUP, padded(rows)
    return [first, *_groups(out.rows), *_sides(source), *together, after, *_groups(out.columns)]


def turned_shape(bands: Sequence[Band], pair: tuple[int, int]) -> tuple[int, int]:
    """Rows that there have to be of what lies transposed between two bands, and columns."""
    return bands[pair[1]].height + SIDE, _rows_at_once(bands, pair)


def _rows_at_once(bands: Sequence[Band], pair: tuple[int, int]) -> int:
    """How many rows of a blur go through both of its bands before the next: of `NEAR` bytes, in full vectors."""
    first, after = (bands[band] for band in pair)
    row: int = max(after.rows, after.columns) * after.weights.dtype.itemsize
    return LANES * max(1, min(NEAR // row // LANES, -(-first.rows // LANES)))


class Places:
    """Places for planes, one after another."""

    def __init__(self) -> None:
        self.elements = 0

    def plane(self, *shapes: tuple[int, int]) -> int:
        """Where there is room for planes of these rows and columns, one at a time."""
        place = self.elements
        self.elements += max(rows * padded(columns) for rows, columns in shapes)
        return place


def _laid(window: Window, node: int) -> Window:
    """A window as the planes of a node lie."""
    return window.transposed if node % 2 else window


def _sides(window: Window) -> tuple[int, int, int, int]:
    return window.rows.start, window.rows.stop, window.columns.start, window.columns.stop


def _groups(rows: range) -> tuple[int, int]:
    """The groups that make some rows."""
    return rows.start // GROUP, -(-rows.stop // GROUP)


def _rounded(window: Window) -> Window:
    """A window with all that is made together with what lies in it."""
    rows, columns = (
        range(axis.start // GROUP * GROUP, -(-axis.stop // GROUP) * GROUP) for axis in (window.rows, window.columns)
    )
    return Window(rows, columns)

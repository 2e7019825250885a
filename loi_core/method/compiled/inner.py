"""The blur of an inner scale, one plane at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from loi_core.method.blurs import PlaneBlur
from loi_core.method.compiled.arena import Arena
from loi_core.method.compiled.bands import Bands, Numbers, band_back, band_forth
from loi_core.method.compiled.blurs import blur_window
from loi_core.method.compiled.compiling import compiled
from loi_core.method.compiled.program import Places, blur_pass, turned_shape
from loi_core.method.compiled.records import GROUP, SIDE, STRIP, Floats, Operators, Plane, Table, padded
from loi_core.method.compiled.rows import transpose
from loi_core.method.windows import Window

__all__ = ["InnerBlur"]

FORTH = 0, 1  # bands of rows and of columns
BACK = 2, 3


@dataclass(frozen=True)
class InnerBlur:
    """A blur and its transpose, for planes of one size and dtype."""

    blur: PlaneBlur
    bands: Bands
    places: Table  # offsets in the arena: of a plane, of what is made of it, of what lies between, of a strip
    elements: int

    @classmethod
    def of(cls, blur: PlaneBlur, dtype: np.dtype[Any]) -> InnerBlur:
        """The bands of a blur, and how many elements its arena has."""
        rows, columns = blur.rows, blur.columns
        bands = (
            band_forth(rows, dtype), band_forth(columns, dtype), band_back(rows, dtype), band_back(columns, dtype)
        )  # fmt: skip
        place, pairs = Places(), [(bands[first], bands[after]) for first, after in (FORTH, BACK)]
        source = place.plane(
            *((first.height, after.columns) for first, after in pairs),
            *((first.rows + SIDE, after.rows) for first, after in pairs),
        )
        target = place.plane(*((GROUP * len(after.starts), first.rows) for first, after in pairs))
        turned = place.plane(*(turned_shape(bands, pair) for pair in (FORTH, BACK)))
        strip = place.plane((STRIP, max(band.columns for band in bands)))
        return cls(blur, Bands.of(bands), np.asarray((source, target, turned, strip), np.int64), place.elements)

    def apply(self, plane: Numbers, arena: Arena) -> Numbers:
        """The blurred plane, shape (h, w)."""
        return self._between(plane, FORTH, arena)

    def adjoint(self, plane: Numbers, arena: Arena) -> Numbers:
        """The transpose of :meth:`apply`: shape (h, w) to shape (H, W)."""
        return self._between(plane, BACK, arena)

    def _between(self, plane: Numbers, pair: tuple[int, int], arena: Arena) -> Numbers:
        if self.blur.is_identity:
            return plane
        shape = tuple(self.bands.each[band].rows for band in pair)
        way = blur_pass(self.bands.each, pair, Window.whole(*plane.shape), Window.whole(*shape))
        made = np.empty(shape, plane.dtype)
        strides = np.asarray([padded(plane.shape[1]), padded(shape[0]), padded(shape[1])], np.int64)
        operators = Operators(self.bands.weights, self.bands.starts, self.bands.table, arena.of(self.elements))
        _blur_plane(plane, np.asarray(way, np.int64), *operators, self.places, strides, made)
        return made


@compiled
def _blur_plane(
    plane: Floats,
    way: Table,
    weights: Floats,
    starts: Table,
    bands: Table,
    arena: Floats,
    places: Table,
    strides: Table,
    made: Floats,
) -> None:
    """Blur a plane by way of an arena, where there is room beside it."""
    operators = Operators(weights, starts, bands, arena)
    source, target = Plane(places[0], strides[0]), Plane(places[1], strides[1])
    for y in range(plane.shape[0]):
        at = source.at + y * source.stride
        arena[at : at + plane.shape[1]] = plane[y]
    blur_window(way, operators, source, target, places[2], places[3], False)
    # What is made lies transposed. It is turned to where the plane was, which is needed no more.
    rows, columns = made.shape
    upright = Plane(source.at, strides[2])
    transpose(arena, target, rows, (columns + GROUP - 1) // GROUP, upright)
    for y in range(rows):
        at = upright.at + y * upright.stride
        made[y] = arena[at : at + columns]

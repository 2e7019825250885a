"""The exact area of outlines in pixels, and its derivatives in closed form.

An edge of an outline adds to the winding number of all points to its right. Cut at pixel borders, it becomes a list of
pieces, each within one pixel; a cumulative sum along the rows gives the area in every pixel. Moving an end of an edge
changes area only in the pixels that the edge crosses, by the length of the moving part times its displacement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

from loi_core.errors import ParameterError
from loi_core.renderers.rasterization import IndexArray, peel_layers
from loi_core.renderers.validation import FloatArray
from loi_core.support.arrays import to_numpy

__all__ = ["MAX_COORDINATE_PX", "Edges", "Painting", "check_near", "cover"]

MAX_COORDINATE_PX: Final = 1e9  # beyond, float64 does not resolve positions within a pixel
MAX_BOX_PIXELS: Final = 2**27  # of all bounding boxes together
WINDING_EPSILON: Final = 1e-9


@dataclass(frozen=True)
class Edges:
    """The edges of all outlines of a picture, as indices into its points.

    Attributes
    ----------
    start, end : array, shape (m,)
        Point indices of each edge; the edges of a layer are consecutive and form closed rings.
    layer : array, shape (m,)
        Layer that each edge bounds; layers are painted in their order.
    evenodd : array of bool, shape (n,)
        For each layer, whether the even-odd rule applies; otherwise the nonzero rule.
    """

    start: IndexArray
    end: IndexArray
    layer: IndexArray
    evenodd: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


@dataclass(frozen=True)
class Painting:
    """Pixels that layers meet, in the order of painting; see :class:`loi_core.renderers.rasterization.Fragments`.

    Attributes
    ----------
    layer, pixels : array, shape (f,)
        Of each fragment, which layer and which pixel, counted row by row.
    coverage : tensor, shape (f,)
        Area in [0, 1], differentiable by the points.
    sheets : tuple of slice
        Fragments that lie on no other within the sheet, lowest sheet first.
    """

    layer: IndexArray
    pixels: IndexArray
    coverage: Tensor
    sheets: tuple[slice, ...]


@dataclass(frozen=True)
class _Pieces:
    """Parts of edges, each within one pixel: where they begin and end along the edge, both in [0, 1]."""

    edge: IndexArray
    begin: FloatArray
    end: FloatArray
    row: IndexArray
    column: IndexArray
    along: FloatArray  # mean abscissa


@dataclass(frozen=True)
class _Boxes:
    """The part of the canvas that each layer can meet, and where it lies in one flat array, with two spare columns."""

    row: IndexArray
    column: IndexArray
    stride: IndexArray
    offset: IndexArray
    size: int

    def place(self, layer: IndexArray, row: IndexArray, column: IndexArray) -> IndexArray:
        return self.offset[layer] + (row - self.row[layer]) * self.stride[layer] + column - self.column[layer]


def cover(points: Tensor, edges: Edges, size: tuple[int, int]) -> Painting:
    """Return the coverage of a canvas by layers.

    Parameters
    ----------
    points : tensor, shape (k, 2), float64
        In pixels, y down.
    edges : Edges
    size : tuple of int
        Height and width of the canvas in pixels.

    Raises
    ------
    ParameterError
        If a point is a billion pixels away or more, or the shapes' boxes have more pixels than can be painted.

    Notes
    -----
    Exact for outlines that do not cross themselves. Where two parts of one outline share a pixel, and both cover it
    only in part, their areas are added, up to 1.
    """
    host = check_near(points)
    start, end = host[edges.start], host[edges.end]
    boxes = _boxes(start, edges, size)
    pieces = _pieces(start, end, size)
    winding = _winding(start, end, edges, pieces, boxes, size[1])
    inside = (pieces.column >= 0) & (pieces.column < size[1])
    place = boxes.place(edges.layer[pieces.edge], pieces.row, np.clip(pieces.column, 0, size[1]))
    area, slope = _area(winding, edges, boxes)
    touched = area > WINDING_EPSILON
    touched[place[inside]] = True  # also uncovered pixels: an edge on their border may move in
    spots = np.flatnonzero(touched)
    layer = np.searchsorted(boxes.offset, spots, side="right") - 1
    row, column = np.divmod(spots - boxes.offset[layer], boxes.stride[layer])
    row, column = row + boxes.row[layer], column + boxes.column[layer]
    on_canvas = column < size[1]
    spots, layer, pixels = spots[on_canvas], layer[on_canvas], (row * size[1] + column)[on_canvas]
    order, sheets = peel_layers(pixels)
    fragment = np.zeros(boxes.size, dtype=np.int64)
    fragment[spots[order]] = np.arange(len(order))
    on_rows = np.flatnonzero(inside)
    coverage: Tensor = _Area.apply(  # type: ignore[no-untyped-call]  # untyped in torch
        points, area[spots[order]], fragment[place[on_rows]], slope[place[on_rows]], pieces, on_rows, edges
    )
    return Painting(layer[order], pixels[order], coverage, sheets)


def check_near(points: Tensor) -> FloatArray:
    """Return `points` on the host; raise :class:`ParameterError` if one of them is a billion pixels away or more."""
    host: FloatArray = to_numpy(points)
    if not np.all(np.abs(host) < MAX_COORDINATE_PX):
        msg = (
            f"shapes must lie within {MAX_COORDINATE_PX:g} pixels of the canvas; "
            "a position, size or control point is beyond"
        )
        raise ParameterError(msg)
    return host


def _boxes(start: FloatArray, edges: Edges, size: tuple[int, int]) -> _Boxes:
    count = len(edges.evenodd)
    lower, upper = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    if len(start):
        first_edge = np.append(0, np.flatnonzero(np.diff(edges.layer)) + 1)
        lower[edges.layer[first_edge]] = np.minimum.reduceat(start, first_edge)
        upper[edges.layer[first_edge]] = np.maximum.reduceat(start, first_edge)
    canvas = np.array(size[::-1], dtype=np.float64)
    first = np.floor(np.clip(lower, 0.0, canvas)).astype(np.int64)
    beyond = np.ceil(np.clip(upper, 0.0, canvas)).astype(np.int64)
    # An edge along the last line of a box belongs to the pixels behind it.
    extent = np.maximum(np.minimum(beyond + 1, canvas.astype(np.int64)) - first, 0)
    stride = extent[:, 0] + 2
    sizes = stride * extent[:, 1]
    total = int(sizes.sum())
    if total > MAX_BOX_PIXELS:
        msg = (
            f"the shapes' bounding boxes have {total} pixels together, more than the {MAX_BOX_PIXELS} that are painted"
        )
        raise ParameterError(msg)
    return _Boxes(first[:, 1], first[:, 0], stride, np.cumsum(sizes) - sizes, total)


def _pieces(start: FloatArray, end: FloatArray, size: tuple[int, int]) -> _Pieces:
    """Cut edges at pixel borders and at the canvas's rim; drop the parts above and below the canvas."""
    count = len(start)
    owners, times = [np.arange(count), np.arange(count)], [np.zeros(count), np.ones(count)]
    for axis, limit in ((0, size[1]), (1, size[0])):
        lower, upper = np.minimum(start[:, axis], end[:, axis]), np.maximum(start[:, axis], end[:, axis])
        first = np.maximum(np.floor(lower) + 1.0, 0.0)
        crossed = np.maximum(np.minimum(np.ceil(upper) - 1.0, limit) - first + 1.0, 0.0).astype(np.int64)
        owner = np.repeat(np.arange(count), crossed)
        line = first[owner] + (np.arange(len(owner)) - np.repeat(np.cumsum(crossed) - crossed, crossed))
        owners.append(owner)
        times.append((line - start[owner, axis]) / (end[owner, axis] - start[owner, axis]))
    owner, time = np.concatenate(owners), np.clip(np.concatenate(times), 0.0, 1.0)
    # One key for both: rounding may swap cuts that are 1e-9 of an edge apart, and their pieces' areas still add up.
    order = np.argsort(owner * 4.0 + time)
    owner, time = owner[order], time[order]
    same = np.flatnonzero(owner[1:] == owner[:-1])
    edge, begin, until = owner[same], time[same], time[same + 1]
    middle = 0.5 * (begin + until)[:, None]
    centre = start[edge] + middle * (end[edge] - start[edge])
    row = np.floor(centre[:, 1])
    on_rows = np.flatnonzero((row >= 0.0) & (row < size[0]) & (until > begin))
    column = np.clip(np.floor(centre[on_rows, 0]), -1.0, size[1]).astype(np.int64)
    return _Pieces(
        edge[on_rows], begin[on_rows], until[on_rows], row[on_rows].astype(np.int64), column, centre[on_rows, 0]
    )


def _winding(
    start: FloatArray, end: FloatArray, edges: Edges, pieces: _Pieces, boxes: _Boxes, width: int
) -> FloatArray:
    """Return the integral of the winding number over each pixel of all boxes."""
    height = (pieces.end - pieces.begin) * (end - start)[pieces.edge, 1]
    column = np.clip(pieces.column, 0, width)
    share = np.where((pieces.column < 0) | (pieces.column >= width), 0.0, pieces.along - column)
    layer = edges.layer[pieces.edge]
    place = boxes.place(layer, pieces.row, column)
    steps = np.bincount(place, height * (1.0 - share), minlength=boxes.size)
    steps += np.bincount(place + 1, height * share, minlength=boxes.size)
    winding: FloatArray = np.cumsum(steps)  # every row of a box sums to 0
    return winding


def _area(winding: FloatArray, edges: Edges, boxes: _Boxes) -> tuple[FloatArray, FloatArray]:
    """Return the covered area and its derivative by the winding number."""
    rows_of = np.diff(np.append(boxes.offset, boxes.size))
    total = np.add.reduceat(np.append(winding, 0.0), boxes.offset) if len(boxes.offset) else np.zeros(0)
    orientation = np.repeat(np.where((total < 0.0) & (rows_of > 0), -1.0, 1.0), rows_of)
    winding = winding * orientation
    folded = winding
    if np.any(edges.evenodd):
        # The kinks are moved by more than rounding, so that an edge on the line between pixels keeps its derivative.
        odd = np.repeat(edges.evenodd, rows_of)
        folded = np.where(odd, winding - 2.0 * np.round(0.5 * (winding - WINDING_EPSILON)), winding)
    slope = np.where(
        folded < -WINDING_EPSILON, -orientation, np.where(folded > 1.0 + WINDING_EPSILON, 0.0, orientation)
    )
    return np.minimum(np.abs(folded), 1.0), slope


class _Area(torch.autograd.Function):
    """The area of each fragment, with the derivatives by the ends of the edges that pass through it."""

    @staticmethod
    def forward(
        points: Tensor,
        area: FloatArray,
        fragment: IndexArray,
        slope: FloatArray,
        pieces: _Pieces,
        on_rows: IndexArray,
        edges: Edges,
    ) -> Tensor:
        return torch.as_tensor(area, device=points.device)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple[Any, ...], output: Tensor) -> None:
        points, _, fragment, slope, pieces, on_rows, edges = inputs
        ctx.save_for_backward(points)
        ctx.by = fragment, slope, pieces, on_rows, edges  # type: ignore[attr-defined]  # torch keeps attributes

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        """Scale the derivatives, which are constants to autograd, so differentiating again is an error."""
        (points,) = ctx.saved_tensors
        fragment, slope, pieces, on_rows, edges = ctx.by
        host = to_numpy(points)
        weight = to_numpy(upstream)[fragment] * slope
        weight *= pieces.end[on_rows] - pieces.begin[on_rows]
        later = weight * 0.5 * (pieces.end[on_rows] + pieces.begin[on_rows])
        count = len(edges.start)
        # The weight of each end in the motion of the edge, times the edge rotated by a right angle.
        by_end = np.bincount(pieces.edge[on_rows], later, minlength=count)
        by_start = np.bincount(pieces.edge[on_rows], weight - later, minlength=count)
        along = host[edges.end] - host[edges.start]
        result = np.empty_like(host)
        for axis, orientation in ((0, -along[:, 1]), (1, along[:, 0])):
            result[:, axis] = np.bincount(edges.start, by_start * orientation, minlength=len(host))
            result[:, axis] += np.bincount(edges.end, by_end * orientation, minlength=len(host))
        return torch.as_tensor(result, device=points.device), None, None, None, None, None, None

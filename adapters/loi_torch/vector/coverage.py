"""The exact area of outlines in pixels, and its derivatives in closed form.

An edge of an outline adds to the winding number of all that lies to its right. Cut at the lines between pixels, it
is a list of pieces, each within one pixel; a sum along the rows gives the area in every pixel. Where an end of an edge
moves, area changes only in the pixels that the edge passes through, by the length of what moves times how far.
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

__all__ = ["FARTHEST", "Edges", "Painting", "check_near", "cover"]

FARTHEST: Final = 1e9  # pixels; beyond, float64 no longer tells where in a pixel an edge passes
MOST_PIXELS: Final = 2**27  # of all bounding boxes together
ROUNDING: Final = 1e-9  # of winding numbers


@dataclass(frozen=True)
class Edges:
    """The edges of all outlines of a picture, as indices into its points.

    Attributes
    ----------
    start, end : array, shape (m,)
        Of each edge; those of a layer form closed rings, and follow one another.
    layer : array, shape (m,)
        What each edge bounds; layers are painted in their order.
    evenodd : array of bool, shape (n,)
        Of each layer, whether what is wound around twice is outside; otherwise all that is wound around is inside.
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
    """What layers cover of a canvas.

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
    met = area > ROUNDING
    met[place[inside]] = True  # also where nothing is covered yet: an edge on the line between pixels may move in
    spots = np.flatnonzero(met)
    layer = np.searchsorted(boxes.offset, spots, side="right") - 1
    row, column = np.divmod(spots - boxes.offset[layer], boxes.stride[layer])
    row, column = row + boxes.row[layer], column + boxes.column[layer]
    on_canvas = column < size[1]
    spots, layer, pixels = spots[on_canvas], layer[on_canvas], (row * size[1] + column)[on_canvas]
    order, sheets = peel_layers(pixels)
    fragment = np.zeros(boxes.size, dtype=np.int64)
    fragment[spots[order]] = np.arange(len(order))
    kept = np.flatnonzero(inside)
    coverage: Tensor = _Area.apply(  # type: ignore[no-untyped-call]  # untyped in torch
        points, area[spots[order]], fragment[place[kept]], slope[place[kept]], pieces, kept, edges
    )
    return Painting(layer[order], pixels[order], coverage, sheets)


def check_near(points: Tensor) -> FloatArray:
    """`points` on the host; :class:`ParameterError` if one of them is a billion pixels away or more."""
    host: FloatArray = to_numpy(points)
    if not np.all(np.abs(host) < FARTHEST):
        msg = f"shapes must lie within {FARTHEST:g} pixels of the canvas; a position, size or control point is beyond"
        raise ParameterError(msg)
    return host


def _boxes(start: FloatArray, edges: Edges, size: tuple[int, int]) -> _Boxes:
    count = len(edges.evenodd)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    if len(start):
        first_edge = np.append(0, np.flatnonzero(np.diff(edges.layer)) + 1)
        low[edges.layer[first_edge]] = np.minimum.reduceat(start, first_edge)
        high[edges.layer[first_edge]] = np.maximum.reduceat(start, first_edge)
    canvas = np.array(size[::-1], dtype=np.float64)
    first = np.floor(np.clip(low, 0.0, canvas)).astype(np.int64)
    beyond = np.ceil(np.clip(high, 0.0, canvas)).astype(np.int64)
    # An edge along the last line of a box belongs to the pixels behind it.
    extent = np.maximum(np.minimum(beyond + 1, canvas.astype(np.int64)) - first, 0)
    stride = extent[:, 0] + 2
    sizes = stride * extent[:, 1]
    total = int(sizes.sum())
    if total > MOST_PIXELS:
        msg = f"the shapes' bounding boxes have {total} pixels together, more than the {MOST_PIXELS} that are painted"
        raise ParameterError(msg)
    return _Boxes(first[:, 1], first[:, 0], stride, np.cumsum(sizes) - sizes, total)


def _pieces(start: FloatArray, end: FloatArray, size: tuple[int, int]) -> _Pieces:
    """Edges cut at the lines between pixels and at the canvas's rim; what lies above or below it is dropped."""
    count = len(start)
    owners, times = [np.arange(count), np.arange(count)], [np.zeros(count), np.ones(count)]
    for axis, most in ((0, size[1]), (1, size[0])):
        low, high = np.minimum(start[:, axis], end[:, axis]), np.maximum(start[:, axis], end[:, axis])
        first = np.maximum(np.floor(low) + 1.0, 0.0)
        crossed = np.maximum(np.minimum(np.ceil(high) - 1.0, most) - first + 1.0, 0.0).astype(np.int64)
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
    kept = np.flatnonzero((row >= 0.0) & (row < size[0]) & (until > begin))
    column = np.clip(np.floor(centre[kept, 0]), -1.0, size[1]).astype(np.int64)
    return _Pieces(edge[kept], begin[kept], until[kept], row[kept].astype(np.int64), column, centre[kept, 0])


def _winding(
    start: FloatArray, end: FloatArray, edges: Edges, pieces: _Pieces, boxes: _Boxes, width: int
) -> FloatArray:
    """Integrals of the winding number over the pixels of all boxes."""
    height = (pieces.end - pieces.begin) * (end - start)[pieces.edge, 1]
    column = np.clip(pieces.column, 0, width)
    share = np.where((pieces.column < 0) | (pieces.column >= width), 0.0, pieces.along - column)
    layer = edges.layer[pieces.edge]
    place = boxes.place(layer, pieces.row, column)
    steps = np.bincount(place, height * (1.0 - share), minlength=boxes.size)
    steps += np.bincount(place + 1, height * share, minlength=boxes.size)
    winding: FloatArray = np.cumsum(steps)  # every row of a box sums to 0, so the next starts anew
    return winding


def _area(winding: FloatArray, edges: Edges, boxes: _Boxes) -> tuple[FloatArray, FloatArray]:
    """Covered area, and its derivative by the winding number."""
    rows_of = np.diff(np.append(boxes.offset, boxes.size))
    total = np.add.reduceat(np.append(winding, 0.0), boxes.offset) if len(boxes.offset) else np.zeros(0)
    turned = np.repeat(np.where((total < 0.0) & (rows_of > 0), -1.0, 1.0), rows_of)
    winding = winding * turned
    folded = winding
    if np.any(edges.evenodd):
        # The kinks are moved by more than rounding, so that an edge on the line between pixels keeps its derivative.
        odd = np.repeat(edges.evenodd, rows_of)
        folded = np.where(odd, winding - 2.0 * np.round(0.5 * (winding - ROUNDING)), winding)
    slope = np.where(folded < -ROUNDING, -turned, np.where(folded > 1.0 + ROUNDING, 0.0, turned))
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
        kept: IndexArray,
        edges: Edges,
    ) -> Tensor:
        return torch.as_tensor(area, device=points.device)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple[Any, ...], output: Tensor) -> None:
        points, _, fragment, slope, pieces, kept, edges = inputs
        ctx.save_for_backward(points)
        ctx.by = fragment, slope, pieces, kept, edges  # type: ignore[attr-defined]  # torch keeps what is put there

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        """Weigh the derivatives; differentiating this again is an error, since they are constants to autograd."""
        (points,) = ctx.saved_tensors
        fragment, slope, pieces, kept, edges = ctx.by
        host = to_numpy(points)
        weight = to_numpy(upstream)[fragment] * slope
        weight *= pieces.end[kept] - pieces.begin[kept]
        later = weight * 0.5 * (pieces.end[kept] + pieces.begin[kept])
        count = len(edges.start)
        # How much of the edge's motion each end carries, times the edge turned by a right angle.
        by_end = np.bincount(pieces.edge[kept], later, minlength=count)
        by_start = np.bincount(pieces.edge[kept], weight - later, minlength=count)
        along = host[edges.end] - host[edges.start]
        result = np.empty_like(host)
        for axis, turned in ((0, -along[:, 1]), (1, along[:, 0])):
            result[:, axis] = np.bincount(edges.start, by_start * turned, minlength=len(host))
            result[:, axis] += np.bincount(edges.end, by_end * turned, minlength=len(host))
        return torch.as_tensor(result, device=points.device), None, None, None, None, None, None

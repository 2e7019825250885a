"""Collinear mesh edges that overlap, as where two components end in one plane: each point counts for one of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import HostArray
from mitsuba_boundaries.drjit.ragged import RaggedTable, hit_shape_index, shape_index
from mitsuba_boundaries.geometry.mesh import (
    crease_edges,
    edge_vertices,
    has_triangles,
    triangles,
    vertex_positions,
)
from mitsuba_boundaries.geometry.topology import topology_of

__all__ = ["UniqueEdges", "uncovered_segments"]

LINE_TOLERANCE: Final = 1e-5  # distance of equal lines per extent of the mesh: above rounding, below any bevel
DIRECTION_TOLERANCE: Final = 1e-4  # distance between the unit directions of equal lines
CELL_SHIFTS: Final = (0.0, 0.5)  # two grids, so that lines which one grid separates share a cell of the other
HASH_FACTORS: Final = np.random.default_rng(0).integers(-(2**62), 2**62, 6)  # two cells collide with odds of 2**-63
EMPTY: Final = (2.0, 2.0)  # an interval beyond the end of any edge
REFERENCE_DIRECTION: Final = np.array([0.531, 0.797, 0.287])  # orients lines; edges are hardly ever normal to it


class _EdgeTable(NamedTuple):
    """The edges of one mesh as Mitsuba samples them.

    Attributes
    ----------
    interval : array (half-edges, 2)
        The interval of each half-edge that counts, as fractions of its length.
    opposite : array (half-edges, 2)
        For a half-edge whose partner has vertices of its own, the vertices opposite to the edge in its triangle and in
        its partner's; the same vertex twice for all others.
    """

    interval: HostArray
    opposite: HostArray


class UniqueEdges:
    """Choose one of several coincident mesh edges at each point of a line.

    Mitsuba takes the two half-edges of an edge whose vertices are stored twice for two borders of the surface, which
    are silhouettes from everywhere. Here one of them is a silhouette where both of its triangles are on one side.

    Parameters
    ----------
    tables : dict of mi.Mesh to _EdgeTable
    """

    def __init__(self, tables: dict[Any, _EdgeTable]) -> None:
        self._params = [mi.traverse(mesh) for mesh in tables]
        self._table = RaggedTable({shape_index(mesh): len(table.interval) for mesh, table in tables.items()})
        lower, upper = np.concatenate([table.interval for table in tables.values()]).astype(np.float32).T
        self._low, self._high = mi.Float(np.ascontiguousarray(lower)), mi.Float(np.ascontiguousarray(upper))
        first_vertex = np.cumsum([0, *(mesh.vertex_count() for mesh in tables)])[:-1]
        opposite = np.concatenate(
            [table.opposite + first for table, first in zip(tables.values(), first_vertex, strict=True)]
        )
        self._opposite = [mi.UInt32(np.ascontiguousarray(column, dtype=np.uint32)) for column in opposite.T]

    @classmethod
    def from_shapes(cls, shapes: Iterable[Any]) -> UniqueEdges | None:
        """Build from the meshes among `shapes` with coincident edges or vertices; None if there are none."""
        meshes = filter(has_triangles, dict.fromkeys(shapes))
        tables = {mesh: table for mesh in meshes if (table := _edge_table(mesh)) is not None}
        return cls(tables) if tables else None

    def vertex_positions(self) -> Any:
        """Return the positions of all vertices now, mi.Float, for :meth:`is_representative`."""
        return dr.concat([dr.detach(params["vertex_positions"]) for params in self._params])

    def is_representative(self, sample: Any, vertex_positions: Any) -> Any:
        """Return a mask of the silhouette samples, an ``mi.SilhouetteSample3f``, that lie on an edge that counts."""
        first, in_table = self._table.first_row(hit_shape_index(sample))
        edge = sample.projection_index
        half_edge = first + 3 * sample.prim_index + edge
        lower, upper = (dr.gather(mi.Float, bound, half_edge, in_table) for bound in (self._low, self._high))
        u, v = sample.uv.x, sample.uv.y
        fraction = dr.select(edge == 0, u, dr.select(edge == 1, v, 1.0 - u - v))
        own_side, partner_side = (
            dr.dot(sample.n, dr.gather(mi.Point3f, vertex_positions, vertex, in_table) - sample.p)
            for vertex in (dr.gather(mi.UInt32, column, half_edge, in_table) for column in self._opposite)
        )
        is_silhouette = own_side * partner_side > 0.0
        return ~in_table | (is_silhouette & (fraction >= lower) & (fraction <= upper))


def _edge_table(mesh: Any) -> _EdgeTable | None:
    """Return the table of a mesh; None if all edges count wholly and are not split."""
    edges = crease_edges(mesh)
    index, interval = uncovered_segments(vertex_positions(mesh), edge_vertices(mesh, edges)[0])
    split = topology_of(mesh).split
    if len(index) == len(edges) and np.all(interval == [0.0, 1.0]) and not len(split):
        return None
    intervals = np.tile([0.0, 1.0], (3 * mesh.face_count(), 1))
    intervals[split] = EMPTY
    intervals[edges] = EMPTY
    half_edge, partner = edges[index].T
    intervals[partner] = 1.0 - interval[:, ::-1]  # the partner runs in the opposite direction
    intervals[split[:, 1]] = EMPTY
    intervals[half_edge] = interval
    opposite = np.roll(triangles(mesh), -2, axis=1).ravel()
    opposites = np.stack([opposite, opposite], axis=1)
    opposites[split[:, 0], 1] = opposite[split[:, 1]]
    return _EdgeTable(intervals, opposites)


def uncovered_segments(positions: HostArray, edges: HostArray) -> tuple[HostArray, HostArray]:
    """Shorten edges so that each point of a line is covered by one edge.

    Parameters
    ----------
    positions : array (vertices, 3)
    edges : array (edges, 2)
        Vertex indices.

    Returns
    -------
    index : array (segments,)
        Increasing indices of the edges with a segment: all but the edges that others cover.
    interval : array (segments, 2)
        Begin and end of each segment, as fractions of its edge, 0 to 1.
    """
    points = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
    extent = float(np.max(np.ptp(points, axis=0), initial=0.0))
    first, second = points[edges].transpose(1, 0, 2) - points.mean(axis=0)
    length = np.linalg.norm(second - first, axis=1)
    index: HostArray = np.flatnonzero(length > 0.0)
    interval: HostArray = np.tile([0.0, 1.0], (len(index), 1))
    direction = (second - first) / np.where(length > 0.0, length, 1.0)[:, None]
    direction *= np.where(direction @ REFERENCE_DIRECTION < 0.0, -1.0, 1.0)[:, None]
    begin, stop = np.sum(first * direction, axis=1), np.sum(second * direction, axis=1)
    foot = (first - begin[:, None] * direction) / max(extent, 1e-300)
    lines = np.concatenate([direction / DIRECTION_TOLERANCE, foot / LINE_TOLERANCE], axis=1)
    for shift in CELL_SHIFTS:
        cells = np.floor(lines[index] + shift).astype(np.int64)
        # Much faster than rows of six columns.
        _, line, counts = np.unique(cells @ HASH_FACTORS, return_inverse=True, return_counts=True)
        is_shared = counts[line.reshape(-1)] > 1
        alone, line, shared = index[~is_shared], line.reshape(-1)[is_shared], index[is_shared]
        alone_interval, shared_interval = interval[~is_shared], interval[is_shared]
        start, size = begin[shared], (stop - begin)[shared]
        spans = np.sort(start[:, None] + size[:, None] * shared_interval, axis=1)
        row, uncovered_from = _uncovered(line, spans, LINE_TOLERANCE * extent)
        cut = uncovered_from > spans[row, 0]
        shared, shared_interval, start, size = shared[row], shared_interval[row], start[row], size[row]
        fraction = np.clip((uncovered_from - start)[cut] / size[cut], 0.0, 1.0)
        shared_interval[cut, np.where(size[cut] > 0.0, 0, 1)] = fraction
        index, interval = np.concatenate([alone, shared]), np.concatenate([alone_interval, shared_interval])
    order = np.argsort(index)
    return index[order], interval[order]


def _uncovered(line: HostArray, spans: HostArray, tolerance: float) -> tuple[HostArray, HostArray]:
    """Return the rows of the spans, shape (n, 2), that earlier spans of a line leave uncovered, and their new begins.

    Overlaps and remainders shorter than `tolerance` are taken for rounding errors.
    """
    order = np.lexsort((spans[:, 0], line))
    begin, stop = spans[order].T
    separation = line[order] * (2.0 * np.ptp(spans)) if len(spans) else line[order]
    reached = np.maximum.accumulate(stop + separation) - separation
    previous = np.concatenate([[-np.inf], reached])[: len(order)]
    previous[1:][np.diff(line[order]) != 0] = -np.inf
    uncovered_from = np.where(previous > begin + tolerance, previous, begin)
    remains = (uncovered_from == begin) | (stop - uncovered_from > tolerance)
    return order[remains], uncovered_from[remains]

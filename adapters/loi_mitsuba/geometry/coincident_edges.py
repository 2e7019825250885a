"""Edges of a mesh that run along each other, as where two of its parts end in one plane: each line counts once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.drjit.arrays import HostArray
from loi_mitsuba.drjit.ragged import RaggedTable, hit_shape_index, shape_index
from loi_mitsuba.geometry.mesh import crease_edges, edge_vertices, has_triangles

__all__ = ["UniqueEdges", "uncovered_segments"]

CLOSE: Final = 1e-5  # of the mesh's extent, between lines that are one: more than rounding, less than any bevel
ALIKE: Final = 1e-4  # between their unit directions
SHIFTS: Final = (0.0, 0.5)  # of the cells that lines are sorted into: what one cuts apart, the other does not
MIXED: Final = np.random.default_rng(0).integers(-(2**62), 2**62, 6)  # odds of two cells having one product: 2**-63
AHEAD: Final = np.array([0.531, 0.797, 0.287])  # lines are taken to go this way, to which hardly any edge is upright


class UniqueEdges:
    """Which points of the edges of meshes count, where some run along others.

    Parameters
    ----------
    pieces : dict
        By the number of a shape, where what counts of each side of its triangles begins and ends: shape (sides, 2).
    """

    def __init__(self, pieces: dict[int, HostArray]) -> None:
        low, high = np.concatenate(list(pieces.values())).astype(np.float32).T
        self._rows = RaggedTable({number: len(one) for number, one in pieces.items()})
        self._low, self._high = mi.Float(np.ascontiguousarray(low)), mi.Float(np.ascontiguousarray(high))

    @classmethod
    def of(cls, shapes: Iterable[Any]) -> UniqueEdges | None:
        """Of those of some shapes that are meshes with such edges; None without."""
        meshes = filter(has_triangles, dict.fromkeys(shapes))
        found = {shape_index(one): _of_sides(one) for one in meshes}
        pieces = {number: each for number, each in found.items() if each is not None}
        return cls(pieces) if pieces else None

    def counts(self, drawn: Any) -> Any:
        """Whether points of silhouettes do, an ``mi.SilhouetteSample3f``."""
        first, known = self._rows.of(hit_shape_index(drawn))
        edge = drawn.projection_index
        side = first + 3 * drawn.prim_index + edge
        low, high = (dr.gather(mi.Float, one, side, known) for one in (self._low, self._high))
        u, v = drawn.uv.x, drawn.uv.y
        along = dr.select(edge == 0, u, dr.select(edge == 1, v, 1.0 - u - v))
        return ~known | ((along >= low) & (along <= high))


def _of_sides(mesh: Any) -> HostArray | None:
    """What counts of each side of a mesh's triangles, from where it begins; None where all does."""
    sides = crease_edges(mesh)
    places = np.array(mi.traverse(mesh)["vertex_positions"]).reshape(-1, 3)
    which, between = uncovered_segments(places, edge_vertices(mesh, sides)[0])
    if len(which) == len(sides) and np.all(between == [0.0, 1.0]):
        return None
    found = np.tile([0.0, 1.0], (3 * mesh.face_count(), 1))
    found[sides] = [2.0, 2.0]  # beyond its end
    one, other = sides[which].T
    found[other] = 1.0 - between[:, ::-1]  # the other way round
    found[one] = between
    return found


def uncovered_segments(positions: HostArray, ends: HostArray) -> tuple[HostArray, HostArray]:
    """What is left of edges where each point of a line is covered by one of them.

    Parameters
    ----------
    positions : array (vertices, 3)
    ends : array (edges, 2)
        Numbers of vertices.

    Returns
    -------
    which : array (pieces,)
        Numbers of edges, in their order. An edge that others cover has no piece, every other one has one.
    between : array (pieces, 2)
        Where each piece begins and ends, as shares of the way along its edge, 0 to 1.
    """
    points = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
    extent = float(np.max(np.ptp(points, axis=0), initial=0.0))
    first, second = points[ends].transpose(1, 0, 2) - points.mean(axis=0)
    length = np.linalg.norm(second - first, axis=1)
    which: HostArray = np.flatnonzero(length > 0.0)
    between: HostArray = np.tile([0.0, 1.0], (len(which), 1))
    way = (second - first) / np.where(length > 0.0, length, 1.0)[:, None]
    way *= np.where(way @ AHEAD < 0.0, -1.0, 1.0)[:, None]
    begin, end = np.sum(first * way, axis=1), np.sum(second * way, axis=1)
    foot = (first - begin[:, None] * way) / max(extent, 1e-300)
    lines = np.concatenate([way / ALIKE, foot / CLOSE], axis=1)
    for shift in SHIFTS:
        cells = np.floor(lines[which] + shift).astype(np.int64)
        _, line = np.unique(cells @ MIXED, return_inverse=True)  # much faster than of six columns
        start, size = begin[which], (end - begin)[which]
        spans = np.sort(start[:, None] + size[:, None] * between, axis=1)
        kept, left = _uncovered(line.reshape(-1), spans, CLOSE * extent)
        cut = left > spans[kept, 0]
        which, between, start, size = which[kept], between[kept], start[kept], size[kept]
        between[cut, np.where(size[cut] > 0.0, 0, 1)] = np.clip((left - start)[cut] / size[cut], 0.0, 1.0)
    order = np.argsort(which)  # of the edges: where none is cut, nothing is otherwise
    return which[order], between[order]


def _uncovered(line: HostArray, spans: HostArray, least: float) -> tuple[HostArray, HostArray]:
    """Of spans of lines, shape (n, 2), the numbers of those that others do not cover, and where what is left begins.

    What they cover of each other, or leave, of less than `least` is rounding.
    """
    order = np.lexsort((spans[:, 0], line))
    begin, end = spans[order].T
    apart = line[order] * (2.0 * np.ptp(spans)) if len(spans) else line[order]
    reached = np.maximum.accumulate(end + apart) - apart
    before = np.concatenate([[-np.inf], reached])[: len(order)]
    before[1:][np.diff(line[order]) != 0] = -np.inf
    left = np.where(before > begin + least, before, begin)
    kept = (left == begin) | (end - left > least)
    return order[kept], left[kept]

"""Edge topology of triangle meshes: adjacent faces, connected components and smoothing groups."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from loi_core.renderers.validation import FloatArray

__all__ = ["FloatArray", "IndexArray", "Topology", "concatenate", "edge_topology", "weld_vertices"]

IndexArray: TypeAlias = np.ndarray[Any, np.dtype[np.int32]]


class Topology(NamedTuple):
    """Faces and edges of triangle meshes, by vertex indices.

    Welded indices are shared by vertices of equal position, so that triangles along a seam are adjacent. Only triangles
    of different components are tested for intersection. Smoothing groups are components without shading discontinuities
    inside. Boundaries, creases, seams, and edges of three or more triangles are discontinuous from every viewpoint.
    """

    faces: IndexArray  # (m, 3)
    welded_faces: IndexArray  # (m, 3)
    component: IndexArray  # (m,)
    smoothing_group: IndexArray  # (m,)
    edges: IndexArray  # (e, 2)
    welded_edges: IndexArray  # (e, 2)
    adjacent_faces: IndexArray  # (e, 2): the first two triangles at each edge, -1 if there is no second one
    discontinuous: np.ndarray[Any, np.dtype[np.bool_]]  # (e,)
    has_several_components: bool
    inconsistent_edges: int  # number of edges of two triangles in the same direction, so that one shows its back


def weld_vertices(vertices: FloatArray) -> IndexArray:
    """Return an index for each vertex, shape (n,), which vertices of equal coordinates share."""
    if not len(vertices):
        return np.zeros(0, np.int32)
    order = np.lexsort(vertices.T)
    is_new = np.any(np.diff(vertices[order], axis=0) != 0.0, axis=1)
    welds = np.empty(len(vertices), np.int32)
    welds[order] = np.append(0, np.cumsum(is_new))
    return welds


def edge_topology(faces: IndexArray, welds: IndexArray, *, creased: bool, seams: bool) -> Topology:
    """Build the topology of one mesh from its faces, shape (m, 3), and the indices of :func:`weld_vertices`.

    With `creased`, colours or normals belong to triangles, and every edge is discontinuous. With `seams`, vertices have
    colours or texture coordinates, which may differ between welded vertices.
    """
    welded_faces = welds[faces].astype(np.int32)
    edges, welded_edges = _half_edges(faces), _half_edges(welded_faces)
    is_reversed = welded_edges[:, 0] > welded_edges[:, 1]
    edges[is_reversed] = edges[is_reversed, ::-1]
    welded_edges[is_reversed] = welded_edges[is_reversed, ::-1]
    triangle = np.repeat(np.arange(len(faces), dtype=np.int32), 3)
    order = np.flatnonzero(welded_edges[:, 0] != welded_edges[:, 1])
    key = welded_edges[:, 0].astype(np.int64) * (int(welds.max(initial=0)) + 1) + welded_edges[:, 1]
    order = order[np.argsort(key[order], kind="stable")]
    key, edges, welded_edges = key[order], edges[order], welded_edges[order]
    triangle, is_reversed = triangle[order], is_reversed[order]
    first = np.flatnonzero(np.append(True, key[1:] != key[:-1])) if len(key) else np.zeros(0, np.int64)
    count = np.diff(np.append(first, len(key)))
    second = np.minimum(first + 1, max(len(key) - 1, 0))
    is_shared = count >= 2
    adjacent = np.stack([triangle[first], np.where(is_shared, triangle[second], -1)], axis=1)
    adjacent = adjacent.astype(np.int32).reshape(-1, 2)
    is_seam = is_shared & np.any(edges[first] != edges[second], axis=1) & seams
    discontinuous = (count != 2) | is_seam | creased
    component = _components(len(faces), adjacent[is_shared])
    return Topology(
        faces=np.ascontiguousarray(faces, dtype=np.int32),
        welded_faces=welded_faces,
        component=component,
        smoothing_group=_components(len(faces), adjacent[is_shared & ~discontinuous]),
        edges=edges[first].astype(np.int32).reshape(-1, 2),
        welded_edges=welded_edges[first].astype(np.int32).reshape(-1, 2),
        adjacent_faces=adjacent,
        discontinuous=discontinuous,
        has_several_components=bool(component.any()),
        inconsistent_edges=int(np.sum((count == 2) & (is_reversed[first] == is_reversed[second]))),
    )


def concatenate(topologies: Sequence[Topology], vertex_counts: Sequence[int]) -> Topology:
    """Return the topology of several meshes as one list of triangles."""
    if len(topologies) == 1:
        return topologies[0]

    def shifted(name: str, counts: Sequence[int], *row_shape: int) -> IndexArray:
        offsets = np.append(0, np.cumsum(counts)).astype(np.int32)
        arrays = [getattr(topology, name) for topology in topologies]
        rows = [np.where(array < 0, -1, array + offset) for array, offset in zip(arrays, offsets, strict=False)]
        return np.concatenate([np.zeros((0, *row_shape), np.int32), *rows]).astype(np.int32)

    n_components = [int(topology.component.max(initial=-1)) + 1 for topology in topologies]
    n_groups = [int(topology.smoothing_group.max(initial=-1)) + 1 for topology in topologies]
    return Topology(
        faces=shifted("faces", vertex_counts, 3),
        welded_faces=shifted("welded_faces", vertex_counts, 3),
        component=shifted("component", n_components),
        smoothing_group=shifted("smoothing_group", n_groups),
        edges=shifted("edges", vertex_counts, 2),
        welded_edges=shifted("welded_edges", vertex_counts, 2),
        adjacent_faces=shifted("adjacent_faces", [len(topology.faces) for topology in topologies], 2),
        discontinuous=np.concatenate([np.zeros(0, np.bool_), *(topology.discontinuous for topology in topologies)]),
        has_several_components=sum(n_components) > 1,
        inconsistent_edges=sum(topology.inconsistent_edges for topology in topologies),
    )


def _half_edges(faces: IndexArray) -> IndexArray:
    """Return the three directed edges of each triangle, shape (3 * m, 2)."""
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)


def _components(count: int, pairs: IndexArray) -> IndexArray:
    """Label the connected components of a graph of `count` nodes with edges `pairs`, shape (k, 2), from 0."""
    label = np.arange(count)
    while True:
        previous = label
        lowest = np.minimum(previous[pairs[:, 0]], previous[pairs[:, 1]])
        label = previous.copy()
        np.minimum.at(label, pairs[:, 0], lowest)
        np.minimum.at(label, pairs[:, 1], lowest)
        label = label[label]
        if np.array_equal(label, previous):
            return np.unique(label, return_inverse=True)[1].reshape(-1).astype(np.int32)

"""Edge topology of triangle meshes: adjacent faces, connected components and smoothing groups."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from loi_core.renderers.validation import FloatArray

__all__ = ["FloatArray", "IndexArray", "Topology", "concatenate", "edge_topology", "weld_vertices"]

IndexArray: TypeAlias = np.ndarray[Any, np.dtype[np.int32]]


class Topology(NamedTuple):
    """Faces and edges of triangle meshes.

    Attributes
    ----------
    faces : array of int, shape (m, 3)
        Vertex indices of each triangle.
    welded_faces : array of int, shape (m, 3)
        The same with one index for all vertices of equal position, so that triangles along a seam are adjacent.
    component : array of int, shape (m,)
        Connected component of each triangle. Only triangles of different components are tested for intersection.
    smoothing_group : array of int, shape (m,)
        Connected component of each triangle if shading discontinuities separate triangles.
    edges, welded_edges : array of int, shape (e, 2)
        Vertex indices of each edge, before and after welding.
    adjacent_faces : array of int, shape (e, 2)
        The first two triangles at each edge, -1 if there is no second one.
    discontinuous : array of bool, shape (e,)
        Edges with a shading discontinuity from every viewpoint: boundaries, creases, seams, and edges of three or more
        triangles.
    has_several_components : bool
    inconsistent_edges : int
        Number of edges of exactly two triangles that run in the same direction, so that one shows its back.
    """

    faces: IndexArray
    welded_faces: IndexArray
    component: IndexArray
    smoothing_group: IndexArray
    edges: IndexArray
    welded_edges: IndexArray
    adjacent_faces: IndexArray
    discontinuous: np.ndarray[Any, np.dtype[np.bool_]]
    has_several_components: bool
    inconsistent_edges: int


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
    vertex_offset = np.append(0, np.cumsum(vertex_counts)).astype(np.int32)
    face_offset = np.append(0, np.cumsum([len(topology.faces) for topology in topologies])).astype(np.int32)

    def shifted(name: str, columns: int) -> IndexArray:
        rows = [getattr(topology, name) + offset for topology, offset in zip(topologies, vertex_offset, strict=False)]
        return np.concatenate([np.zeros((0, columns), np.int32), *rows])

    adjacent = [
        np.where(topology.adjacent_faces < 0, -1, topology.adjacent_faces + offset)
        for topology, offset in zip(topologies, face_offset, strict=False)
    ]
    return Topology(
        faces=shifted("faces", 3),
        welded_faces=shifted("welded_faces", 3),
        component=_concatenate_labels([topology.component for topology in topologies]),
        smoothing_group=_concatenate_labels([topology.smoothing_group for topology in topologies]),
        edges=shifted("edges", 2),
        welded_edges=shifted("welded_edges", 2),
        adjacent_faces=np.concatenate([np.zeros((0, 2), np.int32), *adjacent]).astype(np.int32),
        discontinuous=np.concatenate([np.zeros(0, np.bool_), *(topology.discontinuous for topology in topologies)]),
        has_several_components=sum(int(topology.component.max(initial=-1)) + 1 for topology in topologies) > 1,
        inconsistent_edges=sum(topology.inconsistent_edges for topology in topologies),
    )


def _half_edges(faces: IndexArray) -> IndexArray:
    """Return the three directed edges of each triangle, shape (3 * m, 2)."""
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)


def _concatenate_labels(labels: Sequence[IndexArray]) -> IndexArray:
    """Return the labels of several meshes, each from 0, as distinct labels."""
    shifted, n_labels = [np.zeros(0, np.int32)], 0
    for label in labels:
        shifted.append(label + np.int32(n_labels))
        n_labels += int(label.max(initial=-1)) + 1
    return np.concatenate(shifted)


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

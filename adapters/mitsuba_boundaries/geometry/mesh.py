"""Vertices, creases and normals of Mitsuba's meshes; see :mod:`mitsuba_boundaries.geometry.topology`."""

from __future__ import annotations

from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import HostArray
from mitsuba_boundaries.geometry.topology import half_edge_ends, topology_of

__all__ = [
    "component_bounds",
    "corner_normals",
    "crease_edges",
    "edge_vertices",
    "face_normals",
    "has_triangles",
    "is_closed",
    "is_flat_shaded",
    "normal_distance",
    "triangles",
    "vertex_positions",
    "weld_vertices",
]

MIN_CREASE: Final = (
    1e-4  # distance between unit normals of adjacent triangles: above the rounding error of coplanar ones
)
NORMAL_TOLERANCE: Final = 0.05  # distance between unit normals that count as equal: 3 degrees


def has_triangles(shape: Any) -> bool:
    """Return whether a shape is a mesh with a list of triangles. Mitsuba's rectangle is a mesh without one."""
    return isinstance(shape, mi.Mesh) and "faces" in mi.traverse(shape)


def triangles(shape: Any) -> HostArray:
    """Return the vertex indices of each triangle, shape (m, 3)."""
    return np.array(mi.traverse(shape)["faces"], dtype=np.int64).reshape(-1, 3)


def vertex_positions(shape: Any) -> HostArray:
    """Return the positions of the vertices, shape (n, 3), float64."""
    return np.array(mi.traverse(shape)["vertex_positions"], dtype=np.float64).reshape(-1, 3)


def crease_edges(shape: Any, min_distance: float = MIN_CREASE, *, borders: bool = True) -> HostArray:
    """Return the edges at which a mesh bends or ends, as pairs of half-edges, shape (n, 2).

    Parameters
    ----------
    shape : mi.Mesh
    min_distance : float
        Smallest distance between the unit normals of two triangles that form a crease.
    borders : bool
        Whether to append border and non-manifold edges, whose pair is the same half-edge twice.
    """
    topology, normals = topology_of(shape), face_normals(shape)
    pairs, unpaired = topology.paired, topology.unpaired
    creases = pairs[normal_distance(normals[pairs[:, 0] // 3], normals[pairs[:, 1] // 3]) > min_distance]
    return np.concatenate([creases, np.stack([unpaired, unpaired], axis=1)]) if borders else np.asarray(creases)


def edge_vertices(shape: Any, edges: HostArray) -> tuple[HostArray, HostArray]:
    """Return the end vertices, shape (n, 2), and the opposite vertices, shape (n, 2), of pairs of half-edges.

    The opposite vertices are the third corners of the two adjacent triangles, equal for a border edge.
    """
    faces = triangles(shape)
    return np.asarray(half_edge_ends(faces)[edges[:, 0]]), np.asarray(np.roll(faces, -2, axis=1).ravel()[edges])


def component_bounds(shape: Any, component: HostArray) -> tuple[HostArray, HostArray]:
    """Return the lower and upper corners of the bounding box of each component, shape (components, 3) each."""
    corners = vertex_positions(shape)[triangles(shape)]
    lower, upper = (np.full((int(component.max(initial=-1)) + 1, 3), sign * np.inf) for sign in (1.0, -1.0))
    np.minimum.at(lower, component, corners.min(axis=1))
    np.maximum.at(upper, component, corners.max(axis=1))
    return lower, upper


def is_closed(shape: Any) -> bool:
    """Return whether a welded mesh has no border edge; False for Mitsuba's rectangle, which has no triangles."""
    return "faces" in mi.traverse(shape) and topology_of(shape).border_edges == 0


def normal_distance(first: HostArray, second: HostArray) -> HostArray:
    """Return the Euclidean distance between unit normals, along the last axis."""
    return np.asarray(np.linalg.norm(first - second, axis=-1))


def face_normals(shape: Any) -> HostArray:
    """Return the unit normals of the triangles, shape (m, 3)."""
    a, b, c = vertex_positions(shape)[triangles(shape)].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


def corner_normals(shape: Any) -> HostArray:
    """Return the unit shading normals at the corners of each triangle, shape (m, 3, 3)."""
    normals = np.array(mi.traverse(shape)["vertex_normals"], dtype=np.float64).reshape(-1, 3)
    if len(normals) and not shape.has_face_normals():
        return np.asarray(normals[triangles(shape)])
    return np.repeat(face_normals(shape)[:, None], 3, axis=1)


def is_flat_shaded(shape: Any) -> bool:
    """Return whether the shading normals of a mesh are its face normals, as of a cube."""
    return bool(np.all(normal_distance(corner_normals(shape), face_normals(shape)[:, None]) < NORMAL_TOLERANCE))


def weld_vertices(shape: Any) -> None:
    """Make triangles share the first of the vertices at each position; the other vertices stay, unused.

    Unused vertices have no gradient, so this is right only for shapes whose vertices all move together. Flat shading is
    kept: without vertex normals, Mitsuba shades by face normals.
    """
    params = mi.traverse(shape)
    if "vertex_normals" in params and is_flat_shaded(shape):
        params["vertex_normals"] = dr.zeros(mi.Float, 0)
    params["faces"] = mi.UInt32(topology_of(shape).welded.astype(np.uint32).ravel())
    params.update()

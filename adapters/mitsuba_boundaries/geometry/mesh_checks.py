"""Mesh properties that make Mitsuba's gradients of moving silhouettes wrong.

Projective sampling takes each edge that belongs to a single triangle for a border of the surface. An edge whose
vertices are stored twice is two such edges, so its motion counts twice (mitsuba3#1648).
"""

from __future__ import annotations

from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import HostArray
from mitsuba_boundaries.geometry.bounds import bounding_box
from mitsuba_boundaries.geometry.mesh import (
    NORMAL_TOLERANCE,
    corner_normals,
    crease_edges,
    face_normals,
    has_triangles,
    is_closed,
    normal_distance,
    triangles,
    vertex_positions,
)
from mitsuba_boundaries.geometry.topology import half_edge_ends, topology_of

__all__ = [
    "has_creases",
    "has_inward_normals",
    "has_smoothed_edges",
    "is_sharp_edged",
    "is_unwelded",
    "non_manifold_fraction",
]

SURFACE_SAMPLES: Final = 1024  # points of a shape, to find where its normals point
MIN_INWARD_FRACTION: Final = 0.5  # of the enclosed volume: double-sided meshes, with faces back to back, cancel to 0
SHARP_EDGE: Final = 0.5  # distance between unit normals: about 30 degrees
MIN_SHARP_TRIANGLES: Final = 0.5  # fraction of the triangles
MIN_SMOOTHED_AREA: Final = 0.25  # fraction of the area of a mesh
MAX_BORDER_EDGES: Final = 4000  # the search for T-junctions takes quadratic time
MAX_JUNCTION_DISTANCE: Final = 1e-4  # between a vertex and an edge that it lies on, as a fraction of the edge's length


def is_unwelded(shape: Any) -> bool:
    """Return whether a mesh has edges that are borders only because their vertices are stored more than once."""
    return has_triangles(shape) and topology_of(shape).is_unwelded


def has_creases(shape: Any) -> bool:
    """Return whether shading normals are discontinuous between adjacent triangles, as between the faces of a box."""
    if not has_triangles(shape):
        return False
    normals = corner_normals(shape).reshape(-1, 3)
    next_corner = np.arange(len(normals)).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    first, second = topology_of(shape).paired.T
    # The two half-edges run in opposite directions: each begins at the end of its partner.
    bend = np.maximum(
        normal_distance(normals[first], normals[next_corner[second]]),
        normal_distance(normals[next_corner[first]], normals[second]),
    )
    return bool(np.any(bend > NORMAL_TOLERANCE))


def non_manifold_fraction(shape: Any) -> float:
    """Return the fraction, by length, of a mesh's edges that Mitsuba counts several times even after welding.

    These are edges of more than two triangles, and border edges that run along others (T-junctions).
    """
    if not has_triangles(shape):
        return 0.0
    positions = vertex_positions(shape)
    topology = topology_of(shape)
    half_edges = half_edge_ends(topology.welded)
    single = np.sort(half_edges[topology.unpaired], axis=1)
    edges, counts = np.unique(single, axis=0, return_counts=True) if len(single) else (single, np.zeros(0))
    non_manifold, borders = edges[counts > 2], edges[counts == 1]
    if 0 < len(borders) <= MAX_BORDER_EDGES:
        non_manifold = np.concatenate([non_manifold, borders[_has_junction(positions, borders)]])

    def length(edges: HostArray) -> float:
        return float(np.sum(np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1)))

    total = length(half_edges[crease_edges(shape, borders=False)[:, 0]]) + length(edges)
    return length(non_manifold) / total if total > 0.0 else 0.0


def _has_junction(positions: HostArray, borders: HostArray) -> HostArray:
    """Return a mask of the border edges, pairs of vertices, that contain an end of another border edge."""
    vertices = positions[np.unique(borders)]
    has_junction = np.zeros(len(borders), dtype=bool)
    for index, (first, second) in enumerate(borders):
        edge = positions[second] - positions[first]
        squared_length = float(edge @ edge)
        fraction = (vertices - positions[first]) @ edge / max(squared_length, 1e-300)
        interior = (fraction > MAX_JUNCTION_DISTANCE) & (fraction < 1.0 - MAX_JUNCTION_DISTANCE)
        offset = vertices[interior] - positions[first] - fraction[interior, None] * edge
        has_junction[index] = bool(np.any(np.sum(offset**2, axis=1) < MAX_JUNCTION_DISTANCE**2 * squared_length))
    return has_junction


def has_inward_normals(shape: Any) -> bool:
    """Return whether the normals of a sphere, or of a closed mesh without flat shading, point inwards."""
    corners = bounding_box(shape)
    centre = corners.mean(axis=0)
    if shape.class_name() == "Sphere":
        offset = np.array([np.linalg.norm(np.ptp(corners, axis=0)), 0.0, 0.0])
        ray = mi.Ray3f(mi.Point3f(*(centre + offset).tolist()), mi.Vector3f(-1.0, 0.0, 0.0))
        with dr.suspend_grad():
            return bool(np.array(shape.ray_intersect(ray).n).reshape(3)[0] < 0.0)
    if not isinstance(shape, mi.Mesh) or "vertex_normals" not in mi.traverse(shape) or not is_closed(shape):
        return False
    a, b, c = vertex_positions(shape)[triangles(shape)].transpose(1, 0, 2)
    winding = np.sum(np.cross(a - centre, b - centre) * (c - centre), axis=1)  # six times the signed volume
    with dr.suspend_grad():
        uv = np.random.default_rng(0).random((2, SURFACE_SAMPLES), dtype=np.float32)
        sample = shape.sample_position(0.0, mi.Point2f(uv))
        flux = np.sum((np.array(sample.p) - centre[:, None]) * np.array(sample.n), axis=0)  # Gauss: 3 times the volume
    return any(float(np.sum(terms)) < -MIN_INWARD_FRACTION * float(np.sum(np.abs(terms))) for terms in (winding, flux))


def is_sharp_edged(shape: Any) -> bool:
    """Return whether most triangles of a mesh have an edge across which shading differs much, as of a cube.

    Radiance is discontinuous across such an edge in view, so its motion has a gradient of its own. Projective sampling
    finds it only where its vertices are stored twice.
    """
    normals = corner_normals(shape)
    faces = topology_of(shape).welded
    count = int(faces.max(initial=-1)) + 1
    reference = np.zeros((count, 3))
    reference[faces] = normals  # at each vertex, the normal of one of its corners
    is_sharp = np.zeros(count, dtype=bool)
    is_sharp[faces[normal_distance(normals, reference[faces]) > SHARP_EDGE]] = True
    return float(np.mean(np.any(is_sharp[faces], axis=1))) > MIN_SHARP_TRIANGLES


def has_smoothed_edges(shape: Any) -> bool:
    """Return whether much of a mesh is shaded as if its sharp edges were round, as a box of 8 vertices is."""
    if not has_triangles(shape):
        return False
    a, b, c = vertex_positions(shape)[triangles(shape)].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    # A flat card with normals of its own also has shading normals that differ from its face normals, but no sharp edge.
    sharp = np.isin(np.arange(len(area)), crease_edges(shape, SHARP_EDGE, borders=False) // 3)
    smoothed = np.any(normal_distance(corner_normals(shape), face_normals(shape)[:, None]) > SHARP_EDGE, axis=1)
    return float(area @ (sharp & smoothed)) > MIN_SMOOTHED_AREA * float(np.sum(area))

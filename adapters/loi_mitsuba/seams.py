"""Meshes that store the vertices of an edge more than once, as along the seams of a texture.

Projective sampling takes an edge that belongs to one triangle for a border of the surface. An edge whose vertices are
stored twice is two such edges, and what moves them counts twice.
"""

from __future__ import annotations

from typing import Any, Final

import mitsuba as mi
import numpy as np

from loi_core.support.arrays import Host

__all__ = ["has_seams", "is_closed", "is_hard", "merge_seams"]

HARD: Final = 0.5  # of the triangles, and between the unit normals of two that meet: some 30 degrees


def has_seams(shape: Any) -> bool:
    """Whether edges of a shape are borders only because their vertices are not shared."""
    if not isinstance(shape, mi.Mesh):
        return False
    params = mi.traverse(shape)
    if "faces" not in params:  # a rectangle is a mesh of Mitsuba's own, whose border is its outline
        return False
    faces, place = _faces(params), _places(params)
    return _borders(place[faces]) < _borders(faces)


def is_closed(shape: Any) -> bool:
    """Whether a mesh has no border, however its vertices are stored. A rectangle, whose outline is one, is not."""
    params = mi.traverse(shape)
    return "faces" in params and _borders(_places(params)[_faces(params)]) == 0


def is_hard(shape: Any) -> bool:
    """Whether most triangles meet others whose shading differs much, as the sides of a cube do.

    Where such an edge is in view, brightness jumps across it, and it has a gradient of its own. Projective sampling
    finds it only where its vertices are stored twice.
    """
    params = mi.traverse(shape)
    faces, place = _faces(params), _places(params)
    normals = np.array(params["vertex_normals"], dtype=np.float64).reshape(-1, 3)
    if shape.has_face_normals() or not len(normals):
        a, b, c = np.array(params["vertex_positions"], dtype=np.float64).reshape(-1, 3)[faces].transpose(1, 0, 2)
        flat = np.cross(b - a, c - a)
        corners = np.repeat((flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30))[:, None], 3, axis=1)
    else:
        corners = normals[faces]
    at = place[faces]
    first = np.zeros((len(place), 3))
    first[at] = corners  # of each place, that of one of its corners
    hard = np.zeros(len(place), dtype=bool)
    hard[at[np.linalg.norm(corners - first[at], axis=-1) > HARD]] = True
    return float(np.mean(np.any(hard[at], axis=1))) > HARD


def merge_seams(shape: Any) -> None:
    """Have triangles share the first of the vertices at a place; the others stay, and belong to none.

    Only where all vertices of the shape are moved together, since those that belong to no triangle have no gradient.
    """
    params = mi.traverse(shape)
    params["faces"] = mi.UInt32(_places(params)[_faces(params)].astype(np.uint32).ravel())
    params.update()


def _faces(params: Any) -> Host:
    return np.array(params["faces"], dtype=np.int64).reshape(-1, 3)


def _places(params: Any) -> Host:
    """For each vertex, the first one at the same place."""
    positions = np.array(params["vertex_positions"], dtype=np.float32).reshape(-1, 3)
    rows = np.ascontiguousarray(positions + 0.0).view([("", np.float32)] * 3)  # + 0.0 makes -0.0 equal to 0.0
    _, first, which = np.unique(rows, return_index=True, return_inverse=True)
    return np.asarray(first[which.reshape(-1)])


def _borders(faces: Host) -> int:
    """Number of edges that belong to one triangle only."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    counts = np.unique(edges[:, 0] * (faces.max(initial=0) + 1) + edges[:, 1], return_counts=True)[1]
    return int(np.count_nonzero(counts == 1))

"""Meshes as Mitsuba stores them: where they bend or end, and where they store the vertices of an edge more than once.

They do so along the seams of a texture, and between sides that are shaded apart. Projective sampling takes an edge that
belongs to one triangle for a border of the surface. An edge whose vertices are stored twice is two such edges, and what
moves them counts twice.
"""

from __future__ import annotations

from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.drjit.arrays import HostArray
from loi_mitsuba.geometry.bounds import bounding_box

__all__ = [
    "component_bounds",
    "connected_components",
    "crease_edges",
    "edge_vertices",
    "has_creases",
    "has_inward_normals",
    "has_smoothed_edges",
    "has_triangles",
    "is_closed",
    "is_flat_shaded",
    "is_sharp_edged",
    "is_unwelded",
    "non_manifold_fraction",
    "weld_vertices",
]

SURFACE: Final = 1024  # points of a shape, for where its normals point
INWARDS: Final = 0.5  # of what they enclose, that is to be negative: not where sides are there twice, back to back
CREASE: Final = 0.05  # between the unit normals of two triangles that are not of one side: 3 degrees
BENT: Final = 1e-4  # between them where two triangles are not of one plane, rounding apart
HARD: Final = 0.5  # of the triangles, and between the unit normals of two that meet: some 30 degrees
ROUND: Final = 0.5  # between the normals of a corner and its triangle, and of that and a neighbour: some 30 degrees
ROUNDED: Final = 0.25  # of the area of a mesh, in triangles with such a corner
MOST_BORDERS: Final = 4000  # edges: of more it would take too long to find which run along others
ALONG: Final = 1e-4  # of its length: how far beside an edge a vertex may be that lies on it


def is_unwelded(shape: Any) -> bool:
    """Whether edges of a shape are borders only because their vertices are not shared."""
    if not isinstance(shape, mi.Mesh):
        return False
    params = mi.traverse(shape)
    if "faces" not in params:  # a rectangle is a mesh of Mitsuba's own, whose border is its outline
        return False
    faces, place = _faces(params), _places(params)
    return _borders(place[faces]) < _borders(faces)


def has_triangles(shape: Any) -> bool:
    """Whether a shape is a mesh that says what its triangles are: a rectangle is a mesh of Mitsuba's that does not."""
    return isinstance(shape, mi.Mesh) and "faces" in mi.traverse(shape)


def has_creases(shape: Any) -> bool:
    """Whether shading jumps between triangles of a shape that meet, as between the sides of a box."""
    if not has_triangles(shape):
        return False
    pairs, _ = _meetings(shape)
    corners = _corner_normals(shape).reshape(-1, 3)
    after = np.arange(len(corners)).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    first, second = pairs.T
    # The two go along the edge in opposite directions, so that one begins where the other ends.
    turn = np.maximum(_apart(corners[first], corners[after[second]]), _apart(corners[after[first]], corners[second]))
    return bool(np.any(turn > CREASE))


def crease_edges(shape: Any) -> HostArray:
    """All edges of a mesh at which it bends or ends, as pairs of sides of triangles, shape (n, 2).

    Sides are numbered 3 a triangle, in their order. Of an edge at which a triangle ends, it is the same one twice.
    """
    pairs, alone = _meetings(shape)
    params = mi.traverse(shape)
    bent = _bent(params, _faces(params), pairs)
    return np.concatenate([bent, np.stack([alone, alone], axis=1)])


def edge_vertices(shape: Any, sides: HostArray) -> tuple[HostArray, HostArray]:
    """Edges of a mesh, given as by :func:`sides_of`, as numbers of vertices, shape (n, 2).

    First their ends; then the third corners of the two triangles that meet there, the same one twice where one ends.
    """
    faces = _faces(mi.traverse(shape))
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    return np.asarray(ends[sides[:, 0]]), np.asarray(np.roll(faces, -2, axis=1).ravel()[sides])


def connected_components(shape: Any) -> HostArray:
    """The number of the part that each triangle of a mesh belongs to, from 0, shape (m,).

    Triangles are of one part where they meet at an edge at which no others do.
    """
    pairs, _ = _meetings(shape)
    count = len(_faces(mi.traverse(shape)))
    first, second = pairs.T // 3
    part = np.arange(count)
    while True:
        least = np.minimum(part[first], part[second])
        joined = part.copy()
        for side in (first, second):
            np.minimum.at(joined, part[side], least)  # of the triangles that the parts are called after
            np.minimum.at(joined, side, least)
        joined = joined[joined]
        if np.array_equal(joined, part):
            return np.unique(part, return_inverse=True)[1].reshape(-1)
        part = joined


def component_bounds(shape: Any, part: HostArray) -> tuple[HostArray, HostArray]:
    """The lower and upper corners of the boxes around a mesh's parts, of which `part` has numbers: shape (parts, 3)."""
    params = mi.traverse(shape)
    corners = np.array(params["vertex_positions"], dtype=np.float64).reshape(-1, 3)[_faces(params)]
    low, high = (np.full((int(part.max(initial=-1)) + 1, 3), sign * np.inf) for sign in (1.0, -1.0))
    np.minimum.at(low, part, corners.min(axis=1))
    np.maximum.at(high, part, corners.max(axis=1))
    return low, high


def non_manifold_fraction(shape: Any) -> float:
    """How much, by length, of a mesh's edges Mitsuba counts several times however vertices are shared: 0 to 1.

    Those are edges at which more than two triangles meet, and borders that run along others (T-junctions).
    """
    if not has_triangles(shape):
        return 0.0
    params = mi.traverse(shape)
    positions = np.array(params["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    pairs, alone = _meetings(shape)
    faces = _faces(params)
    at = _places(params)[faces]
    ends = np.stack([at, np.roll(at, -1, axis=1)], axis=-1).reshape(-1, 2)
    single = np.sort(ends[alone], axis=1)
    kinds, counts = np.unique(single, axis=0, return_counts=True) if len(single) else (single, np.zeros(0))
    crowded, borders = kinds[counts > 2], kinds[counts == 1]
    if 0 < len(borders) <= MOST_BORDERS:
        crowded = np.concatenate([crowded, borders[_run_along_others(positions, borders)]])

    def length(edges: HostArray) -> float:
        return float(np.sum(np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1)))

    total = length(ends[_bent(params, faces, pairs)[:, 0]]) + length(kinds)
    return length(crowded) / total if total > 0.0 else 0.0


def _run_along_others(positions: HostArray, borders: HostArray) -> HostArray:
    """Which borders, pairs of vertices, have an end of another border between their own."""
    others = positions[np.unique(borders)]
    found = np.zeros(len(borders), dtype=bool)
    for number, (one, other) in enumerate(borders):
        along = positions[other] - positions[one]
        size = float(along @ along)
        share = (others - positions[one]) @ along / max(size, 1e-300)
        inside = (share > ALONG) & (share < 1.0 - ALONG)
        beside = others[inside] - positions[one] - share[inside, None] * along
        found[number] = bool(np.any(np.sum(beside**2, axis=1) < ALONG**2 * size))
    return found


def _bent(params: Any, faces: HostArray, pairs: HostArray, least: float = BENT) -> HostArray:
    """Of pairs of sides, those between whose triangles' unit normals there is more than so much."""
    flat = _flat_normals(params, faces).reshape(-1, 3)
    return np.asarray(pairs[_apart(flat[pairs[:, 0]], flat[pairs[:, 1]]) > least])


def _meetings(shape: Any) -> tuple[HostArray, HostArray]:
    """Sides of triangles, 3 a triangle in their order, that are at one place: in pairs, shape (n, 2), or by themselves.

    Of an edge at which more than two triangles meet, all are by themselves.
    """
    params = mi.traverse(shape)
    at = _places(params)[_faces(params)]
    edges = np.sort(np.stack([at, np.roll(at, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    numbers = edges[:, 0] * (at.max(initial=0) + 1) + edges[:, 1]
    _, which, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    order = np.argsort(which, kind="stable")
    twice = counts[which[order]] == 2
    return order[twice].reshape(-1, 2), order[~twice]


def _apart(one: HostArray, other: HostArray) -> HostArray:
    return np.asarray(np.linalg.norm(one - other, axis=-1))


def is_closed(shape: Any) -> bool:
    """Whether a mesh has no border, however its vertices are stored. A rectangle, whose outline is one, is not."""
    params = mi.traverse(shape)
    return "faces" in params and _borders(_places(params)[_faces(params)]) == 0


def has_inward_normals(shape: Any) -> bool:
    """Whether the normals of a sphere, or of a closed mesh that is not flat-shaded, point inwards."""
    corners = bounding_box(shape)
    middle = corners.mean(axis=0)
    if shape.class_name() == "Sphere":
        away = np.array([np.linalg.norm(np.ptp(corners, axis=0)), 0.0, 0.0])
        ray = mi.Ray3f(mi.Point3f(*(middle + away).tolist()), mi.Vector3f(-1.0, 0.0, 0.0))
        with dr.suspend_grad():
            return bool(np.array(shape.ray_intersect(ray).n).reshape(3)[0] < 0.0)
    params = mi.traverse(shape)
    if not isinstance(shape, mi.Mesh) or "vertex_normals" not in params or not is_closed(shape):
        return False
    a, b, c = np.array(params["vertex_positions"], dtype=np.float64).reshape(-1, 3)[_faces(params)].transpose(1, 0, 2)
    wound = np.sum(np.cross(a - middle, b - middle) * (c - middle), axis=1)  # six times the volume, by triangle
    with dr.suspend_grad():
        places = np.random.default_rng(0).random((2, SURFACE), dtype=np.float32)
        found = shape.sample_position(0.0, mi.Point2f(places))
        turned = np.sum((np.array(found.p) - middle[:, None]) * np.array(found.n), axis=0)  # so by Gauss's theorem
    return any(float(np.sum(one)) < -INWARDS * float(np.sum(np.abs(one))) for one in (wound, turned))


def is_sharp_edged(shape: Any) -> bool:
    """Whether most triangles meet others whose shading differs much, as the sides of a cube do.

    Where such an edge is in view, brightness jumps across it, and it has a gradient of its own. Projective sampling
    finds it only where its vertices are stored twice.
    """
    params = mi.traverse(shape)
    faces, place = _faces(params), _places(params)
    corners = _corner_normals(shape)
    at = place[faces]
    first = np.zeros((len(place), 3))
    first[at] = corners  # of each place, that of one of its corners
    hard = np.zeros(len(place), dtype=bool)
    hard[at[np.linalg.norm(corners - first[at], axis=-1) > HARD]] = True
    return float(np.mean(np.any(hard[at], axis=1))) > HARD


def has_smoothed_edges(shape: Any) -> bool:
    """Whether much of a mesh is shaded as if its sharp edges were round, as a box of eight vertices without normals."""
    if not has_triangles(shape):
        return False
    params = mi.traverse(shape)
    faces = _faces(params)
    a, b, c = np.array(params["vertex_positions"], dtype=np.float64).reshape(-1, 3)[faces].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    pairs, _ = _meetings(shape)
    # A card with normals of its own is shaded otherwise than it lies, and has no sharp edge.
    sharp = np.isin(np.arange(len(faces)), _bent(params, faces, pairs, ROUND) // 3)
    rounded = np.any(_apart(_corner_normals(shape), _flat_normals(params, faces)) > ROUND, axis=1)
    return float(area @ (sharp & rounded)) > ROUNDED * float(np.sum(area))


def _corner_normals(shape: Any) -> HostArray:
    """What the corners of each triangle of a mesh are shaded by: unit normals, shape (m, 3, 3)."""
    params = mi.traverse(shape)
    faces = _faces(params)
    normals = np.array(params["vertex_normals"], dtype=np.float64).reshape(-1, 3)
    if len(normals) and not shape.has_face_normals():
        return np.asarray(normals[faces])
    return _flat_normals(params, faces)


def is_flat_shaded(shape: Any) -> bool:
    """Whether a mesh is shaded as its triangles lie, as a cube is."""
    params = mi.traverse(shape)
    return bool(np.all(_apart(_corner_normals(shape), _flat_normals(params, _faces(params))) < CREASE))


def _flat_normals(params: Any, faces: HostArray) -> HostArray:
    """The normals of triangles, at each of their corners: shape (m, 3, 3)."""
    a, b, c = np.array(params["vertex_positions"], dtype=np.float64).reshape(-1, 3)[faces].transpose(1, 0, 2)
    flat = np.cross(b - a, c - a)
    return np.repeat((flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30))[:, None], 3, axis=1)


def weld_vertices(shape: Any) -> None:
    """Have triangles share the first of the vertices at a place; the others stay, and belong to none.

    Only where all vertices of the shape are moved together, since those that belong to no triangle have no gradient.
    What is flat stays so: without normals at its vertices, it is shaded by those of its triangles.
    """
    params = mi.traverse(shape)
    if "vertex_normals" in params and is_flat_shaded(shape):
        params["vertex_normals"] = dr.zeros(mi.Float, 0)
    params["faces"] = mi.UInt32(_places(params)[_faces(params)].astype(np.uint32).ravel())
    params.update()


def _faces(params: Any) -> HostArray:
    """The vertices of each triangle, shape (m, 3)."""
    return np.array(params["faces"], dtype=np.int64).reshape(-1, 3)


def _places(params: Any) -> HostArray:
    """For each vertex, the first one at the same place."""
    positions = np.array(params["vertex_positions"], dtype=np.float32).reshape(-1, 3)
    rows = np.ascontiguousarray(positions + 0.0).view([("", np.float32)] * 3)  # + 0.0 makes -0.0 equal to 0.0
    _, first, which = np.unique(rows, return_index=True, return_inverse=True)
    return np.asarray(first[which.reshape(-1)])


def _borders(faces: HostArray) -> int:
    """Number of edges that belong to one triangle only."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    counts = np.unique(edges[:, 0] * (faces.max(initial=0) + 1) + edges[:, 1], return_counts=True)[1]
    return int(np.count_nonzero(counts == 1))

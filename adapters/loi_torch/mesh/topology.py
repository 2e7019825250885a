"""Edges of triangle meshes: which triangles meet there, and where colours may jump."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loi_torch.mesh.projected import FloatArray, IndexArray, Topology

__all__ = ["join", "joined_corners", "topology_of"]


def joined_corners(vertices: FloatArray) -> IndexArray:
    """For each vertex the number of its place, shape (n,): vertices of equal coordinates share one."""
    if not len(vertices):
        return np.zeros(0, np.int32)
    order = np.lexsort(vertices.T)
    new = np.any(np.diff(vertices[order], axis=0) != 0.0, axis=1)
    places = np.empty(len(vertices), np.int32)
    places[order] = np.append(0, np.cumsum(new))
    return places


def topology_of(faces: IndexArray, places: IndexArray, *, creased: bool, seams: bool) -> Topology:
    """The topology of one mesh.

    Parameters
    ----------
    faces : array of int, shape (m, 3)
    places : array of int, shape (n,)
        Of the vertices, as :func:`joined_corners` gives them.
    creased : bool
        Whether colours or normals are the triangles' own, and so jump at every edge.
    seams : bool
        Whether vertices have colours or texture coordinates, which jump between vertices in one place.
    """
    joined = places[faces].astype(np.int32)
    corners = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    ends = np.stack([joined, np.roll(joined, -1, axis=1)], axis=-1).reshape(-1, 2)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned] = ends[turned, ::-1]
    corners = corners.copy()
    corners[turned] = corners[turned, ::-1]
    triangle = np.repeat(np.arange(len(faces), dtype=np.int32), 3)
    real = ends[:, 0] != ends[:, 1]
    ends, corners, triangle, turned = ends[real], corners[real], triangle[real], turned[real]
    key = ends[:, 0].astype(np.int64) * (int(places.max(initial=0)) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    key, ends, corners, triangle, turned = key[order], ends[order], corners[order], triangle[order], turned[order]
    first = np.flatnonzero(np.append(True, key[1:] != key[:-1])) if len(key) else np.zeros(0, np.int64)
    count = np.diff(np.append(first, len(key)))
    second = np.minimum(first + 1, max(len(key) - 1, 0))
    pair = count >= 2
    other = np.where(pair, triangle[second], -1)
    between = np.stack([triangle[first], other], axis=1).astype(np.int32).reshape(-1, 2)
    linked = between[pair]
    seam = pair & np.any(corners[first] != corners[second], axis=1) & seams
    always = (count != 2) | seam | creased
    smooth = between[pair & ~always]
    piece = _components(len(faces), linked[:, 0], linked[:, 1])
    return Topology(
        faces=np.ascontiguousarray(faces, dtype=np.int32),
        joined=joined,
        piece=piece,
        sheet=_components(len(faces), smooth[:, 0], smooth[:, 1]),
        ends=corners[first].astype(np.int32).reshape(-1, 2),
        joined_ends=ends[first].astype(np.int32).reshape(-1, 2),
        between=between,
        always=always,
        several=bool(piece.any()),
        twisted=int(np.sum((count == 2) & (turned[first] == turned[second]))),
    )


def join(parts: Sequence[Topology], counts: Sequence[int]) -> Topology:
    """Several meshes as one list of triangles; `counts` are their numbers of vertices."""
    if len(parts) == 1:
        return parts[0]
    corner = np.append(0, np.cumsum(counts)).astype(np.int32)
    face = np.append(0, np.cumsum([len(one.faces) for one in parts])).astype(np.int32)

    def put(name: str, shift: IndexArray) -> IndexArray:
        rows = [getattr(one, name) + np.int32(by) for one, by in zip(parts, shift, strict=False)]
        return np.concatenate(rows) if rows else np.zeros((0, 3), np.int32)

    used = int(sum(one.piece.max(initial=-1) + 1 for one in parts))
    between = [np.where(one.between < 0, -1, one.between + by) for one, by in zip(parts, face, strict=False)]
    return Topology(
        faces=put("faces", corner),
        joined=put("joined", corner),
        piece=_numbered([one.piece for one in parts]),
        sheet=_numbered([one.sheet for one in parts]),
        ends=put("ends", corner) if parts else np.zeros((0, 2), np.int32),
        joined_ends=put("joined_ends", corner) if parts else np.zeros((0, 2), np.int32),
        between=np.concatenate(between).astype(np.int32) if parts else np.zeros((0, 2), np.int32),
        always=np.concatenate([one.always for one in parts]) if parts else np.zeros(0, np.bool_),
        several=used > 1,
        twisted=sum(one.twisted for one in parts),
    )


def _numbered(parts: Sequence[IndexArray]) -> IndexArray:
    """Numbers of several meshes, each from 0, as numbers of all of them."""
    found, used = [np.zeros(0, np.int32)], 0
    for one in parts:
        found.append(one + np.int32(used))
        used += int(one.max(initial=-1)) + 1
    return np.concatenate(found)


def _components(count: int, one: IndexArray, other: IndexArray) -> IndexArray:
    """The number of the connected part that each of `count` things is of, from 0; pairs of them are connected."""
    least = np.arange(count)
    while True:
        before = least
        lowest = np.minimum(before[one], before[other])
        least = before.copy()
        np.minimum.at(least, one, lowest)
        np.minimum.at(least, other, lowest)
        least = least[least]
        if np.array_equal(least, before):
            return np.unique(least, return_inverse=True)[1].reshape(-1).astype(np.int32)

"""The connectivity of meshes, kept between gradients as long as no triangle changes.

Mitsuba stores the vertices along texture seams and creases once for each incident smoothing group. Vertices at equal
positions therefore count as one here, and are called welded. Half-edge ``3 * t + k`` of triangle ``t`` leads from its
corner ``k`` to the next.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from functools import cached_property
from typing import Any, Final

import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import HostArray

__all__ = ["Topology", "half_edge_ends", "topology_of"]

MAX_TRIANGLES: Final = 2**22  # of all meshes that are kept: about 400 MB
HASH_FACTORS: Final = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)
HASH_SHIFT: Final = np.uint64(29)  # mixes the high bits of a product, which depend on all bits, into the low ones

_kept: OrderedDict[bytes, Topology] = OrderedDict()  # the latest last; arrays only, so that no scene is kept alive
_lock = threading.Lock()


class Topology:
    """The connectivity of triangles.

    Parameters
    ----------
    faces : array, shape (m, 3)
        The vertex indices of each triangle.
    welded : array, shape (m, 3)
        The same, with equal indices for vertices at equal positions.
    """

    def __init__(self, faces: HostArray, welded: HostArray) -> None:
        self.faces, self.welded = faces, welded

    @cached_property
    def paired(self) -> HostArray:
        """The half-edges that belong together, shape (n, 2)."""
        return self._half_edges[0]

    @cached_property
    def unpaired(self) -> HostArray:
        """The half-edges without a single partner, shape (k,).

        They are border edges, and all half-edges of non-manifold edges, where more than two triangles meet.
        """
        return self._half_edges[1]

    @cached_property
    def _half_edges(self) -> tuple[HostArray, HostArray]:
        _, edge, counts = np.unique(_edge_keys(self.welded), return_inverse=True, return_counts=True)
        order = np.argsort(edge.reshape(-1), kind="stable")
        is_pair = counts[edge.reshape(-1)[order]] == 2
        return order[is_pair].reshape(-1, 2), order[~is_pair]

    @cached_property
    def split(self) -> HostArray:
        """The pairs of half-edges, shape (n, 2), that belong together but have vertices of their own."""
        ends = half_edge_ends(self.faces)
        first, second = self.paired.T
        return np.asarray(self.paired[np.any(ends[first] != ends[second][:, ::-1], axis=1)])

    @cached_property
    def border_edges(self) -> int:
        """The number of edges that belong to one triangle only."""
        return _border_edge_count(self.welded)

    @cached_property
    def is_unwelded(self) -> bool:
        """Whether edges are borders only because their vertices are stored more than once."""
        return self.border_edges < _border_edge_count(self.faces)

    @cached_property
    def components(self) -> HostArray:
        """The index, from 0, of the connected component of each triangle, shape (m,).

        Edges connect triangles where exactly two meet.
        """
        first, second = self.paired.T // 3
        label = np.arange(len(self.faces))
        while True:
            minimum = np.minimum(label[first], label[second])
            merged = label.copy()
            for triangle in (first, second):
                np.minimum.at(merged, label[triangle], minimum)  # the triangle that gave the component its label
                np.minimum.at(merged, triangle, minimum)
            merged = merged[merged]
            if np.array_equal(merged, label):
                return np.unique(label, return_inverse=True)[1].reshape(-1)
            label = merged


def topology_of(shape: Any) -> Topology:
    """Return the connectivity of a mesh now.

    It is computed once for all meshes of these triangles, wherever their vertices are, unless other vertices coincide.
    """
    params = mi.traverse(shape)
    faces = np.array(params["faces"], dtype=np.int64).reshape(-1, 3)
    representative = _representatives(np.array(params["vertex_positions"], dtype=np.float32).reshape(-1, 3))
    key = hashlib.blake2b(faces.tobytes() + representative.tobytes(), digest_size=16).digest()
    with _lock:
        topology = _kept.pop(key, None) or Topology(faces, representative[faces])
        _kept[key] = topology
        while len(_kept) > 1 and sum(len(kept.faces) for kept in _kept.values()) > MAX_TRIANGLES:
            _kept.popitem(last=False)
    return topology


def _representatives(positions: HostArray) -> HostArray:
    """Return for each vertex the first vertex at its position, shape (n,)."""
    bits = np.ascontiguousarray(positions + 0.0).view(np.uint32).astype(np.uint64)  # + 0.0 makes -0.0 equal to 0.0
    product = bits * HASH_FACTORS
    mixed = (product ^ (product >> HASH_SHIFT)) * HASH_FACTORS
    # Much faster than rows of three columns; two positions collide with odds of 2**-64.
    _, first, inverse = np.unique(mixed.sum(axis=1, dtype=np.uint64), return_index=True, return_inverse=True)
    return np.asarray(first[inverse.reshape(-1)])


def half_edge_ends(faces: HostArray) -> HostArray:
    """Return the two vertices of each half-edge of triangles of shape (m, 3): shape (3 m, 2)."""
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)


def _edge_keys(faces: HostArray) -> HostArray:
    """Return a number for each half-edge, shape (3 m,), that half-edges between the same vertices share."""
    ends = half_edge_ends(faces)
    return np.asarray(ends.min(axis=1) * (faces.max(initial=0) + 1) + ends.max(axis=1))


def _border_edge_count(faces: HostArray) -> int:
    counts = np.unique(_edge_keys(faces), return_counts=True)[1]
    return int(np.count_nonzero(counts == 1))

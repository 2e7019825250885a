"""The connectivity of a mesh is computed once, and again only when its triangles or coincident vertices change."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mitsuba_boundaries.geometry import topology
from mitsuba_boundaries.geometry.topology import topology_of


def mesh_of(positions: Any, faces: Any) -> Any:
    mesh = mi.Mesh("mesh", len(positions), len(faces))
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(np.asarray(positions, np.float32).ravel())
    params["faces"] = mi.UInt32(np.asarray(faces, np.uint32).ravel())
    params.update()
    return mesh


def split_pair() -> Any:
    """Two triangles that meet at an edge whose two vertices are each stored twice."""
    return mesh_of([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [3, 5, 4]])


def move(mesh: Any, positions: Any) -> None:
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(np.asarray(positions, np.float32).ravel())
    params.update()


def positions_of(mesh: Any) -> Any:
    return np.array(mi.traverse(mesh)["vertex_positions"]).reshape(-1, 3)


def test_moving_vertices_keep_the_connectivity_and_an_opened_seam_does_not() -> None:
    mesh = split_pair()
    start, kept = positions_of(mesh), topology_of(mesh)
    assert (len(kept.paired), len(kept.split), kept.is_unwelded) == (1, 1, True)
    move(mesh, start @ np.diag([2.0, -3.0, 1.0]) + [0.1, 0.2, 0.3])
    assert topology_of(mesh) is kept
    opened = start.copy()
    opened[3] += 1e-3
    move(mesh, opened)
    assert len(topology_of(mesh).paired) == 0
    move(mesh, start)
    assert topology_of(mesh) is kept
    assert topology_of(split_pair()) is kept


def test_kept_meshes_are_bounded_by_their_triangles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topology, "_kept", type(topology._kept)())
    monkeypatch.setattr(topology, "MAX_TRIANGLES", 3)
    first, corner = split_pair(), mesh_of([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    kept = topology_of(first)
    topology_of(corner)
    assert topology_of(first) is kept
    topology_of(mesh_of([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 2, 0]]))
    assert topology_of(first) is kept
    assert len(topology._kept) == 2
    topology_of(mesh_of(np.eye(4, 3), [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]))  # larger than all that may be kept
    assert len(topology._kept) == 1
    assert topology_of(first) is not kept


@given(st.lists(st.sampled_from([-1.0, -0.0, 0.0, 1e-30, 1.0, 1.0 + 2.0**-23]), min_size=3, max_size=60))
def test_vertices_are_welded_if_and_only_if_their_positions_are_equal(coordinates: list[float]) -> None:
    positions = np.array(coordinates[: len(coordinates) // 3 * 3], np.float32).reshape(-1, 3)
    representative = topology._representatives(positions)
    expected = [next(k for k in range(len(positions)) if np.all(positions[k] == row)) for row in positions]
    np.testing.assert_array_equal(representative, expected)

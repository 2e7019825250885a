"""Meshes whose parts overlap have the gradient of the body that they make: each edge counts once, and each crease."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from loi_mitsuba import PlannedRenderer, Translate
from loi_mitsuba.geometry.coincident_edges import uncovered_segments
from loi_mitsuba.geometry.components import ComponentIds
from loi_mitsuba.geometry.mesh import connected_components
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene

MOVES: dict[str, Any] = {axis: Translate("block", way) for axis, way in zip("xyz", np.eye(3).tolist(), strict=True)}
DRAWS = 8
SEEN = ((16, 20), (24, 20), (24, 28), (32, 20))  # an outline, edges that both bars have, the crease, and in a shadow
PLACE = mi.ScalarTransform4f
# Of a bar that lies and a bar that stands, both of which begin at one corner; and of the L that they make.
BARS = (((0.0, 0.0), (1.2, 0.3)), ((0.0, 0.0), (0.3, 1.2)))
OUTLINE = ((0.0, 0.0), (1.2, 0.0), (1.2, 0.3), (0.3, 0.3), (0.3, 1.2), (0.0, 1.2))


LIGHTS: dict[str, dict[str, Any]] = {
    "lamp": {
        "type": "sphere",
        "to_world": PLACE().translate([-2, 9, 5]).scale(0.7),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 60.0}},
    },
    "sky": {"type": "constant"},
}


def two_bars() -> trimesh.Trimesh:
    """With two sides in one plane each, and along one line edges that are longer and shorter."""
    made = []
    for low, high in BARS:
        bar = trimesh.creation.box([high[0] - low[0], high[1] - low[1], 0.4])
        bar.apply_translation([(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0, 0.0])
        made.append(bar)
    return joined(*made)


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """One mesh of several."""
    first = np.cumsum([0, *(len(one.vertices) for one in meshes)])
    faces = [np.array(one.faces) + start for one, start in zip(meshes, first, strict=False)]
    return trimesh.Trimesh(np.concatenate([one.vertices for one in meshes]), np.concatenate(faces), process=False)


def one_body() -> trimesh.Trimesh:
    """The same in one piece: no face in it, and no edge twice."""
    count = len(OUTLINE)
    corners = np.array([[x, y, z] for z in (-0.2, 0.2) for x, y in OUTLINE])
    front = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]) + count
    sides = [[k, (k + 1) % count, (k + 1) % count + count] for k in range(count)]
    sides += [[k, (k + 1) % count + count, k + count] for k in range(count)]
    return trimesh.Trimesh(corners, np.concatenate([front, front[:, ::-1] - count, sides]), process=False)


def renderer_of(mesh: trimesh.Trimesh, folder: Path, light: str) -> Any:
    """Hovering over a floor, so that edges in view and those of the shadow are all to be seen."""
    folder.mkdir()
    mesh.export(folder / "block.ply")
    place = PLACE().translate([-0.8, 0.7, 1.2]).rotate([0.2, -1, 0], 35).scale(2)
    block = {"type": "ply", "filename": str(folder / "block.ply"), "face_normals": True, "to_world": place}
    scene = shadow_scene(integrator={"type": "path", "max_depth": 2}, block=block, lamp=LIGHTS[light])
    del scene["ball"]
    return PlannedRenderer(scene, MOVES, spp=128, blur=None).unabridged


def gradients(renderer: Any, weights: list[Host]) -> Host:
    """By draw, weight and parameter."""
    at = renderer.parameters()
    drawn = [[list(renderer.vjp(at, one, seed=seed).values()) for one in weights] for seed in range(DRAWS)]
    return np.array(drawn, dtype=np.float64)


@pytest.mark.parametrize("light", LIGHTS)
def test_parts_that_overlap_have_the_gradient_of_one_body(light: str, tmp_path: Path) -> None:
    """Edges along which both have one counted twice, or four times, and the crease between them not at all.

    An edge of one bar in a side of the other threw a shadow on it, of light that comes from everywhere.
    """
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    bumps = [np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / 50.0)[..., None] for row, column in SEEN]
    weights = [np.asarray(bump * np.array([0.1, 0.07, -0.04]), dtype=np.float32) for bump in bumps]
    found, wanted = (
        gradients(renderer_of(mesh, tmp_path / name, light), weights)
        for name, mesh in (("bars", two_bars()), ("body", one_body()))
    )
    unsure = np.sqrt((np.var(found, axis=0, ddof=1) + np.var(wanted, axis=0, ddof=1)) / DRAWS)
    size = np.linalg.norm(np.mean(wanted, axis=0), axis=1, keepdims=True)
    assert np.all(unsure < 0.09 * size)
    np.testing.assert_array_less(np.abs(np.mean(found - wanted, axis=0)), 0.03 * size + 4.0 * unsure)


@given(
    spans=st.lists(st.tuples(st.integers(0, 2), st.integers(0, 12), st.integers(1, 6)), min_size=1, max_size=12),
    turned=st.integers(0, 2**32 - 1),
)
def test_every_point_of_a_line_is_of_one_edge(spans: list[tuple[int, int, int]], turned: int) -> None:
    """However edges along it overlap, whichever way they go, and wherever the mesh stands."""
    rng = np.random.default_rng(turned)
    line, begin, size = np.array(spans).T
    flip = rng.random(len(spans)) < 0.5
    first, second = np.where(flip, begin + size, begin), np.where(flip, begin, begin + size)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = np.stack([np.concatenate([first, second]), *np.tile([line, line**2], 2)], axis=1) @ turn + rng.normal(
        size=3
    )
    positions = points.astype(np.float32)
    ends = np.stack([np.arange(len(spans)), np.arange(len(spans)) + len(spans)], axis=1)
    which, between = uncovered_segments(positions, ends)
    at = first[which, None] + (second - first)[which, None] * between
    for number in set(line.tolist()):
        own = np.sort(np.sort(at[line[which] == number], axis=1), axis=0)
        covered = {cell for one in np.flatnonzero(line == number) for cell in range(begin[one], begin[one] + size[one])}
        assert np.all(own[1:, 0] >= own[:-1, 1] - 1e-4)
        assert np.sum(own[:, 1] - own[:, 0]) == pytest.approx(len(covered), abs=1e-3)


def test_edges_apart_are_whole() -> None:
    ball = trimesh.creation.icosphere(3)
    which, between = uncovered_segments(np.array(ball.vertices), np.array(ball.edges_unique))
    assert which.tolist() == list(range(len(ball.edges_unique)))
    assert np.all(between == [0.0, 1.0])


def test_a_mesh_is_of_as_many_parts_as_hang_together(tmp_path: Path) -> None:
    """However its triangles are ordered, and not by a corner or an edge that several parts have."""
    meshes = {"bars": (two_bars(), [12, 12]), "body": (one_body(), [20])}
    apart = [trimesh.creation.icosphere(2), trimesh.creation.torus(3.0, 0.5), trimesh.creation.box([9.0, 0.1, 0.1])]
    meshes["many"] = joined(*apart), sorted(len(one.faces) for one in apart)
    for name, (mesh, counts) in meshes.items():
        faces = np.random.default_rng(0).permutation(np.array(mesh.faces))
        trimesh.Trimesh(mesh.vertices, faces, process=False).export(tmp_path / f"{name}.ply")
        shape = mi.load_dict({"type": "ply", "filename": str(tmp_path / f"{name}.ply")})
        assert sorted(np.bincount(connected_components(shape)).tolist()) == counts


def test_what_a_ray_hits_is_told_by_part(tmp_path: Path) -> None:
    """Of each triangle of two meshes in one scene, seen from close in front of it."""
    two_bars().export(tmp_path / "bars.ply")
    bars = [
        {"type": "ply", "filename": str(tmp_path / "bars.ply"), "to_world": PLACE().translate([0, 0, depth])}
        for depth in (0.0, 5.0)
    ]
    scene = mi.load_dict({"type": "scene", "one": bars[0], "other": bars[1]})
    shapes = scene.shapes()
    parts = ComponentIds(shapes, shapes)
    told, hits = set(), 0
    for place, shape in enumerate(shapes):
        params = mi.traverse(shape)
        corners = np.array(params["vertex_positions"]).reshape(-1, 3)[np.array(params["faces"]).reshape(-1, 3)]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        start = [0.3, 0.3, 0.4] @ corners + 1e-4 * normals
        ray = mi.Ray3f(*(of(np.ascontiguousarray(one.T)) for of, one in ((mi.Point3f, start), (mi.Vector3f, -normals))))
        hit = scene.ray_intersect_preliminary(ray)
        triangles = np.array(hit.prim_index)
        hits += len(set(triangles.tolist()))  # not all: of two in one plane it is one
        numbers = np.array(parts.of(hit))
        told |= {
            (place, part, number)
            for part, number in np.stack([connected_components(shape)[triangles], numbers]).T.tolist()
        }
    assert hits > 40
    assert len(told) == 4
    assert len({number for _, _, number in told}) == 4


def test_only_parts_whose_boxes_touch_are_told_apart() -> None:
    ball = trimesh.creation.icosphere(1)
    ball.apply_translation([5, 0, 0])
    far = joined(trimesh.creation.box([1, 1, 1]), ball)
    for mesh, meet in ((two_bars(), True), (one_body(), False), (far, False)):
        shape = mi.Mesh("it", len(mesh.vertices), len(mesh.faces))
        params = mi.traverse(shape)
        params["vertex_positions"] = mi.Float(np.array(mesh.vertices, dtype=np.float32).ravel())
        params["faces"] = mi.UInt32(np.array(mesh.faces, dtype=np.uint32).ravel())
        params.update()
        assert ComponentIds([shape], [shape]).meet == meet

"""Meshes with overlapping components have the gradient of their union: each edge and each crease counts once."""

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
from mitsuba_boundaries.geometry.coincident_edges import uncovered_segments
from mitsuba_boundaries.geometry.components import ComponentIds
from mitsuba_boundaries.geometry.topology import topology_of
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.strategies import thorough

MOVES: dict[str, Any] = {name: Translate("block", axis) for name, axis in zip("xyz", np.eye(3).tolist(), strict=True)}
SEEDS = 8
INNER_PROBES_PX = ((24, 20), (24, 28))  # row and column: shared edges, and the crease between the bars
OUTER_PROBES_PX = ((16, 20), (32, 20))  # silhouette and shadow, whose edges the bars share in part
TRANSFORM = mi.ScalarTransform4f
# Two opposite corners of a horizontal and a vertical bar that share a corner, and the outline of the L that they form.
BARS = (((0.0, 0.0), (1.2, 0.3)), ((0.0, 0.0), (0.3, 1.2)))
OUTLINE = ((0.0, 0.0), (1.2, 0.0), (1.2, 0.3), (0.3, 0.3), (0.3, 1.2), (0.0, 1.2))


LIGHTS: dict[str, dict[str, Any]] = {
    "lamp": {
        "type": "sphere",
        "to_world": TRANSFORM().translate([-2, 9, 5]).scale(0.7),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 60.0}},
    },
    "sky": {"type": "constant"},
}


def two_bars() -> trimesh.Trimesh:
    """Two boxes with two pairs of coplanar faces, and coincident edges of unequal lengths."""
    bars = []
    for lower, upper in BARS:
        bar = trimesh.creation.box([upper[0] - lower[0], upper[1] - lower[1], 0.4])
        bar.apply_translation([(lower[0] + upper[0]) / 2.0, (lower[1] + upper[1]) / 2.0, 0.0])
        bars.append(bar)
    return concatenate(*bars)


def concatenate(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """Concatenate meshes without welding."""
    first_vertex = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [np.array(mesh.faces) + first for mesh, first in zip(meshes, first_vertex, strict=False)]
    return trimesh.Trimesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), process=False)


def l_shape() -> trimesh.Trimesh:
    """The union of the bars: without internal faces and coincident edges."""
    count = len(OUTLINE)
    corners = np.array([[x, y, z] for z in (-0.2, 0.2) for x, y in OUTLINE])
    front = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]) + count
    side_faces = [[k, (k + 1) % count, (k + 1) % count + count] for k in range(count)]
    side_faces += [[k, (k + 1) % count + count, k + count] for k in range(count)]
    return trimesh.Trimesh(corners, np.concatenate([front, front[:, ::-1] - count, side_faces]), process=False)


def renderer_of(mesh: trimesh.Trimesh, folder: Path, light: str) -> Any:
    """Render the mesh above a floor, so that its edges and their shadows are in view."""
    folder.mkdir()
    mesh.export(folder / "block.ply")
    pose = TRANSFORM().translate([-0.8, 0.7, 1.2]).rotate([0.2, -1, 0], 35).scale(2)
    block = {"type": "ply", "filename": str(folder / "block.ply"), "face_normals": True, "to_world": pose}
    scene = shadow_scene(integrator={"type": "path", "max_depth": 2}, block=block, lamp=LIGHTS[light])
    del scene["ball"]
    return PlannedRenderer(scene, MOVES, spp=128, blur=None).unabridged


def gradients(renderer: Any, weights: list[Host]) -> Host:
    """Return gradients by seed, cotangent and parameter."""
    start = renderer.parameters()
    draws = [[list(renderer.vjp(start, weight, seed=seed).values()) for weight in weights] for seed in range(SEEDS)]
    return np.array(draws, dtype=np.float64)


@pytest.mark.parametrize("light", ["lamp", pytest.param("sky", marks=thorough)])
@pytest.mark.parametrize(
    "probes_px", [INNER_PROBES_PX, pytest.param(OUTER_PROBES_PX, marks=thorough)], ids=["inner edges", "outer edges"]
)
def test_overlapping_components_have_the_gradient_of_their_union(
    light: str, probes_px: tuple[tuple[int, int], ...], tmp_path: Path
) -> None:
    """Shared edges used to count twice, or four times, and the crease between the bars not at all.

    In light from everywhere, an edge of one bar in a face of the other used to cast a shadow on it.
    """
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    bumps = [np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / 50.0)[..., None] for row, column in probes_px]
    weights = [np.asarray(bump * np.array([0.1, 0.07, -0.04]), dtype=np.float32) for bump in bumps]
    actual, expected = (
        gradients(renderer_of(mesh, tmp_path / name, light), weights)
        for name, mesh in (("bars", two_bars()), ("union", l_shape()))
    )
    error = np.sqrt((np.var(actual, axis=0, ddof=1) + np.var(expected, axis=0, ddof=1)) / SEEDS)
    size = np.linalg.norm(np.mean(expected, axis=0), axis=1, keepdims=True)
    assert np.all(error < 0.09 * size)
    np.testing.assert_array_less(np.abs(np.mean(actual - expected, axis=0)), 0.03 * size + 4.0 * error)


@given(
    spans=st.lists(st.tuples(st.integers(0, 2), st.integers(0, 12), st.integers(1, 6)), min_size=1, max_size=12),
    seed=st.integers(0, 2**32 - 1),
)
def test_every_point_of_a_line_belongs_to_exactly_one_segment(spans: list[tuple[int, int, int]], seed: int) -> None:
    """For all overlaps, directions of the edges, and poses of the mesh."""
    rng = np.random.default_rng(seed)
    line, begin, size = np.array(spans).T
    is_flipped = rng.random(len(spans)) < 0.5
    first, second = np.where(is_flipped, begin + size, begin), np.where(is_flipped, begin, begin + size)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = np.stack([np.concatenate([first, second]), *np.tile([line, line**2], 2)], axis=1)
    positions = (points @ rotation + rng.normal(size=3)).astype(np.float32)
    edges = np.stack([np.arange(len(spans)), np.arange(len(spans)) + len(spans)], axis=1)
    index, interval = uncovered_segments(positions, edges)
    segments = first[index, None] + (second - first)[index, None] * interval
    for number in set(line.tolist()):
        on_line = np.sort(np.sort(segments[line[index] == number], axis=1), axis=0)
        spans_of_line = np.flatnonzero(line == number)
        covered = {cell for span in spans_of_line for cell in range(begin[span], begin[span] + size[span])}
        assert np.all(on_line[1:, 0] >= on_line[:-1, 1] - 1e-4)
        assert np.sum(on_line[:, 1] - on_line[:, 0]) == pytest.approx(len(covered), abs=1e-3)


def test_edges_that_do_not_overlap_stay_whole() -> None:
    ball = trimesh.creation.icosphere(3)
    index, interval = uncovered_segments(np.array(ball.vertices), np.array(ball.edges_unique))
    assert index.tolist() == list(range(len(ball.edges_unique)))
    assert np.all(interval == [0.0, 1.0])


def test_connected_components_do_not_depend_on_the_order_of_triangles(tmp_path: Path) -> None:
    """A vertex or edge that several components share does not connect them."""
    meshes = {"bars": (two_bars(), [12, 12]), "union": (l_shape(), [20])}
    separate = [trimesh.creation.icosphere(2), trimesh.creation.torus(3.0, 0.5), trimesh.creation.box([9.0, 0.1, 0.1])]
    meshes["many"] = concatenate(*separate), sorted(len(mesh.faces) for mesh in separate)
    for name, (mesh, counts) in meshes.items():
        faces = np.random.default_rng(0).permutation(np.array(mesh.faces))
        trimesh.Trimesh(mesh.vertices, faces, process=False).export(tmp_path / f"{name}.ply")
        shape = mi.load_dict({"type": "ply", "filename": str(tmp_path / f"{name}.ply")})
        assert sorted(np.bincount(topology_of(shape).components).tolist()) == counts


def test_rays_that_hit_different_components_get_different_ids(tmp_path: Path) -> None:
    """With rays from close in front of each triangle of two meshes in one scene."""
    two_bars().export(tmp_path / "bars.ply")
    bars = [
        {"type": "ply", "filename": str(tmp_path / "bars.ply"), "to_world": TRANSFORM().translate([0, 0, depth])}
        for depth in (0.0, 5.0)
    ]
    scene = mi.load_dict({"type": "scene", "one": bars[0], "other": bars[1]})
    shapes = scene.shapes()
    component_ids = ComponentIds(shapes, shapes)
    combinations, hit_count = set(), 0
    for index, shape in enumerate(shapes):
        params = mi.traverse(shape)
        corners = np.array(params["vertex_positions"]).reshape(-1, 3)[np.array(params["faces"]).reshape(-1, 3)]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        origins = [0.3, 0.3, 0.4] @ corners + 1e-4 * normals
        ray = mi.Ray3f(mi.Point3f(np.ascontiguousarray(origins.T)), mi.Vector3f(np.ascontiguousarray(-normals.T)))
        hit = scene.ray_intersect_preliminary(ray)
        triangles = np.array(hit.prim_index)
        hit_count += len(set(triangles.tolist()))  # not all triangles: some are coplanar
        ids = np.array(component_ids.ids(hit))
        components = topology_of(shape).components[triangles]
        combinations |= {(index, component, id_) for component, id_ in np.stack([components, ids]).T.tolist()}
    assert hit_count > 40
    assert len(combinations) == 4
    assert len({id_ for _, _, id_ in combinations}) == 4


def test_only_components_with_overlapping_bounds_may_intersect() -> None:
    ball = trimesh.creation.icosphere(1)
    ball.apply_translation([5, 0, 0])
    distant = concatenate(trimesh.creation.box([1, 1, 1]), ball)
    for mesh, may_intersect in ((two_bars(), True), (l_shape(), False), (distant, False)):
        shape = mi.Mesh("it", len(mesh.vertices), len(mesh.faces))
        params = mi.traverse(shape)
        params["vertex_positions"] = mi.Float(np.array(mesh.vertices, dtype=np.float32).ravel())
        params["faces"] = mi.UInt32(np.array(mesh.faces, dtype=np.uint32).ravel())
        params.update()
        assert ComponentIds([shape], [shape]).may_intersect == may_intersect

"""Meshes that store the vertices of an edge twice have the gradient that they would have if they did not."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import trimesh

from loi_core.errors import OptionError
from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, Rotate, Translate
from loi_mitsuba.diagnostics import is_non_manifold
from loi_mitsuba.geometry.mesh_checks import has_inward_normals, is_sharp_edged, is_unwelded, non_manifold_fraction
from tests.mitsuba.scenes import HEIGHT, WIDTH, box, random_cotangent, shadow_scene
from tests.strategies import thorough

RAMP = np.linspace(-1.0, 1.0, WIDTH, dtype=np.float32)[None, :, None] * np.ones((HEIGHT, WIDTH, 3), np.float32)
MOVES: dict[str, Any] = {"x": Translate("mesh", (1, 0, 0))}
TURNS: dict[str, Any] = MOVES | {"turn": Rotate("mesh", (0, 0, 1))}
PLACE = mi.ScalarTransform4f


def ball_file(folder: Path, *, split: bool, normals: bool = False) -> str:
    """A ball of triangles, every one of which has vertices of its own if it is split."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    corners, triangles = np.array(ball.vertices), np.array(ball.faces)
    if split:
        corners, triangles = corners[triangles.ravel()], np.arange(triangles.size).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners, triangles, vertex_normals=corners if normals else None, process=False)
    path = folder / f"{split}-{normals}.ply"
    mesh.export(path, vertex_normal=normals)
    return str(path)


def scene_of(mesh: dict[str, Any]) -> dict[str, Any]:
    """One that throws a shadow and is in view."""
    return shadow_scene(
        mesh={"to_world": PLACE().translate([0.3, 1.5, 0.2]).rotate([0.6, 0.0, 0.8], 30).scale(0.7), **mesh}
    )


def gradients(renderer: PlannedRenderer, draws: int = 1) -> Any:
    """By parameter, the gradient of each draw."""
    here = renderer.parameters()
    drawn = [renderer.unabridged.vjp(here, RAMP, seed=seed) for seed in range(draws)]
    return {name: np.array([float(one[name]) for one in drawn]) for name in here}


def test_a_smooth_mesh_with_seams_has_the_gradient_of_the_same_mesh_without(tmp_path: Path) -> None:
    meshes = ({"type": "ply", "filename": ball_file(tmp_path, split=split, normals=True)} for split in (True, False))
    split, whole = (PlannedRenderer(scene_of(mesh), TURNS, spp=16) for mesh in meshes)
    assert list(split.plan.exchanged) == ["mesh 'mesh'"]
    assert not whole.plan.exchanged
    found, wanted = gradients(split), gradients(whole)
    for name in TURNS:
        assert abs(wanted[name]) > 0.0
        np.testing.assert_allclose(found[name], wanted[name], rtol=1e-3)


@thorough
def test_a_flat_mesh_with_seams_has_the_gradient_of_the_same_mesh_without(tmp_path: Path) -> None:
    """But for noise, for the two number their edges otherwise, and draw others."""
    files = (ball_file(tmp_path, split=split) for split in (True, False))
    meshes = ({"type": "ply", "filename": file, "face_normals": True} for file in files)
    split, whole = (gradients(PlannedRenderer(scene_of(mesh), MOVES, spp=16), draws=24)["x"] for mesh in meshes)
    error = np.hypot(np.std(split, ddof=1), np.std(whole, ddof=1)) / np.sqrt(24.0)
    assert abs(np.mean(whole)) > 10.0 * error
    assert np.mean(split) == pytest.approx(np.mean(whole), abs=4.0 * error)


def test_images_are_those_of_the_mesh_as_it_is(tmp_path: Path) -> None:
    ball = {"type": "ply", "filename": ball_file(tmp_path, split=True)}
    with pytest.warns(GradientWarning, match=r"mesh 'mesh' stores the vertices .* PlannedRenderer does where"):
        alone = PlannedRenderer(scene_of(ball), MOVES, spp=8, proxy={"seams": False})
    assert not alone.plan.exchanged
    planned = PlannedRenderer(scene_of(ball), MOVES, spp=8)
    here = planned.parameters()
    np.testing.assert_allclose(planned.render(here, seed=3), alone.render(here, seed=3), rtol=1e-4, atol=1e-5)


def test_a_mesh_that_is_an_object_of_the_user_stays_as_it_is(tmp_path: Path) -> None:
    mesh = mi.load_dict({"type": "ply", "filename": ball_file(tmp_path, split=True)})
    faces = np.array(mi.traverse(mesh)["faces"])
    with pytest.warns(GradientWarning, match="stores the vertices of an edge more than once"):
        assert not PlannedRenderer(shadow_scene(mesh=mesh), MOVES).plan.exchanged
    np.testing.assert_array_equal(mi.traverse(mesh)["faces"], faces)


def test_a_mesh_whose_vertices_move_apart_stays_as_it_is() -> None:
    with pytest.warns(GradientWarning, match="mesh 'mesh' stores the vertices of an edge more than once"):
        planned = PlannedRenderer(scene_of({"type": "cube"}), {"corners": "mesh.vertex_positions"})
    assert not planned.plan.exchanged


def test_edges_are_hard_where_triangles_that_meet_are_shaded_otherwise(tmp_path: Path) -> None:
    def loaded(mesh: dict[str, Any]) -> Any:
        return mi.load_dict({"type": "scene", "mesh": mesh}, optimize=False).shapes()[0]

    cube = loaded({"type": "cube"})
    smooth = loaded({"type": "ply", "filename": ball_file(tmp_path, split=True, normals=True)})
    whole = loaded({"type": "ply", "filename": ball_file(tmp_path, split=False)})
    assert [is_unwelded(one) for one in (cube, smooth, whole, loaded({"type": "rectangle"}))] == [
        True,
        True,
        False,
        False,
    ]
    flat = loaded({"type": "ply", "filename": ball_file(tmp_path, split=True), "face_normals": True})
    assert [is_sharp_edged(one) for one in (cube, smooth, flat, box((0.0, 0.0, 0.0), 1.0))] == [
        True,
        False,
        False,
        True,
    ]
    assert not is_unwelded(loaded({"type": "sphere"}))


@pytest.mark.parametrize("film", [{}, {"sample_border": True}, {"rfilter": {"type": "box"}}])
def test_a_cube_of_a_dict_is_exchanged_whatever_film_it_is_seen_on(film: dict[str, Any]) -> None:
    """Where a filter reaches over the border, the scene is loaded anew, and its shapes are others."""
    scene = scene_of({"type": "cube"})
    scene["sensor"]["film"] = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, **film}
    assert list(PlannedRenderer(scene, MOVES, spp=4).plan.exchanged) == ["mesh 'mesh'"]


def crowded_file(folder: Path, kind: str) -> str:
    """A box: as it is, with strips for a top, with a wall across it, or with every side there twice, back to back."""
    corners: list[tuple[float, float, float]] = []
    faces: list[list[int]] = []

    def side(*four: tuple[float, float, float]) -> None:
        faces.extend(
            [[len(corners), len(corners) + 1, len(corners) + 2], [len(corners), len(corners) + 2, len(corners) + 3]]
        )
        corners.extend(four)

    around = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
    for (x, z), (u, w) in pairwise(around):
        side((x, -1.0, z), (u, -1.0, w), (u, 1.0, w), (x, 1.0, z))
    cuts = (-1.0, -0.2, 0.4, 1.0) if kind == "strips" else (-1.0, 1.0)
    for a, b in pairwise(cuts):
        side((a, 1.0, -1.0), (a, 1.0, 1.0), (b, 1.0, 1.0), (b, 1.0, -1.0))
        side((a, -1.0, 1.0), (a, -1.0, -1.0), (b, -1.0, -1.0), (b, -1.0, 1.0))
    if kind == "wall":
        side((-1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (1.0, 1.0, 1.0), (1.0, -1.0, 1.0))
    if kind == "twice":
        faces += [[a, c, b] for a, b, c in faces]
    path = folder / f"{kind}.ply"
    trimesh.Trimesh(corners, faces, process=False).export(path)
    return str(path)


@pytest.mark.parametrize(("kind", "crowded"), [("box", False), ("strips", True), ("wall", True), ("twice", True)])
def test_edges_that_mitsuba_counts_several_times_are_told_of_and_blurred(
    kind: str,
    crowded: bool,
    tmp_path: Path,
) -> None:
    mesh = {"type": "ply", "filename": crowded_file(tmp_path, kind), "face_normals": True}
    shape = mi.load_dict({"type": "scene", "mesh": mesh}, optimize=False).shapes()[0]
    assert is_non_manifold(shape) == crowded
    planned = PlannedRenderer(scene_of(mesh), MOVES, spp=4)
    assert list(planned.plan.blurred) == (["x"] if crowded else [])
    with pytest.warns(GradientWarning) as told:
        MitsubaRenderer(scene_of(mesh), MOVES, spp=4)
    assert any("more than two triangles meet" in str(one.message) for one in told) == crowded


def test_vertices_of_a_crowded_mesh_are_not_blurred_but_told_of(tmp_path: Path) -> None:
    mesh = {"type": "ply", "filename": crowded_file(tmp_path, "twice"), "face_normals": True}
    with pytest.warns(GradientWarning, match="more than two triangles meet"):
        planned = PlannedRenderer(scene_of(mesh), {"corners": "mesh.vertex_positions"}, spp=4)
    assert not planned.plan.blurred


def test_a_smooth_mesh_is_not_crowded(tmp_path: Path) -> None:
    for split in (True, False):
        mesh = {"type": "ply", "filename": ball_file(tmp_path, split=split)}
        assert non_manifold_fraction(mi.load_dict({"type": "scene", "mesh": mesh}, optimize=False).shapes()[0]) == 0.0


def test_a_cutout_is_blurred_and_told_of() -> None:
    opacity = np.zeros((8, 8, 1), np.float32)
    opacity[2:6, 2:6] = 1.0
    mask = {
        "type": "mask",
        "opacity": {"type": "bitmap", "data": mi.TensorXf(opacity), "raw": True},
        "within": {"type": "twosided", "within": {"type": "diffuse"}},
    }
    scene = scene_of({"type": "rectangle", "bsdf": mask})
    assert "cutouts" in PlannedRenderer(scene, MOVES, spp=4).plan.blurred["x"]
    with pytest.warns(GradientWarning, match="no gradient of cutouts"):
        MitsubaRenderer(scene, MOVES, spp=4)


def test_the_switch_is_true_or_false() -> None:
    with pytest.raises(OptionError, match=r"`proxy.seams` must be true or false, got 1"):
        PlannedRenderer(scene_of({"type": "cube"}), MOVES, proxy={"seams": 1})


def test_a_box_keeps_its_texture_though_its_corners_are_shared() -> None:
    """All but the gradient of its shadow is that of the scene itself: shared corners show other parts of a texture."""
    values = mi.TensorXf(np.random.default_rng(0).random((4, 4, 3)).astype(np.float32))
    paint = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": values, "raw": True}}
    pose = mi.ScalarTransform4f().translate([0, 1, 0]).scale(0.7)
    scene = shadow_scene(mesh={"type": "cube", "to_world": pose, "bsdf": paint})
    planned = PlannedRenderer(scene, MOVES, spp=8)
    assert list(planned.plan.exchanged) == ["mesh 'mesh'"]
    seen = {"type": "direct_projective", "guiding": "none", "sppc": 8, "sppp": 8, "sppi": 0}
    with pytest.warns(GradientWarning, match="mesh 'mesh' stores the vertices of an edge more than once"):
        alone = MitsubaRenderer(scene, MOVES, integrator=seen)
    both = planned.unabridged.with_integrator(seen)
    here, cotangent = planned.parameters(), random_cotangent()
    wanted, found = (one.vjp(here, cotangent, seed=1)["x"] for one in (alone, both))
    assert abs(wanted) > 0.0
    np.testing.assert_allclose(found, wanted, rtol=1e-4)
    shadow = both.with_integrator(seen | {"sppc": 0, "sppp": 0, "sppi": 8})
    assert abs(shadow.vjp(here, cotangent, seed=1)["x"]) > 0.0
    whole = both.with_integrator(seen | {"sppi": 8})
    ahead = {name: np.ones_like(value) for name, value in here.items()}
    along = np.vdot(whole.jvp(here, ahead, seed=2), cotangent)
    assert float(whole.vjp(here, cotangent, seed=2)["x"]) == pytest.approx(float(along), rel=1e-3)


MIRRORED = {"to_world": ("scale", [-1, 1, 1])}


@pytest.mark.parametrize(
    ("shape", "inside_out"),
    [
        ({"type": "sphere"}, False),
        ({"type": "sphere", "flip_normals": True}, True),
        ({"type": "sphere"} | MIRRORED, True),
        ({"type": "sphere", "flip_normals": True} | MIRRORED, False),
        ({"type": "cube"}, False),
        ({"type": "cube"} | MIRRORED, True),
        ({"type": "cube", "flip_normals": True}, True),
        ({"type": "rectangle", "flip_normals": True}, False),
    ],
    ids=str,
)
def test_what_is_turned_inside_out_is_blurred_and_told_of(
    shape: dict[str, Any], inside_out: bool, recwarn: pytest.WarningsRecorder
) -> None:
    """Of a ball so turned, the gradient was three times too large along one axis; of a box, its sign was wrong."""
    shape = dict(shape)
    if "to_world" in shape:
        shape["to_world"] = mi.ScalarTransform4f().scale(shape["to_world"][1])
    scene = shadow_scene(mesh=shape | {"bsdf": {"type": "twosided", "nested": {"type": "diffuse"}}})
    (found,) = (one for one in mi.load_dict(scene, optimize=False).shapes() if one.id() == "mesh")
    assert has_inward_normals(found) == inside_out
    assert list(PlannedRenderer(scene, MOVES).plan.blurred) == (["x"] if inside_out else [])
    MitsubaRenderer(scene, MOVES)
    assert any("normals that point inwards" in str(one.message) for one in recwarn) == inside_out

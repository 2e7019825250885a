"""Unwelded meshes have the gradient of welded ones, and meshes without a right gradient are recognised."""

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
from mitsuba_boundaries.diagnostics import is_non_manifold
from mitsuba_boundaries.geometry.mesh_checks import (
    has_inward_normals,
    is_sharp_edged,
    is_unwelded,
    non_manifold_fraction,
)
from tests.mitsuba.scenes import HEIGHT, WIDTH, box, random_cotangent, shadow_scene
from tests.strategies import thorough

RAMP = np.linspace(-1.0, 1.0, WIDTH, dtype=np.float32)[None, :, None] * np.ones((HEIGHT, WIDTH, 3), np.float32)
MOVES: dict[str, Any] = {"x": Translate("mesh", (1, 0, 0))}
TURNS: dict[str, Any] = MOVES | {"turn": Rotate("mesh", (0, 0, 1))}
TRANSFORM = mi.ScalarTransform4f


def load_shape(mesh: dict[str, Any]) -> Any:
    return mi.load_dict({"type": "scene", "mesh": mesh}, optimize=False).shapes()[0]


def ball_file(folder: Path, *, split: bool, normals: bool = False) -> str:
    """A triangulated ball; if it is split, no two triangles share a vertex."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    corners, triangles = np.array(ball.vertices), np.array(ball.faces)
    if split:
        corners, triangles = corners[triangles.ravel()], np.arange(triangles.size).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners, triangles, vertex_normals=corners if normals else None, process=False)
    path = folder / f"{split}-{normals}.ply"
    mesh.export(path, vertex_normal=normals)
    return str(path)


def scene_of(mesh: dict[str, Any]) -> dict[str, Any]:
    """A scene that shows the mesh and its shadow."""
    return shadow_scene(
        mesh={"to_world": TRANSFORM().translate([0.3, 1.5, 0.2]).rotate([0.6, 0.0, 0.8], 30).scale(0.7), **mesh}
    )


def gradients(renderer: PlannedRenderer, seeds: int = 1) -> Any:
    """Return the gradients of several seeds by parameter."""
    start = renderer.parameters()
    vjps = [renderer.unabridged.vjp(start, RAMP, seed=seed) for seed in range(seeds)]
    return {name: np.array([float(vjp[name]) for vjp in vjps]) for name in start}


def test_an_unwelded_smooth_mesh_has_the_gradient_of_the_welded_mesh(tmp_path: Path) -> None:
    meshes = ({"type": "ply", "filename": ball_file(tmp_path, split=split, normals=True)} for split in (True, False))
    unwelded, welded = (PlannedRenderer(scene_of(mesh), TURNS, spp=16) for mesh in meshes)
    assert list(unwelded.plan.substitutions) == ["mesh 'mesh'"]
    assert not welded.plan.substitutions
    actual, expected = gradients(unwelded), gradients(welded)
    for name in TURNS:
        assert abs(expected[name]) > 0.0
        np.testing.assert_allclose(actual[name], expected[name], rtol=1e-3)


@thorough
def test_an_unwelded_flat_mesh_has_the_gradient_of_the_welded_mesh(tmp_path: Path) -> None:
    """Up to noise, because the order of the edges, and thus their samples, differ."""
    files = (ball_file(tmp_path, split=split) for split in (True, False))
    meshes = ({"type": "ply", "filename": file, "face_normals": True} for file in files)
    unwelded, welded = (gradients(PlannedRenderer(scene_of(mesh), MOVES, spp=16), seeds=24)["x"] for mesh in meshes)
    error = np.hypot(np.std(unwelded, ddof=1), np.std(welded, ddof=1)) / np.sqrt(24.0)
    assert abs(np.mean(welded)) > 10.0 * error
    assert np.mean(unwelded) == pytest.approx(np.mean(welded), abs=4.0 * error)


def test_welding_does_not_change_the_image(tmp_path: Path) -> None:
    ball = {"type": "ply", "filename": ball_file(tmp_path, split=True)}
    plain = PlannedRenderer(scene_of(ball), MOVES, spp=8, proxy={"seams": False})
    assert not plain.plan.substitutions
    planned = PlannedRenderer(scene_of(ball), MOVES, spp=8)
    start = planned.parameters()
    np.testing.assert_allclose(planned.render(start, seed=3), plain.render(start, seed=3), rtol=1e-4, atol=1e-5)


def test_a_mesh_object_of_the_caller_is_not_welded(tmp_path: Path) -> None:
    mesh = mi.load_dict({"type": "ply", "filename": ball_file(tmp_path, split=True)})
    faces = np.array(mi.traverse(mesh)["faces"])
    assert not PlannedRenderer(shadow_scene(mesh=mesh), MOVES).plan.substitutions
    np.testing.assert_array_equal(mi.traverse(mesh)["faces"], faces)


def test_a_mesh_with_fitted_vertices_is_not_welded() -> None:
    planned = PlannedRenderer(scene_of({"type": "cube"}), {"corners": "mesh.vertex_positions"})
    assert not planned.plan.substitutions


def test_sharp_edged_and_unwelded_meshes_are_recognised(tmp_path: Path) -> None:
    cube = load_shape({"type": "cube"})
    smooth = load_shape({"type": "ply", "filename": ball_file(tmp_path, split=True, normals=True)})
    whole = load_shape({"type": "ply", "filename": ball_file(tmp_path, split=False)})
    assert [is_unwelded(shape) for shape in (cube, smooth, whole, load_shape({"type": "rectangle"}))] == [
        True,
        True,
        False,
        False,
    ]
    flat = load_shape({"type": "ply", "filename": ball_file(tmp_path, split=True), "face_normals": True})
    assert [is_sharp_edged(shape) for shape in (cube, smooth, flat, box((0.0, 0.0, 0.0), 1.0))] == [
        True,
        False,
        False,
        True,
    ]
    assert not is_unwelded(load_shape({"type": "sphere"}))


@pytest.mark.parametrize("film", [{}, {"sample_border": True}, {"rfilter": {"type": "box"}}])
def test_a_cube_in_a_dict_is_replaced_for_all_films(film: dict[str, Any]) -> None:
    """Where the filter extends beyond the border, the scene is loaded again, with new shape objects."""
    scene = scene_of({"type": "cube"})
    scene["sensor"]["film"] = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, **film}
    assert list(PlannedRenderer(scene, MOVES, spp=4).plan.substitutions) == ["mesh 'mesh'"]


def box_file(folder: Path, variant: str) -> str:
    """A plain box, or one with a top of strips, with a diagonal wall, or with all faces doubled back to back."""
    corners: list[tuple[float, float, float]] = []
    faces: list[list[int]] = []

    def add_quad(*vertices: tuple[float, float, float]) -> None:
        faces.extend(
            [[len(corners), len(corners) + 1, len(corners) + 2], [len(corners), len(corners) + 2, len(corners) + 3]]
        )
        corners.extend(vertices)

    outline = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
    for (x, z), (u, w) in pairwise(outline):
        add_quad((x, -1.0, z), (u, -1.0, w), (u, 1.0, w), (x, 1.0, z))
    cuts = (-1.0, -0.2, 0.4, 1.0) if variant == "strips" else (-1.0, 1.0)
    for a, b in pairwise(cuts):
        add_quad((a, 1.0, -1.0), (a, 1.0, 1.0), (b, 1.0, 1.0), (b, 1.0, -1.0))
        add_quad((a, -1.0, 1.0), (a, -1.0, -1.0), (b, -1.0, -1.0), (b, -1.0, 1.0))
    if variant == "wall":
        add_quad((-1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (1.0, 1.0, 1.0), (1.0, -1.0, 1.0))
    if variant == "twice":
        faces += [[a, c, b] for a, b, c in faces]
    path = folder / f"{variant}.ply"
    trimesh.Trimesh(corners, faces, process=False).export(path)
    return str(path)


@pytest.mark.parametrize(
    ("variant", "non_manifold"), [("box", False), ("strips", True), ("wall", True), ("twice", True)]
)
def test_non_manifold_meshes_give_a_warning_and_are_blurred(
    variant: str, non_manifold: bool, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    mesh = {"type": "ply", "filename": box_file(tmp_path, variant), "face_normals": True}
    assert is_non_manifold(load_shape(mesh)) == non_manifold
    planned = PlannedRenderer(scene_of(mesh), MOVES, spp=4)
    assert list(planned.plan.blurred) == (["x"] if non_manifold else [])
    MitsubaRenderer(scene_of(mesh), MOVES, spp=4)
    assert any("more than two triangles meet" in str(warning.message) for warning in recwarn) == non_manifold


def test_fitted_vertices_of_a_non_manifold_mesh_give_a_warning_without_blurring(tmp_path: Path) -> None:
    mesh = {"type": "ply", "filename": box_file(tmp_path, "twice"), "face_normals": True}
    with pytest.warns(GradientWarning, match="more than two triangles meet"):
        planned = PlannedRenderer(scene_of(mesh), {"corners": "mesh.vertex_positions"}, spp=4)
    assert not planned.plan.blurred


def test_a_smooth_mesh_has_no_non_manifold_edges(tmp_path: Path) -> None:
    for split in (True, False):
        mesh = {"type": "ply", "filename": ball_file(tmp_path, split=split)}
        assert non_manifold_fraction(load_shape(mesh)) == 0.0


def test_a_cutout_gives_a_warning_and_is_blurred() -> None:
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


def test_the_option_seams_must_be_a_bool() -> None:
    with pytest.raises(OptionError, match=r"`proxy`: `seams` must be true or false, got 1"):
        PlannedRenderer(scene_of({"type": "cube"}), MOVES, proxy={"seams": 1})


def test_a_welded_box_keeps_its_texture() -> None:
    """Only the gradient of its shadow is the proxy's, because welded vertices change the texture coordinates."""
    values = mi.TensorXf(np.random.default_rng(0).random((4, 4, 3)).astype(np.float32))
    paint = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": values, "raw": True}}
    pose = mi.ScalarTransform4f().translate([0, 1, 0]).scale(0.7)
    scene = shadow_scene(mesh={"type": "cube", "to_world": pose, "bsdf": paint})
    planned = PlannedRenderer(scene, MOVES, spp=8)
    assert list(planned.plan.substitutions) == ["mesh 'mesh'"]
    primary = {"type": "direct_projective", "guiding": "none", "sppc": 8, "sppp": 8, "sppi": 0}
    plain = MitsubaRenderer(scene, MOVES, integrator=primary)
    proxied = planned.unabridged.with_integrator(primary)
    start, cotangent = planned.parameters(), random_cotangent()
    expected, actual = (renderer.vjp(start, cotangent, seed=1)["x"] for renderer in (plain, proxied))
    assert abs(expected) > 0.0
    np.testing.assert_allclose(actual, expected, rtol=1e-4)
    shadow = proxied.with_integrator(primary | {"sppc": 0, "sppp": 0, "sppi": 8})
    assert abs(shadow.vjp(start, cotangent, seed=1)["x"]) > 0.0
    full = proxied.with_integrator(primary | {"sppi": 8})
    tangent = {name: np.ones_like(value) for name, value in start.items()}
    derivative = np.vdot(full.jvp(start, tangent, seed=2), cotangent)
    assert float(full.vjp(start, cotangent, seed=2)["x"]) == pytest.approx(float(derivative), rel=1e-3)


MIRRORED = {"to_world": ("scale", [-1, 1, 1])}


@pytest.mark.parametrize(
    ("shape", "is_inverted"),
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
def test_shapes_with_inward_normals_give_a_warning_and_are_blurred(
    shape: dict[str, Any], is_inverted: bool, recwarn: pytest.WarningsRecorder
) -> None:
    """The gradient of such a ball was three times too large along one axis; a box had the wrong sign."""
    shape = dict(shape)
    if "to_world" in shape:
        shape["to_world"] = mi.ScalarTransform4f().scale(shape["to_world"][1])
    scene = shadow_scene(mesh=shape | {"bsdf": {"type": "twosided", "nested": {"type": "diffuse"}}})
    (mesh,) = (loaded for loaded in mi.load_dict(scene, optimize=False).shapes() if loaded.id() == "mesh")
    assert has_inward_normals(mesh) == is_inverted
    assert list(PlannedRenderer(scene, MOVES).plan.blurred) == (["x"] if is_inverted else [])
    MitsubaRenderer(scene, MOVES)
    assert any("normals that point inwards" in str(warning.message) for warning in recwarn) == is_inverted

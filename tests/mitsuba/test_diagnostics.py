"""Where Mitsuba's gradients are missing or doubled, the renderer says so."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, Translate
from tests.helpers import Host
from tests.mitsuba.scenes import PARAMETERS, box, random_cotangent, shadow_scene

Z = [0, 0, 1]


@pytest.mark.parametrize(
    ("light", "kind"),
    [
        ({"type": "point", "position": [0, 12, 0]}, "PointLight"),
        ({"type": "directional", "direction": [0, -1, 0]}, "DirectionalEmitter"),
    ],
)
def test_shadows_without_a_gradient_are_warned_of(light: dict[str, Any], kind: str) -> None:
    with pytest.warns(GradientWarning, match=f"a shape moves under a {kind}, .*use a small sphere"):
        renderer = MitsubaRenderer(shadow_scene(lamp=light), {"place": Translate("ball")})
    gradient = renderer.render_vjp(renderer.parameters())[1](random_cotangent())
    assert not np.any(gradient["place"])  # the ball is out of view, so its shadow is all there is: the warning is true
    MitsubaRenderer(shadow_scene(lamp=light), {"floor": PARAMETERS["floor"]})  # nothing moves: no warning


def test_integrators_without_outlines_are_warned_of() -> None:
    with pytest.warns(GradientWarning, match="has no gradient of moving silhouettes and shadows; use direct_proj"):
        renderer = MitsubaRenderer(shadow_scene(), {"place": Translate("ball")}, integrator={"type": "direct"})
    gradient = renderer.render_vjp(renderer.parameters())[1](random_cotangent())
    assert not np.any(gradient["place"])  # the ball is out of view, so its shadow is all there is: the warning is true


def test_shapes_in_groups_are_warned_of() -> None:
    group = {"type": "shapegroup", "ball": {"type": "sphere"}}
    scene = shadow_scene(group=group, one={"type": "instance", "of": {"type": "ref", "id": "group"}})
    with pytest.warns(GradientWarning, match="shape 'ball' moves in a shapegroup, .*has no gradient; put the shape"):
        MitsubaRenderer(scene, {"place": Translate("group.ball")})


def test_colours_of_vertices_do_not_move_a_mesh() -> None:
    coloured = box((1.0, 0.6, 0.0), 0.4)
    coloured.add_attribute("vertex_color", 3, [0.5] * 24)
    scene = shadow_scene(box=coloured, sensor={"type": "orthographic"}, lamp={"type": "point", "position": [0, 12, 0]})
    renderer = MitsubaRenderer(scene, {"colours": "box.vertex_color"})  # neither refused nor warned of
    assert renderer.parameters()["colours"].shape == (24,)


def test_meshes_that_count_twice_are_warned_of() -> None:
    with pytest.warns(GradientWarning, match="mesh 'cube' stores the vertices of an edge more than once"):
        MitsubaRenderer(shadow_scene(cube={"type": "cube"}), {"place": Translate("cube")})


def test_many_meshes_are_warned_of_once(recwarn: pytest.WarningsRecorder) -> None:
    """However many parameters move each."""
    cubes = {f"cube {k}": {"type": "cube"} for k in range(7)}
    moved = {f"{name} {axis}": Translate(name, axis) for name in cubes for axis in ((1, 0, 0), (0, 1, 0))}
    MitsubaRenderer(shadow_scene(**cubes), moved)
    (message,) = [str(one.message) for one in recwarn if one.category is GradientWarning]
    assert message.startswith(
        "meshes 'cube 0', 'cube 1', 'cube 2', 'cube 3' and 3 others store the vertices of an edge"
    )


@pytest.mark.parametrize(
    ("texture", "told"),
    [
        ({"type": "checkerboard"}, True),
        ({"type": "bitmap", "filter_type": "nearest"}, True),
        ({"type": "bitmap"}, False),
        ({"type": "bitmap", "filter_type": "nearest", "channels": 1}, True),
        ({"type": "bitmap", "filter_type": "nearest", "flat": True}, True),
        ({"type": "bitmap", "flat": True}, False),
    ],
)
def test_steps_of_a_texture_that_moves_are_warned_of(
    texture: dict[str, Any], told: bool, recwarn: pytest.WarningsRecorder
) -> None:
    texture = dict(texture)
    if texture["type"] == "bitmap":
        values = np.random.default_rng(0).random((5, 7, texture.pop("channels", 3)), dtype=np.float32)
        if texture.pop("flat", False):  # as a logo is nearly everywhere
            values = np.pad(values, ((40, 40), (40, 40), (0, 0)))
        texture |= {"data": mi.TensorXf(values), "raw": True}
    ball = {"type": "sphere", "bsdf": {"type": "twosided", "nested": {"type": "diffuse", "reflectance": texture}}}
    MitsubaRenderer(shadow_scene(ball=ball), {"x": Translate("ball", (1, 0, 0))})
    assert any("a texture with steps" in str(one.message) for one in recwarn) == told


@pytest.mark.parametrize("kind", ["bumpmap", "normalmap"])
@pytest.mark.parametrize("sides", ["one", "two"])
def test_maps_of_normals_that_move_are_warned_of(kind: str, sides: str, recwarn: pytest.WarningsRecorder) -> None:
    """As for a ball whose normals all lean by 30 degrees, whose gradient is up to 2.9 times that by differences."""
    slopes = np.random.default_rng(0).random((5, 7, 1 if kind == "bumpmap" else 3), dtype=np.float32)
    texture = {"type": "bitmap", "data": mi.TensorXf(slopes), "raw": True}
    plain = {"type": "diffuse"}
    for material, told in (({"type": kind, kind: texture, "nested": plain}, True), (plain, False)):
        bsdf = material if sides == "one" else {"type": "twosided", "nested": material}
        recwarn.clear()
        MitsubaRenderer(shadow_scene(ball={"type": "sphere", "bsdf": bsdf}), {"x": Translate("ball", (1, 0, 0))})
        assert any("'ball' has a bump or normal map" in str(one.message) for one in recwarn) == told


def smooth(vertices: Host, faces: Host, *, flat: bool = False) -> Any:
    """A mesh with normals as Mitsuba gives those that bring none."""
    settings = mi.Properties()
    settings["face_normals"] = flat
    mesh = mi.Mesh("it", len(vertices), len(faces), has_vertex_normals=not flat, props=settings)
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
    params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    params.update()
    if not flat:
        mesh.recompute_vertex_normals()
    return mesh


def hull(vertices: Host) -> tuple[Host, Host]:
    """The triangles around points, wound outwards."""
    faces = ConvexHull(vertices).simplices
    a, b, c = vertices[faces].transpose(1, 0, 2)
    inwards = np.sum(np.cross(b - a, c - a) * a, axis=1) < 0.0
    return vertices, np.where(inwards[:, None], faces[:, ::-1], faces)


def ball_of(count: int) -> tuple[Host, Host]:
    """As even as a spiral gets them."""
    height = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    around = np.sqrt(1.0 - height**2)
    return hull(np.stack([around * np.cos(turn), around * np.sin(turn), height], axis=1))


def cone(sides: int) -> tuple[Host, Host]:
    turn = 2.0 * np.pi * np.arange(sides) / sides
    rim = np.stack([np.cos(turn), np.sin(turn), np.full(sides, -0.5)], axis=1)
    return hull(np.concatenate([rim, [[0.0, 0.0, 1.0]]]))


CUBE = np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), axis=-1).reshape(-1, 3)


@pytest.mark.parametrize(
    ("mesh", "flat", "told"),
    [
        (hull(CUBE), False, True),
        (hull(CUBE), True, False),
        (cone(24), False, True),
        (ball_of(12), False, True),
        (ball_of(42), False, False),
        (ball_of(500), False, False),
    ],
    ids=["cube", "flat cube", "cone", "ball of 12", "ball of 42", "ball of 500"],
)
def test_sharp_edges_that_are_shaded_round_are_warned_of(
    mesh: tuple[Host, Host], flat: bool, told: bool, recwarn: pytest.WarningsRecorder
) -> None:
    """Their gradient was 0.3 to 0.9 of what differences say; that of a ball of 42 vertices, 80 triangles, was right."""
    MitsubaRenderer(shadow_scene(it=smooth(*mesh, flat=flat)), {"x": Translate("it", (1, 0, 0))})
    assert any("mesh 'it' is shaded as if sharp edges were round" in str(one.message) for one in recwarn) == told


@pytest.mark.parametrize(("leant", "told"), [(0.0, True), (90.0, False)])
def test_cylinders_that_are_looked_into_are_warned_of(
    leant: float, told: bool, recwarn: pytest.WarningsRecorder
) -> None:
    """Upright, before a camera above it; and lying from left to right."""
    tube = {"type": "cylinder", "p0": [0, -1, 0], "p1": [0, 1, 0], "to_world": mi.ScalarTransform4f().rotate(Z, leant)}
    MitsubaRenderer(shadow_scene(tube=tube), {"x": Translate("tube", (1, 0, 0))})
    assert any("the camera looks into an open end of 'tube'" in str(one.message) for one in recwarn) == told


@pytest.mark.parametrize(
    ("size", "away", "height", "told"),
    [(1.0, 0.0, 0.3, False), (0.01, 0.0, 0.3, True), (1.0, 100.0, 0.3, True), (0.01, 0.0, 3.0, False)],
    ids=["of its size", "small", "far away", "small and apart"],
)
def test_shapes_that_mitsuba_lifts_rays_far_off_are_warned_of_where_they_touch(
    size: float, away: float, height: float, told: bool, recwarn: pytest.WarningsRecorder
) -> None:
    place = mi.ScalarTransform4f
    scene = shadow_scene(
        ball={"type": "sphere", "to_world": place().translate([away, height * size, 0]).scale(0.4 * size)},
        floor={"type": "rectangle", "to_world": place().translate([away, 0, 0]).rotate([1, 0, 0], -90).scale(8)},
    )
    MitsubaRenderer(scene, {"x": Translate("ball", (1, 0, 0))})
    assert any("'ball' touches another shape, and is too small, or" in str(one.message) for one in recwarn) == told


SINGLE: dict[str, tuple[dict[str, Any], str]] = {
    "mask": ({"type": "mask", "opacity": 0.6, "nested": {"type": "diffuse"}}, "opacity"),
    "blend": (
        {"type": "blendbsdf", "weight": 0.6, "one": {"type": "diffuse"}, "other": {"type": "conductor"}},
        "weight",
    ),
    "mirror": ({"type": "conductor", "specular_reflectance": 0.6}, "specular_reflectance"),
}


@pytest.mark.parametrize("kind", SINGLE)
def test_what_material_in_single_directions_has_no_gradient_by_is_told_and_blurred(kind: str) -> None:
    bsdf, part = SINGLE[kind]
    scene = shadow_scene(ball={"type": "sphere", "bsdf": bsdf})
    with pytest.warns(GradientWarning, match=f"'it': it is the {part} of a material with a delta lobe"):
        MitsubaRenderer(scene, {"it": f"ball.bsdf.{part}.value"})
    planned = PlannedRenderer(scene, {"it": f"ball.bsdf.{part}.value"})
    assert planned.plan.blurred["it"].startswith(f"it is the {part} of a material")


def test_the_weight_of_a_blend_without_single_directions_keeps_mitsubas_gradient() -> None:
    bsdf = {"type": "blendbsdf", "weight": 0.6, "one": {"type": "diffuse"}, "other": {"type": "plastic"}}
    for other, kept in (("roughplastic", True), ("plastic", False)):
        bsdf |= {"other": {"type": other}}
        planned = PlannedRenderer(shadow_scene(ball={"type": "sphere", "bsdf": bsdf}), {"it": "ball.bsdf.weight.value"})
        assert (not planned.plan.blurred) == kept

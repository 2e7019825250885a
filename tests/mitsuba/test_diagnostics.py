"""The renderer warns where Mitsuba's gradients are missing or counted twice."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, Translate
from tests.helpers import Host
from tests.mitsuba.scenes import PARAMETERS, box, random_cotangent, shadow_scene

SMOKE = {"type": "sphere", "bsdf": {"type": "null"}, "interior": {"type": "homogeneous"}}


def gradient_warnings(recwarn: pytest.WarningsRecorder) -> list[str]:
    return [str(warning.message) for warning in recwarn if warning.category is GradientWarning]


@pytest.mark.parametrize(
    ("light", "type_name"),
    [
        ({"type": "point", "position": [0, 12, 0]}, "PointLight"),
        ({"type": "directional", "direction": [0, -1, 0]}, "DirectionalEmitter"),
    ],
)
def test_moving_shadows_of_delta_lights_give_a_warning_only_to_unsupported_cameras(
    light: dict[str, Any], type_name: str, recwarn: pytest.WarningsRecorder
) -> None:
    renderer = MitsubaRenderer(shadow_scene(lamp=light), {"place": Translate("ball")})
    gradient = renderer.render_vjp(renderer.parameters())[1](random_cotangent())
    assert np.any(gradient["place"])  # only the shadow of the ball is in view
    assert not gradient_warnings(recwarn)
    scene = shadow_scene(lamp=light)
    scene["sensor"] |= {"type": "thinlens", "aperture_radius": 0.1}
    shadows = {"type": "direct_projective", "guiding": "none", "sppp": 0}
    with pytest.warns(GradientWarning, match=f"a shape moves under a {type_name}, .*use a small sphere"):
        MitsubaRenderer(scene, {"place": Translate("ball")}, integrator=shadows)
    MitsubaRenderer(scene, {"floor": PARAMETERS["floor"]}, integrator=shadows)  # nothing moves: no warning


def test_integrators_without_silhouettes_give_a_warning() -> None:
    with pytest.warns(GradientWarning, match="has no gradient of moving silhouettes and shadows; use direct_proj"):
        renderer = MitsubaRenderer(shadow_scene(), {"place": Translate("ball")}, integrator={"type": "direct"})
    gradient = renderer.render_vjp(renderer.parameters())[1](random_cotangent())
    assert not np.any(gradient["place"])  # the warning is true: only the shadow of the ball is in view


def test_moving_shapes_in_groups_give_a_warning() -> None:
    group = {"type": "shapegroup", "ball": {"type": "sphere"}}
    scene = shadow_scene(group=group, one={"type": "instance", "of": {"type": "ref", "id": "group"}})
    with pytest.warns(GradientWarning, match="shape 'ball' moves in a shapegroup, .*has no gradient; put the shape"):
        MitsubaRenderer(scene, {"place": Translate("group.ball")})


def test_vertex_colours_do_not_count_as_motion() -> None:
    coloured = box((1.0, 0.6, 0.0), 0.4)
    coloured.add_attribute("vertex_color", 3, [0.5] * 24)
    scene = shadow_scene(box=coloured, sensor={"type": "orthographic"}, lamp={"type": "point", "position": [0, 12, 0]})
    renderer = MitsubaRenderer(scene, {"colours": "box.vertex_color"})  # neither an error nor a warning
    assert renderer.parameters()["colours"].shape == (24,)


def test_unwelded_meshes_give_a_warning_only_where_their_edges_cannot_be_sampled(
    recwarn: pytest.WarningsRecorder,
) -> None:
    cube, moves = {"type": "cube"}, {"place": Translate("cube")}
    MitsubaRenderer(shadow_scene(cube=cube), moves)
    assert gradient_warnings(recwarn) == []
    MitsubaRenderer(shadow_scene(cube=cube, smoke=SMOKE), moves)
    (message,) = gradient_warnings(recwarn)
    assert message.startswith("mesh 'cube' stores the vertices of an edge more than once")


def test_many_meshes_share_one_warning(recwarn: pytest.WarningsRecorder) -> None:
    """Whatever the number of parameters of each."""
    cubes = {f"cube {k}": {"type": "cube"} for k in range(7)}
    moved = {f"{name} {axis}": Translate(name, axis) for name in cubes for axis in ((1, 0, 0), (0, 1, 0))}
    MitsubaRenderer(shadow_scene(**cubes, smoke=SMOKE), moved)
    (message,) = gradient_warnings(recwarn)
    assert message.startswith(
        "meshes 'cube 0', 'cube 1', 'cube 2', 'cube 3' and 3 others store the vertices of an edge"
    )


@pytest.mark.parametrize(
    ("texture", "warns"),
    [
        ({"type": "checkerboard"}, True),
        ({"type": "bitmap", "filter_type": "nearest"}, True),
        ({"type": "bitmap"}, False),
        ({"type": "bitmap", "filter_type": "nearest", "channels": 1}, True),
        ({"type": "bitmap", "filter_type": "nearest", "flat": True}, True),
        ({"type": "bitmap", "flat": True}, False),
    ],
)
def test_moving_stepped_textures_give_a_warning(
    texture: dict[str, Any], warns: bool, recwarn: pytest.WarningsRecorder
) -> None:
    texture = dict(texture)
    if texture["type"] == "bitmap":
        values = np.random.default_rng(0).random((5, 7, texture.pop("channels", 3)), dtype=np.float32)
        if texture.pop("flat", False):  # as large parts of a logo
            values = np.pad(values, ((40, 40), (40, 40), (0, 0)))
        texture |= {"data": mi.TensorXf(values), "raw": True}
    ball = {"type": "sphere", "bsdf": {"type": "twosided", "nested": {"type": "diffuse", "reflectance": texture}}}
    MitsubaRenderer(shadow_scene(ball=ball), {"x": Translate("ball", (1, 0, 0))})
    assert any("a texture with steps" in message for message in gradient_warnings(recwarn)) == warns


@pytest.mark.parametrize("type_name", ["bumpmap", "normalmap"])
@pytest.mark.parametrize("is_twosided", [False, True])
def test_moving_normal_maps_give_a_warning(type_name: str, is_twosided: bool, recwarn: pytest.WarningsRecorder) -> None:
    """With all normals tilted by 30 degrees, the gradient of a ball is up to 2.9 times the finite difference."""
    slopes = np.random.default_rng(0).random((5, 7, 1 if type_name == "bumpmap" else 3), dtype=np.float32)
    texture = {"type": "bitmap", "data": mi.TensorXf(slopes), "raw": True}
    plain = {"type": "diffuse"}
    for material, warns in (({"type": type_name, type_name: texture, "nested": plain}, True), (plain, False)):
        bsdf = {"type": "twosided", "nested": material} if is_twosided else material
        recwarn.clear()
        MitsubaRenderer(shadow_scene(ball={"type": "sphere", "bsdf": bsdf}), {"x": Translate("ball", (1, 0, 0))})
        assert any("'ball' has a bump or normal map" in message for message in gradient_warnings(recwarn)) == warns


def load_mesh(vertices: Host, faces: Host, *, flat: bool = False) -> Any:
    """A mesh with Mitsuba's default vertex normals, or with flat shading."""
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
    """The convex hull of points, with triangles oriented outwards."""
    faces = ConvexHull(vertices).simplices
    a, b, c = vertices[faces].transpose(1, 0, 2)
    is_inverted = np.sum(np.cross(b - a, c - a) * a, axis=1) < 0.0
    return vertices, np.where(is_inverted[:, None], faces[:, ::-1], faces)


def ball_of(count: int) -> tuple[Host, Host]:
    """The hull of points on a Fibonacci spiral."""
    height = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    angle = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - height**2)
    return hull(np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1))


def cone(count: int) -> tuple[Host, Host]:
    angle = 2.0 * np.pi * np.arange(count) / count
    rim = np.stack([np.cos(angle), np.sin(angle), np.full(count, -0.5)], axis=1)
    return hull(np.concatenate([rim, [[0.0, 0.0, 1.0]]]))


CUBE = np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), axis=-1).reshape(-1, 3)


@pytest.mark.parametrize(
    ("mesh", "flat", "warns"),
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
def test_sharp_edges_with_smooth_shading_give_a_warning(
    mesh: tuple[Host, Host], flat: bool, warns: bool, recwarn: pytest.WarningsRecorder
) -> None:
    """Their gradient was 0.3 to 0.9 times the finite difference; a ball of 42 vertices, 80 triangles, was right."""
    MitsubaRenderer(shadow_scene(it=load_mesh(*mesh, flat=flat)), {"x": Translate("it", (1, 0, 0))})
    warning = "mesh 'it' is shaded as if sharp edges were round"
    assert any(warning in message for message in gradient_warnings(recwarn)) == warns


@pytest.mark.parametrize(("angle", "warns"), [(0.0, True), (90.0, False)], ids=["upright", "lying"])
def test_open_cylinders_seen_from_an_end_give_a_warning(
    angle: float, warns: bool, recwarn: pytest.WarningsRecorder
) -> None:
    tube = {
        "type": "cylinder",
        "p0": [0, -1, 0],
        "p1": [0, 1, 0],
        "to_world": mi.ScalarTransform4f().rotate([0, 0, 1], angle),
    }
    MitsubaRenderer(shadow_scene(tube=tube), {"x": Translate("tube", (1, 0, 0))})
    assert any("an open end of 'tube'" in message for message in gradient_warnings(recwarn)) == warns


@pytest.mark.parametrize(
    ("size", "distance", "height", "warns"),
    [(1.0, 0.0, 0.3, False), (0.01, 0.0, 0.3, True), (1.0, 100.0, 0.3, True), (0.01, 0.0, 3.0, False)],
    ids=["large", "small", "far away", "small and not touching"],
)
def test_touching_shapes_too_small_for_the_ray_epsilon_give_a_warning(
    size: float, distance: float, height: float, warns: bool, recwarn: pytest.WarningsRecorder
) -> None:
    transform = mi.ScalarTransform4f
    scene = shadow_scene(
        ball={"type": "sphere", "to_world": transform().translate([distance, height * size, 0]).scale(0.4 * size)},
        floor={
            "type": "rectangle",
            "to_world": transform().translate([distance, 0, 0]).rotate([1, 0, 0], -90).scale(8),
        },
    )
    MitsubaRenderer(scene, {"x": Translate("ball", (1, 0, 0))})
    assert any("'ball' touches another shape, and is too" in message for message in gradient_warnings(recwarn)) == warns


DELTA_MATERIALS: dict[str, tuple[dict[str, Any], str]] = {
    "mask": ({"type": "mask", "opacity": 0.6, "nested": {"type": "diffuse"}}, "opacity"),
    "blend": (
        {"type": "blendbsdf", "weight": 0.6, "one": {"type": "diffuse"}, "other": {"type": "conductor"}},
        "weight",
    ),
    "mirror": ({"type": "conductor", "specular_reflectance": 0.6}, "specular_reflectance"),
}


@pytest.mark.parametrize("type_name", DELTA_MATERIALS)
def test_entries_of_delta_materials_give_a_warning_and_are_blurred(type_name: str) -> None:
    bsdf, attribute = DELTA_MATERIALS[type_name]
    scene = shadow_scene(ball={"type": "sphere", "bsdf": bsdf})
    with pytest.warns(GradientWarning, match=f"'it': it is the {attribute} of a material with a delta lobe"):
        MitsubaRenderer(scene, {"it": f"ball.bsdf.{attribute}.value"})
    planned = PlannedRenderer(scene, {"it": f"ball.bsdf.{attribute}.value"})
    assert planned.plan.blurred["it"].startswith(f"it is the {attribute} of a material")


def test_the_weight_of_a_blend_without_delta_lobes_keeps_mitsuba_s_gradient() -> None:
    bsdf = {"type": "blendbsdf", "weight": 0.6, "one": {"type": "diffuse"}, "other": {"type": "plastic"}}
    for material, is_kept in (("roughplastic", True), ("plastic", False)):
        bsdf |= {"other": {"type": material}}
        planned = PlannedRenderer(shadow_scene(ball={"type": "sphere", "bsdf": bsdf}), {"it": "ball.bsdf.weight.value"})
        assert (not planned.plan.blurred) == is_kept

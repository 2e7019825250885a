"""Silhouettes have the gradient of finite differences for all settings of a perspective camera and its film."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, Translate
from mitsuba_boundaries.sensing.sensor import PerspectiveSensor
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.mitsuba.silhouettes import TRANSFORM, area_light, check_silhouettes, emitting_scene
from tests.strategies import thorough

BLOCK = {"type": "cube", "to_world": TRANSFORM().translate([0, 1.5, 0]).rotate([0, 1, 0], 20).scale(0.7)}
CROP = {
    "width": WIDTH + 20,
    "height": HEIGHT + 10,
    "crop_offset_x": 14,
    "crop_offset_y": 3,
    "crop_width": WIDTH,
    "crop_height": HEIGHT,
}
OFF_CENTRE = {"principal_point_offset_x": 0.12, "principal_point_offset_y": -0.08}


def scene_with(camera: dict[str, Any], film: dict[str, Any]) -> dict[str, Any]:
    scene = emitting_scene(block=BLOCK | {"emitter": area_light(0.9, 0.2, 0.1)})
    scene["sensor"] |= camera
    scene["sensor"]["film"] |= film
    return scene


@pytest.mark.parametrize(
    ("camera", "film"),
    [
        ({}, CROP),
        pytest.param(OFF_CENTRE, {}, marks=thorough),
        pytest.param({}, {"pixel_format": "xyz"}, marks=thorough),
    ],
    ids=["crop", "off centre", "XYZ"],
)
def test_a_box_has_the_gradient_of_finite_differences_for_any_camera(
    camera: dict[str, Any], film: dict[str, Any]
) -> None:
    check_silhouettes(scene_with(camera, film), ("x", "y"))


def test_points_project_to_the_film_position_of_mitsuba_s_sensor() -> None:
    for camera, film in (({}, CROP), (OFF_CENTRE, {}), (OFF_CENTRE, CROP)):
        sensor = mi.load_dict(scene_with(camera, film)).sensors()[0]
        si = mi.SurfaceInteraction3f()
        si.p = mi.Point3f(0.4, 0.7, -0.3)
        expected = np.array(sensor.sample_direction(si, mi.Point2f(0.5))[0].uv).ravel()
        actual = np.array(PerspectiveSensor(sensor).project(si.p).uv).ravel() * [WIDTH, HEIGHT]
        np.testing.assert_allclose(actual, expected, atol=1e-3)


def test_mitsuba_s_silhouettes_of_a_ball_are_right_in_a_crop_window() -> None:
    """Mitsuba itself shifts them by the offset of the window."""
    scene = scene_with({}, CROP)
    scene["block"] |= {"type": "sphere"}
    check_silhouettes(scene, ("x", "y"))


def test_a_film_with_alpha_gives_a_warning() -> None:
    scene = shadow_scene()
    scene["sensor"]["film"] |= {"pixel_format": "rgba"}
    with pytest.warns(GradientWarning, match="silhouettes have no gradient in the film's alpha"):
        MitsubaRenderer(scene, {"x": Translate("ball", (1, 0, 0))})


@pytest.mark.filterwarnings("ignore:.*near clipping plane:loi_mitsuba.GradientWarning")
def test_shapes_before_the_near_clipping_plane_occlude_no_edge() -> None:
    """The image does not show the wall, as of a room seen from outside."""
    scene = scene_with({"near_clip": 3.0}, {})
    pose = TRANSFORM().look_at([0, 4.5, 4.5], [0, 6, 6], [0, 1, 0]).scale(3)
    walled = scene | {"wall": {"type": "rectangle", "to_world": pose, "emitter": area_light(0.0, 0.4, 0.1)}}
    targets = {"x": Translate("block", (1, 0, 0))}
    edges = {"type": "direct_projective", "guiding": "none", "sppc": 0, "sppp": 64, "sppi": 0}
    cotangent = np.random.default_rng(0).standard_normal((HEIGHT, WIDTH, 3)).astype(np.float32)
    gradients = []
    for description in (scene, walled):
        renderer = MitsubaRenderer(description, targets, integrator=edges)
        gradients.append(renderer.vjp(renderer.parameters(), cotangent, seed=1)["x"])
    assert abs(gradients[0]) > 0.0
    assert gradients[1] == pytest.approx(gradients[0], rel=1e-3)
    planned = PlannedRenderer(walled, targets)
    assert "near clipping plane" in planned.plan.blurred["x"]
    assert not PlannedRenderer(scene, targets).plan.blurred

"""However a perspective camera shows a scene, the gradient of outlines is that of its image."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, Translate
from loi_mitsuba.sensing.sensor import PerspectiveSensor
from tests.mitsuba.outlines import PLACE, check_outlines, glow, glowing_scene
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.strategies import thorough

BLOCK = {"type": "cube", "to_world": PLACE().translate([0, 1.5, 0]).rotate([0, 1, 0], 20).scale(0.7)}
CROP = {
    "width": WIDTH + 20,
    "height": HEIGHT + 10,
    "crop_offset_x": 14,
    "crop_offset_y": 3,
    "crop_width": WIDTH,
    "crop_height": HEIGHT,
}
ASIDE = {"principal_point_offset_x": 0.12, "principal_point_offset_y": -0.08}


def scene_before(camera: dict[str, Any], film: dict[str, Any]) -> dict[str, Any]:
    scene = glowing_scene(block=BLOCK | {"emitter": glow(0.9, 0.2, 0.1)})
    scene["sensor"] |= camera
    scene["sensor"]["film"] |= film
    return scene


@pytest.mark.filterwarnings("ignore:mesh 'block' stores the vertices:loi_mitsuba.GradientWarning")
@pytest.mark.parametrize(
    ("camera", "film"),
    [({}, CROP), pytest.param(ASIDE, {}, marks=thorough), pytest.param({}, {"pixel_format": "xyz"}, marks=thorough)],
    ids=["crop", "off centre", "XYZ"],
)
def test_outlines_are_where_the_camera_shows_them(camera: dict[str, Any], film: dict[str, Any]) -> None:
    check_outlines(scene_before(camera, film), ("x", "y"))


def test_a_point_is_seen_where_the_sensor_says() -> None:
    for camera, film in (({}, CROP), (ASIDE, {}), (ASIDE, CROP)):
        sensor = mi.load_dict(scene_before(camera, film)).sensors()[0]
        there = mi.Point3f(0.4, 0.7, -0.3)
        meeting = mi.SurfaceInteraction3f()
        meeting.p = there
        wanted = np.array(sensor.sample_direction(meeting, mi.Point2f(0.5))[0].uv).ravel()
        found = np.array(PerspectiveSensor(sensor).project(there)[2]).ravel() * [WIDTH, HEIGHT]
        np.testing.assert_allclose(found, wanted, atol=1e-3)


def test_outlines_that_mitsuba_draws_are_where_the_camera_shows_them() -> None:
    """Those of a ball, which Mitsuba by itself shifts by where the crop window begins."""
    scene = scene_before({}, CROP)
    scene["block"] |= {"type": "sphere"}
    check_outlines(scene, ("x", "y"))


def test_alpha_is_warned_of() -> None:
    scene = shadow_scene()
    scene["sensor"]["film"] |= {"pixel_format": "rgba"}
    with pytest.warns(GradientWarning, match="outlines have no gradient in the film's alpha"):
        MitsubaRenderer(scene, {"x": Translate("ball", (1, 0, 0))})


def test_what_is_nearer_than_the_near_clipping_plane_hides_no_edge() -> None:
    """A wall that the image does not show, as of a room that is looked into from without."""
    scene = scene_before({"near_clip": 3.0}, {})
    pose = PLACE().look_at([0, 4.5, 4.5], [0, 6, 6], [0, 1, 0]).scale(3)
    walled = scene | {"wall": {"type": "rectangle", "to_world": pose, "emitter": glow(0.0, 0.4, 0.1)}}
    targets = {"x": Translate("block", (1, 0, 0))}
    edges = {"type": "direct_projective", "guiding": "none", "sppc": 0, "sppp": 64, "sppi": 0}
    cotangent = np.random.default_rng(0).standard_normal((HEIGHT, WIDTH, 3)).astype(np.float32)
    pulled = []
    for one in (scene, walled):
        with pytest.warns(GradientWarning):
            renderer = MitsubaRenderer(one, targets, integrator=edges)
        pulled.append(renderer.vjp(renderer.parameters(), cotangent, seed=1)["x"])
    assert abs(pulled[0]) > 0.0
    assert pulled[1] == pytest.approx(pulled[0], rel=1e-3)
    planned = PlannedRenderer(walled, targets)
    assert "near clipping plane" in planned.plan.blurred["x"]
    assert not PlannedRenderer(scene, targets).plan.blurred

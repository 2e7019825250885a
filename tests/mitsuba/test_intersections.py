"""Visible intersection curves of shapes have a gradient, and count once."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
import trimesh

from loi_mitsuba import MitsubaRenderer, Translate
from mitsuba_boundaries.intersections import IntersectionBoundary
from tests.mitsuba.scenes import shadow_scene
from tests.mitsuba.silhouettes import (
    MOVES,
    SILHOUETTES,
    START,
    TRANSFORM,
    area_light,
    bump,
    check_silhouettes,
    emitting_scene,
)
from tests.strategies import thorough

BOX: Final = TRANSFORM().rotate([0, 1, 0], 20).scale(0.7)


def ball(x: float, y: float, z: float, radius: float, **properties: Any) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, y, z], "radius": radius, **properties}


def sphere_mesh(folder: Path) -> dict[str, Any]:
    trimesh.creation.icosphere(3).export(folder / "sphere.ply")
    return {"type": "ply", "filename": str(folder / "sphere.ply"), "to_world": TRANSFORM().translate([0, 0.3, 0])}


def intersecting_scene(scene_name: str, folder: Path) -> dict[str, Any]:
    """A red block that intersects the floor, or a blue shape."""
    red, blue = {"emitter": area_light(0.9, 0.2, 0.1)}, {"emitter": area_light(0.1, 0.3, 0.9)}
    box = {"type": "cube", **red}
    shapes: dict[str, dict[str, Any]] = {
        "ball in the floor": {"block": ball(0, 0.2, 0, 1.0, **red)},
        "mesh in the floor": {"block": sphere_mesh(folder) | red},
        "box in the floor": {"block": box | {"to_world": TRANSFORM().translate([0, 0.2, 0]) @ BOX}},
        "balls": {"block": ball(0, 1.7, 0, 1.0, **red), "other": ball(0.9, 1.9, 0.3, 0.8, **blue)},
        "boxes": {
            "block": box | {"to_world": TRANSFORM().translate([0, 1.5, 0]) @ BOX},
            "other": {
                "type": "cube",
                "to_world": TRANSFORM().translate([0.5, 1.8, 0.4]).rotate([0.3, 1, 0], 50).scale(0.7),
                **blue,
            },
        },
    }
    return emitting_scene(**shapes[scene_name])


@pytest.mark.filterwarnings("ignore::loi_mitsuba.GradientWarning")
@pytest.mark.parametrize(
    "scene_name",
    [
        "ball in the floor",
        *(
            pytest.param(scene_name, marks=thorough)
            for scene_name in ("mesh in the floor", "box in the floor", "balls", "boxes")
        ),
    ],
)
def test_intersecting_shapes_have_the_gradient_of_finite_differences(scene_name: str, tmp_path: Path) -> None:
    """Without the intersection curve, some of these have the wrong sign."""
    check_silhouettes(intersecting_scene(scene_name, tmp_path))


def test_the_radiance_difference_is_extrapolated_to_the_intersection_curve() -> None:
    """Under a ball that bulges over the floor, radiance grows with the square root: threefold within 0.05 pixels."""
    scene = shadow_scene(
        ball={"type": "sphere", "to_world": TRANSFORM().translate([0, 0.3, 0]).scale(0.8)},
        lamp={
            "type": "rectangle",
            "to_world": TRANSFORM().translate([0, 6, 2]).rotate([1, 0, 0], 90).scale(1.5),
            "emitter": {"type": "area", "radiance": 6.0},
        },
        sensor={
            "type": "perspective",
            "fov": 35,
            "to_world": TRANSFORM().look_at([0, 4, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 64, "height": 48, "rfilter": {"type": "box"}},
        },
    )
    renderer = MitsubaRenderer(scene, {"up": Translate("ball", (0, 1, 0))}, spp=128)
    weight = np.broadcast_to(np.linspace(0, 1, 48)[:, None, None], (48, 64, 3)).astype(np.float32)
    start, step = renderer.parameters()["up"], np.float32(0.05)

    def loss(height: Any, seed: int) -> float:
        return float(np.sum(renderer.render({"up": height}, seed=seed) * weight))

    gradients = [float(renderer.vjp({"up": start}, weight, seed=seed)["up"]) for seed in range(4)]
    slopes = [(loss(start + step, seed) - loss(start - step, seed)) / (2.0 * float(step)) for seed in range(4)]
    error = math.hypot(*(float(np.std(draws, ddof=1)) / 2.0 for draws in (gradients, slopes)))
    assert np.mean(gradients) == pytest.approx(np.mean(slopes), rel=0.05, abs=4.0 * error)


@pytest.mark.parametrize("pixel_format", ["rgb", pytest.param("luminance", marks=thorough)])
def test_the_vjp_of_intersection_curves_is_the_adjoint_of_their_jvp(pixel_format: str) -> None:
    scene = emitting_scene(block=ball(0, 0.2, 0, 1.0, emitter=area_light(0.9, 0.2, 0.1)))
    scene["sensor"]["film"]["pixel_format"] = pixel_format
    renderer = MitsubaRenderer(scene, MOVES, integrator=SILHOUETTES | {"sppp": 16})
    weight = np.resize(bump(), renderer.render(START).shape)
    gradient = renderer.vjp(START, weight, seed=3)
    for name in ("x", "size"):
        tangent = {parameter: np.float32(parameter == name) for parameter in MOVES}
        derivative = np.sum(renderer.jvp(START, tangent, seed=3).astype(np.float64) * weight)
        assert float(gradient[name]) == pytest.approx(derivative, rel=1e-3)


@pytest.mark.parametrize("depth", [0.0, *(pytest.param(depth, marks=thorough) for depth in (0.002, 0.1))])
def test_a_box_on_a_floor_counts_its_lower_edges_once(depth: float) -> None:
    """Whether the box ends on the floor, or penetrates it by less or by more than the occlusion tolerance."""
    pose = TRANSFORM().translate([0, 0.7 - depth, 0]) @ BOX
    scene = emitting_scene(block={"type": "cube", "to_world": pose, "emitter": area_light(0.9, 0.2, 0.1)})
    check_silhouettes(scene, ("x", "z"))


def test_no_intersections_are_searched_for_between_distant_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        pytest.fail("the image was searched for intersections")

    monkeypatch.setattr(IntersectionBoundary, "_find_crossings", fail)
    scene = emitting_scene(block=ball(0, 1.5, 0, 1.0, emitter=area_light(0.9, 0.2, 0.1)))
    MitsubaRenderer(scene, MOVES, integrator=SILHOUETTES | {"sppp": 4}).vjp(START, bump())

"""Where shapes go through each other in view, the curve along which they do has a gradient, and counts once."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
import trimesh

from loi_mitsuba import GradientWarning, MitsubaRenderer, Translate
from loi_mitsuba.boundary.intersections import IntersectionBoundary
from tests.mitsuba.outlines import AT, MOVES, OUTLINES, PLACE, bump, check_outlines, glow, glowing_scene
from tests.mitsuba.scenes import shadow_scene
from tests.strategies import thorough

BOX: Final = PLACE().rotate([0, 1, 0], 20).scale(0.7)


def ball(x: float, y: float, z: float, radius: float, **look: Any) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, y, z], "radius": radius, **look}


def sphere_file(folder: Path) -> dict[str, Any]:
    trimesh.creation.icosphere(3).export(folder / "sphere.ply")
    return {"type": "ply", "filename": str(folder / "sphere.ply"), "to_world": PLACE().translate([0, 0.3, 0])}


def scene_of(kind: str, folder: Path) -> dict[str, Any]:
    """A red block that goes through the floor, or a blue shape."""
    red, blue = {"emitter": glow(0.9, 0.2, 0.1)}, {"emitter": glow(0.1, 0.3, 0.9)}
    box = {"type": "cube", **red}
    shapes: dict[str, dict[str, Any]] = {
        "ball in the floor": {"block": ball(0, 0.2, 0, 1.0, **red)},
        "mesh in the floor": {"block": sphere_file(folder) | red},
        "box in the floor": {"block": box | {"to_world": PLACE().translate([0, 0.2, 0]) @ BOX}},
        "balls": {"block": ball(0, 1.7, 0, 1.0, **red), "other": ball(0.9, 1.9, 0.3, 0.8, **blue)},
        "boxes": {
            "block": box | {"to_world": PLACE().translate([0, 1.5, 0]) @ BOX},
            "other": {
                "type": "cube",
                "to_world": PLACE().translate([0.5, 1.8, 0.4]).rotate([0.3, 1, 0], 50).scale(0.7),
                **blue,
            },
        },
    }
    return glowing_scene(**shapes[kind])


@pytest.mark.filterwarnings("ignore::loi_mitsuba.GradientWarning")
@pytest.mark.parametrize(
    "kind",
    [
        "ball in the floor",
        *(pytest.param(one, marks=thorough) for one in ("mesh in the floor", "box in the floor", "balls", "boxes")),
    ],
)
def test_shapes_that_go_through_others_have_the_gradient_of_finite_differences(kind: str, tmp_path: Path) -> None:
    """Without the curve along which they do, some of these have the wrong sign."""
    check_outlines(scene_of(kind, tmp_path))


def test_light_that_grows_with_the_distance_from_a_crossing_is_that_at_the_crossing() -> None:
    """Under a ball that bulges over the floor it grows as the root of the distance: 0.05 pixels off, threefold."""
    scene = shadow_scene(
        ball={"type": "sphere", "to_world": PLACE().translate([0, 0.3, 0]).scale(0.8)},
        lamp={
            "type": "rectangle",
            "to_world": PLACE().translate([0, 6, 2]).rotate([1, 0, 0], 90).scale(1.5),
            "emitter": {"type": "area", "radiance": 6.0},
        },
        sensor={
            "type": "perspective",
            "fov": 35,
            "to_world": PLACE().look_at([0, 4, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 64, "height": 48, "rfilter": {"type": "box"}},
        },
    )
    renderer = MitsubaRenderer(scene, {"up": Translate("ball", (0, 1, 0))}, spp=128)
    weight = np.broadcast_to(np.linspace(0, 1, 48)[:, None, None], (48, 64, 3)).astype(np.float32)
    at, step = renderer.parameters()["up"], np.float32(0.05)

    def seen(place: Any, seed: int) -> float:
        return float(np.sum(renderer.render({"up": place}, seed=seed) * weight))

    pulled = [float(renderer.vjp({"up": at}, weight, seed=seed)["up"]) for seed in range(4)]
    slopes = [(seen(at + step, seed) - seen(at - step, seed)) / (2.0 * float(step)) for seed in range(4)]
    unsure = math.hypot(*(float(np.std(each, ddof=1)) / 2.0 for each in (pulled, slopes)))
    assert np.mean(pulled) == pytest.approx(np.mean(slopes), rel=0.05, abs=4.0 * unsure)


@pytest.mark.parametrize("pixels", ["rgb", pytest.param("luminance", marks=thorough)])
def test_what_carries_forward_is_the_transpose_of_what_carries_back(pixels: str) -> None:
    scene = glowing_scene(block=ball(0, 0.2, 0, 1.0, emitter=glow(0.9, 0.2, 0.1)))
    scene["sensor"]["film"]["pixel_format"] = pixels
    renderer = MitsubaRenderer(scene, MOVES, integrator=OUTLINES | {"sppp": 16})
    weight = np.resize(bump(), renderer.render(AT).shape)
    back = renderer.vjp(AT, weight, seed=3)
    for name in ("x", "size"):
        along = {other: np.float32(other == name) for other in MOVES}
        forward = np.sum(renderer.jvp(AT, along, seed=3).astype(np.float64) * weight)
        assert float(back[name]) == pytest.approx(forward, rel=1e-3)


@pytest.mark.parametrize("depth", [0.0, *(pytest.param(one, marks=thorough) for one in (0.002, 0.1))])
def test_a_box_on_a_floor_counts_its_lower_edges_once(depth: float) -> None:
    """Whether it ends on the floor, or goes through it by less or by more than what hides an edge."""
    pose = PLACE().translate([0, 0.7 - depth, 0]) @ BOX
    scene = glowing_scene(block={"type": "cube", "to_world": pose, "emitter": glow(0.9, 0.2, 0.1)})
    with pytest.warns(GradientWarning, match="stores the vertices"):
        check_outlines(scene, ("x", "z"))


def test_shapes_apart_are_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    def searched(*_: Any) -> None:
        pytest.fail("the image was searched for crossings")

    monkeypatch.setattr(IntersectionBoundary, "_changes", searched)
    scene = glowing_scene(block=ball(0, 1.5, 0, 1.0, emitter=glow(0.9, 0.2, 0.1)))
    MitsubaRenderer(scene, MOVES, integrator=OUTLINES | {"sppp": 4}).vjp(AT, bump())

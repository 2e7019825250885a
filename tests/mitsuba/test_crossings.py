"""Where shapes go through each other in view, the curve along which they do has a gradient, and counts once."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import mitsuba as mi
import numpy as np
import pytest
import trimesh

from loi_mitsuba import GradientWarning, MitsubaRenderer, Scale, Translate
from loi_mitsuba.crossings import Crossings
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.strategies import thorough

PLACE = mi.ScalarTransform4f
BOX: Final = PLACE().rotate([0, 1, 0], 20).scale(0.7)
MOVES: dict[str, Any] = {
    "x": Translate("block", (1, 0, 0)),
    "y": Translate("block", (0, 1, 0)),
    "z": Translate("block", (0, 0, 1)),
    "size": Scale("block"),
}
AT: dict[str, Any] = {name: np.float32(name == "size") for name in MOVES}
STEP: Final = 0.03
OUTLINES: Final = {"type": "direct_projective", "guiding": "none", "sppc": 0, "sppp": 64, "sppi": 0}


def glow(*colour: float) -> dict[str, Any]:
    """What shines alike in every direction, so that nothing but outlines and crossings has a gradient."""
    return {"type": "area", "radiance": {"type": "rgb", "value": list(colour)}}


def ball(x: float, y: float, z: float, radius: float, **look: Any) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, y, z], "radius": radius, **look}


def glowing_scene(**shapes: Any) -> dict[str, Any]:
    """Shapes over a floor without end, all of which shine."""
    scene = shadow_scene(integrator={"type": "path", "max_depth": 2}, **shapes)
    for name in {"ball", "lamp"} - set(shapes):
        del scene[name]
    scene["floor"] = {
        "type": "rectangle",
        "to_world": PLACE().rotate([1, 0, 0], -90).scale(400),
        "emitter": glow(0.3, 0.3, 0.3),
    }
    return scene


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


def bump() -> Host:
    """A weight on one side of the block."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    weight = np.exp(-((columns - 0.42 * WIDTH) ** 2 + (rows - 0.55 * HEIGHT) ** 2) / (0.01 * WIDTH * WIDTH))
    return np.asarray(weight[..., None] * np.array([1.0, 0.5, -0.5]), dtype=np.float32)


def slopes(scene: dict[str, Any], moves: dict[str, Any] = MOVES) -> Host:
    """By central differences of images, in the order of the parameters."""
    images = MitsubaRenderer(scene, moves, integrator="scene", spp=256, without_gradient=moves)
    at, weight = {name: AT[name] for name in moves}, bump().astype(np.float64)

    def side(name: str, by: float) -> float:
        return float(np.sum(images.render(at | {name: at[name] + np.float32(by)}) * weight))

    return np.array([(side(name, STEP) - side(name, -STEP)) / (2.0 * STEP) for name in moves])


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
    scene = scene_of(kind, tmp_path)
    renderer = MitsubaRenderer(scene, MOVES, integrator=OUTLINES)
    drawn = np.array([list(renderer.pull(AT, bump(), seed=seed).values()) for seed in range(6)], dtype=np.float64)
    error = np.std(drawn, axis=0, ddof=1) / np.sqrt(len(drawn))
    wanted = slopes(scene)
    off = np.abs(np.mean(drawn, axis=0) - wanted)
    np.testing.assert_array_less(off, 0.03 * np.max(np.abs(wanted)) + 4.0 * error)


@pytest.mark.parametrize("pixels", ["rgb", pytest.param("luminance", marks=thorough)])
def test_what_carries_forward_is_the_transpose_of_what_carries_back(pixels: str) -> None:
    scene = glowing_scene(block=ball(0, 0.2, 0, 1.0, emitter=glow(0.9, 0.2, 0.1)))
    scene["sensor"]["film"]["pixel_format"] = pixels
    renderer = MitsubaRenderer(scene, MOVES, integrator=OUTLINES | {"sppp": 16})
    weight = np.resize(bump(), renderer.render(AT).shape)
    back = renderer.pull(AT, weight, seed=3)
    for name in ("x", "size"):
        along = {other: np.float32(other == name) for other in MOVES}
        forward = np.sum(renderer.push(AT, along, seed=3).astype(np.float64) * weight)
        assert float(back[name]) == pytest.approx(forward, rel=1e-3)


@pytest.mark.parametrize("depth", [0.0, *(pytest.param(one, marks=thorough) for one in (0.002, 0.1))])
def test_a_box_on_a_floor_counts_its_lower_edges_once(depth: float) -> None:
    """Whether it ends on the floor, or goes through it by less or by more than what hides an edge."""
    pose = PLACE().translate([0, 0.7 - depth, 0]) @ BOX
    scene = glowing_scene(block={"type": "cube", "to_world": pose, "emitter": glow(0.9, 0.2, 0.1)})
    sideways = {name: MOVES[name] for name in ("x", "z")}
    with pytest.warns(GradientWarning, match="stores the vertices"):
        renderer = MitsubaRenderer(scene, sideways, integrator=OUTLINES)
    drawn = np.array(
        [
            list(renderer.pull(dict.fromkeys(sideways, np.float32(0.0)), bump(), seed=seed).values())
            for seed in range(6)
        ],
        dtype=np.float64,
    )
    error = np.std(drawn, axis=0, ddof=1) / np.sqrt(len(drawn))
    wanted = slopes(scene, sideways)
    off = np.abs(np.mean(drawn, axis=0) - wanted)
    np.testing.assert_array_less(off, 0.03 * np.max(np.abs(wanted)) + 4.0 * error)


def test_shapes_apart_are_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    def searched(*_: Any) -> None:
        pytest.fail("the image was searched for crossings")

    monkeypatch.setattr(Crossings, "_changes", searched)
    scene = glowing_scene(block=ball(0, 1.5, 0, 1.0, emitter=glow(0.9, 0.2, 0.1)))
    MitsubaRenderer(scene, MOVES, integrator=OUTLINES | {"sppp": 4}).pull(AT, bump())

"""Scenes in which all that has a gradient are outlines, and what that gradient is by differences of images."""

from __future__ import annotations

from typing import Any, Final

import mitsuba as mi
import numpy as np

from loi_mitsuba import MitsubaRenderer, Scale, Translate
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene

PLACE = mi.ScalarTransform4f
MOVES: Final[dict[str, Any]] = {
    "x": Translate("block", (1, 0, 0)),
    "y": Translate("block", (0, 1, 0)),
    "z": Translate("block", (0, 0, 1)),
    "size": Scale("block"),
}
AT: Final[dict[str, Any]] = {name: np.float32(name == "size") for name in MOVES}
STEP: Final = 0.03
DRAWS: Final = 6
OUTLINES: Final = {"type": "direct_projective", "guiding": "none", "sppc": 0, "sppp": 64, "sppi": 0}


def glow(*colour: float) -> dict[str, Any]:
    """What shines alike in every direction, so that nothing but outlines and crossings has a gradient."""
    return {"type": "area", "radiance": {"type": "rgb", "value": list(colour)}}


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


def bump() -> Host:
    """A weight on one side of the block."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    weight = np.exp(-((columns - 0.42 * WIDTH) ** 2 + (rows - 0.55 * HEIGHT) ** 2) / (0.01 * WIDTH * WIDTH))
    return np.asarray(weight[..., None] * np.array([1.0, 0.5, -0.5]), dtype=np.float32)


def check_outlines(scene: dict[str, Any], names: tuple[str, ...] = tuple(MOVES)) -> None:
    """The gradient by how the block moves is that of central differences of images, to 3 % and its noise."""
    moves, at = {name: MOVES[name] for name in names}, {name: AT[name] for name in names}
    renderer = MitsubaRenderer(scene, moves, integrator=OUTLINES)
    drawn = np.array([[float(renderer.vjp(at, bump(), seed=seed)[name]) for name in names] for seed in range(DRAWS)])
    error = np.std(drawn, axis=0, ddof=1) / np.sqrt(DRAWS)
    images = MitsubaRenderer(scene, moves, integrator="scene", spp=256, without_gradient=moves)
    weight = bump().astype(np.float64)

    def side(name: str, by: float) -> float:
        return float(np.sum(images.render(at | {name: at[name] + np.float32(by)}) * weight))

    wanted = np.array([(side(name, STEP) - side(name, -STEP)) / (2.0 * STEP) for name in names])
    off = np.abs(np.mean(drawn, axis=0) - wanted)
    np.testing.assert_array_less(off, 0.03 * np.max(np.abs(wanted)) + 4.0 * error)

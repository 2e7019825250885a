"""Scenes of emitting shapes, whose gradient is due to silhouettes alone, and its check by finite differences."""

from __future__ import annotations

from typing import Any, Final

import mitsuba as mi
import numpy as np

from loi_mitsuba import MitsubaRenderer, Scale, Translate
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene

TRANSFORM = mi.ScalarTransform4f
MOVES: Final[dict[str, Any]] = {
    "x": Translate("block", (1, 0, 0)),
    "y": Translate("block", (0, 1, 0)),
    "z": Translate("block", (0, 0, 1)),
    "size": Scale("block"),
}
START: Final[dict[str, Any]] = {name: np.float32(name == "size") for name in MOVES}
STEP: Final = 0.03
DRAWS: Final = 6
SILHOUETTES: Final = {"type": "direct_projective", "guiding": "none", "sppc": 0, "sppp": 64, "sppi": 0}


def area_light(*colour: float) -> dict[str, Any]:
    """A diffuse emitter: the interior of an emitting shape has no gradient."""
    return {"type": "area", "radiance": {"type": "rgb", "value": list(colour)}}


def emitting_scene(**shapes: Any) -> dict[str, Any]:
    """Shapes over an endless floor that emits light."""
    scene = shadow_scene(integrator={"type": "path", "max_depth": 2}, **shapes)
    for name in {"ball", "lamp"} - set(shapes):
        del scene[name]
    scene["floor"] = {
        "type": "rectangle",
        "to_world": TRANSFORM().rotate([1, 0, 0], -90).scale(400),
        "emitter": area_light(0.3, 0.3, 0.3),
    }
    return scene


def bump() -> Host:
    """A cotangent that is concentrated on one side of the block."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    weight = np.exp(-((columns - 0.42 * WIDTH) ** 2 + (rows - 0.55 * HEIGHT) ** 2) / (0.01 * WIDTH * WIDTH))
    return np.asarray(weight[..., None] * np.array([1.0, 0.5, -0.5]), dtype=np.float32)


def check_silhouettes(scene: dict[str, Any], names: tuple[str, ...] = tuple(MOVES)) -> None:
    """Check the gradient for motions of the block against central differences of images, to 3 % and noise."""
    moves, start = {name: MOVES[name] for name in names}, {name: START[name] for name in names}
    renderer = MitsubaRenderer(scene, moves, integrator=SILHOUETTES)
    draws = np.array([[float(renderer.vjp(start, bump(), seed=seed)[name]) for name in names] for seed in range(DRAWS)])
    error = np.std(draws, axis=0, ddof=1) / np.sqrt(DRAWS)
    images = MitsubaRenderer(scene, moves, integrator="scene", spp=256, without_gradient=moves)
    weight = bump().astype(np.float64)

    def loss(name: str, step: float) -> float:
        return float(np.sum(images.render(start | {name: start[name] + np.float32(step)}) * weight))

    expected = np.array([(loss(name, STEP) - loss(name, -STEP)) / (2.0 * STEP) for name in names])
    deviation = np.abs(np.mean(draws, axis=0) - expected)
    np.testing.assert_array_less(deviation, 0.03 * np.max(np.abs(expected)) + 4.0 * error)

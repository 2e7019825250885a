"""The steps of a fit reuse the kernels of the first steps."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import MitsubaRenderer, PlannedRenderer, Translate
from tests.mitsuba.scenes import random_cotangent, shadow_scene
from tests.strategies import thorough

pytestmark = pytest.mark.usefixtures("kernel_history")

WARM_UP, STEPS = 3, 6

MOVES = {"x": Translate("ball", (1, 0, 0)), "z": Translate("ball", (0, 0, 1))}


def ball(height: float, **properties: Any) -> dict[str, Any]:
    return {"type": "sphere", "to_world": mi.ScalarTransform4f().translate([0, height, 0]).scale(0.6), **properties}


def kernel_misses(renderer: Any) -> list[int]:
    """Return the number of kernels that each of a few steps compiles after the warm-up."""
    start, counts = renderer.parameters(), []
    for step in range(WARM_UP + STEPS):
        params = {name: value + np.float32(0.013 * step) for name, value in start.items()}
        renderer.render_vjp(params, seed=step)[1](random_cotangent(step))
        counts.append(sum(not kernel["cache_hit"] for kernel in dr.kernel_history([dr.KernelType.JIT])))
    return counts[WARM_UP:]


def test_intersection_curves_of_any_length_compile_no_further_kernel() -> None:
    """With the number of points as a literal, a step of a half-sunk ball took 1.4 s, 1.3 s of it for compilation."""
    assert kernel_misses(MitsubaRenderer(shadow_scene(ball=ball(0.3)), MOVES)) == [0] * STEPS


@thorough
@pytest.mark.parametrize(
    ("changes", "moves"),
    [
        ({"ball": ball(1.0)}, MOVES),
        ({"ball": {**ball(0.3), "type": "cube"}}, MOVES),
        ({"ball": ball(0.3), "lamp": {"type": "point", "position": [0, 12, 0], "intensity": 200.0}}, MOVES),
        ({"ball": ball(1.0, bsdf={"type": "dielectric"})}, MOVES),
        ({"ball": ball(1.0)}, {"lamp": Translate("lamp")}),
        ({"ball": ball(0.3)}, {"camera": Translate("sensor"), **MOVES}),
    ],
    ids=["ball", "box", "point light", "glass", "lamp", "camera"],
)
def test_planned_renderers_compile_no_further_kernel(changes: dict[str, Any], moves: dict[str, Any]) -> None:
    assert kernel_misses(PlannedRenderer(shadow_scene(**changes), moves)) == [0] * STEPS


def test_a_shape_is_set_once_per_image_and_twice_per_gradient(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each update costs Mitsuba some forty small kernels, more than a second for 65 shapes on a GPU."""
    scene = shadow_scene(ball=ball(0.3), box={**ball(0.9), "type": "cube"})
    moves = {"ball": Translate("ball", (1, 0, 0)), "box": Translate("box", (1, 0, 0))}
    renderer = MitsubaRenderer(scene, moves)
    start, keys = renderer.parameters(), []
    original = mi.SceneParameters.__setitem__

    def recorded(self: Any, key: str, value: Any) -> None:
        keys.append(key)
        original(self, key, value)

    monkeypatch.setattr(mi.SceneParameters, "__setitem__", recorded)
    _, pullback = renderer.render_vjp(start)
    assert sorted(keys) == ["ball.to_world", "box.vertex_positions"]
    keys.clear()
    pullback(random_cotangent(0))
    assert sorted(keys) == ["ball.to_world"] * 2 + ["box.vertex_positions"] * 2  # attached, and reset

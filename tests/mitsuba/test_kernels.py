"""What is compiled is compiled once: the steps of a fit differ in their numbers, not in their kernels."""

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


def ball(height: float, **more: Any) -> dict[str, Any]:
    return {"type": "sphere", "to_world": mi.ScalarTransform4f().translate([0, height, 0]).scale(0.6), **more}


def compiled(renderer: Any) -> list[int]:
    """How many kernels each of a few steps needs that none before has needed."""
    start, counts = renderer.parameters(), []
    for step in range(WARM_UP + STEPS):
        params = {name: value + np.float32(0.013 * step) for name, value in start.items()}
        renderer.render_vjp(params, seed=step)[1](random_cotangent(step))
        counts.append(sum(not one["cache_hit"] for one in dr.kernel_history([dr.KernelType.JIT])))
    return counts[WARM_UP:]


def test_a_curve_in_which_shapes_cross_is_another_number_of_points_each_time_and_no_other_kernel() -> None:
    """Of a ball half in a floor, a step took 1.4 s, of which 1.3 compiled kernels in which that number was written."""
    assert compiled(MitsubaRenderer(shadow_scene(ball=ball(0.3)), MOVES)) == [0] * STEPS


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
def test_nor_does_any_part_of_a_plan(changes: dict[str, Any], moves: dict[str, Any]) -> None:
    assert compiled(PlannedRenderer(shadow_scene(**changes), moves)) == [0] * STEPS


@pytest.mark.filterwarnings("ignore:mesh 'box' stores the vertices:loi_mitsuba.GradientWarning")
def test_a_shape_is_set_once_for_an_image_and_twice_for_each_part_of_a_gradient_that_it_has_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each time costs Mitsuba some forty small kernels: of 65 shapes, a second and more on a GPU."""
    scene = shadow_scene(ball=ball(0.3), box={**ball(0.9), "type": "cube"})
    moves = {"ball": Translate("ball", (1, 0, 0)), "box": Translate("box", (1, 0, 0))}
    renderer = MitsubaRenderer(scene, moves)
    start, told = renderer.parameters(), []
    plain = mi.SceneParameters.__setitem__

    def counted(self: Any, key: str, value: Any) -> None:
        told.append(key)
        plain(self, key, value)

    monkeypatch.setattr(mi.SceneParameters, "__setitem__", counted)
    _, pullback = renderer.render_vjp(start)
    assert sorted(told) == ["ball.to_world", "box.vertex_positions"]
    told.clear()
    pullback(random_cotangent(0))
    # Of both, all but the outlines that Mitsuba has, which are those of the ball: attached, and set back.
    assert sorted(told) == ["ball.to_world"] * 4 + ["box.vertex_positions"] * 2

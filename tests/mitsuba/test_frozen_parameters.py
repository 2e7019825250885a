"""Parameters of objects out of view are frozen, and released when the objects come into view: small real scenes."""

from __future__ import annotations

import json
import logging
from dataclasses import asdict
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from examples.effects.scenes import SUITE
from loi_core import PixelL2, fit
from loi_mitsuba import PlannedRenderer, Rotate, Translate
from loi_mitsuba.effects.traits import group_by_shape, traits_of
from loi_mitsuba.scene.load import load_scene
from loi_mitsuba.scene.parameters import SceneIndex
from tests.helpers import Host
from tests.mitsuba.scenes import shadow_scene

(INVISIBLE,) = [case for case in SUITE if case.name == "nothing that can be seen"]
DIRECT: dict[str, Any] = {"type": "direct"}  # no bounces: fewer kernels to compile
BALLS: dict[str, Any] = {"ball": Translate("ball"), "behind": Translate("behind")}
NOWHERE = np.zeros(3, np.float32)


def behind_scene() -> dict[str, Any]:
    """A ball in view and one behind the camera."""
    return INVISIBLE.scene(32, 24) | {"integrator": DIRECT}


def two_balls() -> tuple[PlannedRenderer, PixelL2]:
    renderer = PlannedRenderer(behind_scene(), BALLS, spp=16)
    target = renderer.render({"ball": np.array([0.3, 0.2, 0.0]), "behind": NOWHERE}, seed=10**6)
    return renderer, PixelL2(target)


def test_a_fit_does_not_move_an_object_behind_the_camera(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "loi_mitsuba")
    renderer, objective = two_balls()
    result = fit(renderer, objective, steps=12, learning_rate=0.05)
    np.testing.assert_array_equal(result.params["behind"], NOWHERE)
    assert np.any(result.params["ball"] != 0.0)
    assert list(result.plan.frozen) == ["behind"]
    assert f"| {'behind'!r}" in str(result.plan)
    assert asdict(result.plan)["frozen"] == result.plan.frozen  # what --explain --json prints
    assert json.dumps(asdict(result.plan))
    (line,) = [record.getMessage() for record in caplog.records if "frozen" in record.getMessage()]
    assert "'behind' frozen (its gradient " in line
    assert "\n" not in line


def test_a_plan_notes_that_all_parameters_are_frozen() -> None:
    renderer = PlannedRenderer(behind_scene(), dict(INVISIBLE.parameters), spp=16)
    objective = PixelL2(renderer.render(dict(INVISIBLE.truth), seed=10**6))
    result = fit(renderer, objective, steps=12, learning_rate=0.05)
    np.testing.assert_array_equal(result.params["place"], INVISIBLE.start["place"])
    assert any("no optimised parameter has a significant gradient here" in note for note in result.plan.notes)


def test_an_object_that_comes_into_view_is_released_from_the_next_step(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "loi_mitsuba")
    renderer, objective = two_balls()
    out_of_view = {"ball": np.zeros(3), "behind": np.zeros(3)}
    renderer = renderer.start(out_of_view, objective.value_and_grad(renderer.render(out_of_view))[1])
    in_view = {"ball": np.zeros(3), "behind": np.array([1.0, 0.5, -14.0])}
    image, pullback = renderer.render_vjp(in_view, seed=1)
    cotangent = objective.value_and_grad(image)[1]
    assert not np.any(pullback(cotangent)["behind"])
    renderer = renderer.revisit(1, 9, 1.0, in_view, cotangent, seed=1)
    assert not renderer.plan.frozen
    assert np.any(renderer.render_vjp(in_view, seed=1)[1](cotangent)["behind"])
    (line,) = [record.getMessage() for record in caplog.records if "released" in record.getMessage()]
    assert line == "effects, as it comes into view: 'behind' released"


def test_an_occluded_object_is_released_when_its_gradients_agree() -> None:
    """The ball is inside the frustum all the time, at first behind a screen that another parameter moves away."""
    transform = mi.ScalarTransform4f
    scene = behind_scene()
    del scene["behind"]
    scene["screen"] = {"type": "rectangle", "to_world": transform().translate([0, 0, 4])}
    renderer = PlannedRenderer(scene, {"ball": Translate("ball"), "screen": Translate("screen")})
    objective = PixelL2(renderer.render({"ball": np.array([0.5, 0.3, 0]), "screen": np.array([9.0, 0, 0])}, seed=10**6))

    def gradient(screen: float, seed: int) -> Host:
        nonlocal renderer
        params = {"ball": NOWHERE, "screen": np.array([screen, 0, 0])}
        image, pullback = renderer.render_vjp(params, seed=seed)
        cotangent = objective.value_and_grad(image)[1]
        if seed == 0:
            renderer = renderer.start(params, cotangent)
            image, pullback = renderer.render_vjp(params, seed=seed)
        ball: Host = pullback(cotangent)["ball"]
        renderer = renderer.revisit(seed + 1, 25, 1.0 / (seed + 1), params, cotangent, seed=seed)
        return ball

    assert not any(np.any(gradient(0.0, seed)) for seed in range(5))
    assert "ball" in renderer.plan.frozen
    moved = [bool(np.any(gradient(9.0, seed))) for seed in range(5, 25)]
    assert not moved[0]
    assert moved[-1]
    assert moved == sorted(moved)  # a released parameter is not frozen again
    assert "ball" not in renderer.plan.frozen


def test_parameters_that_move_one_shape_are_one_group() -> None:
    targets: dict[str, Any] = {
        "x": Translate("ball", (1, 0, 0)),
        "light": "lamp.emitter.radiance.value",
        "turn": Rotate("ball", (0, 1, 0)),
        "lamp": Translate("lamp"),
    }
    index = SceneIndex(load_scene(shadow_scene()))
    moving = traits_of(index, targets, index.scene.sensors()[0]).moving
    assert group_by_shape(targets, moving) == (("x", "turn"), ("light",), ("lamp",))

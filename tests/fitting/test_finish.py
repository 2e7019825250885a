"""A fit finishes on pixels, once its own objective has placed what there is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core import FarToNear, Free, LogTone, LOIObjective, PixelL2, fit
from loi_core.errors import OptionError, ParameterError
from loi_core.fitting.loop import FitInterruptedError, FitStep
from tests.contents import photograph
from tests.fitting.fits import REFERENCE, SCENE, START, TARGET, Bowl, run
from tests.fitting.test_far_to_near import scene, target_of

SIZE = 24


class Picture:
    """All pixels are free: what nothing has to travel for."""

    def parameters(self) -> dict[str, Any]:
        return {"pixels": np.full((SIZE, SIZE, 3), 0.5)}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return params["pixels"]

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return params["pixels"], lambda gradient: {"pixels": gradient}


def stages_of(result: Any) -> list[int]:
    return [one.stage for one in result.history]


def test_a_texture_ends_nearer_with_a_finish() -> None:
    target = photograph((SIZE, SIZE, 3), np.random.default_rng(5))
    options: dict[str, Any] = {"steps": 300, "optimise": {"pixels": Free(None, 0.0, 1.0, learning_rate=0.02)}}
    alone, finished = (fit(Picture(), LOIObjective(target), finish=finish, **options) for finish in (None, "pixels"))
    assert alone.psnr is not None
    assert finished.psnr is not None
    assert finished.psnr > alone.psnr + 10.0


def test_pixels_come_last_and_are_compared_as_the_objective_is() -> None:
    result = run(120, finish="pixels")
    stages = stages_of(result)
    assert stages == sorted(stages)
    assert set(stages) == {0, 1}
    assert stages.count(1) >= 0.2 * len(stages)
    assert result.best_value == pytest.approx(float(PixelL2(REFERENCE).value(result.image)), abs=1e-15)
    np.testing.assert_allclose(result.best_params["positions"], TARGET, atol=0.01)


def test_weights_tone_and_policy_are_those_of_the_objective() -> None:
    weights = np.ones(REFERENCE.shape[:2])
    weights[:8] = 0.0
    holed = REFERENCE.copy()
    holed[20, 20] = np.nan
    options: dict[str, Any] = {"weights": weights, "tone": LogTone(2.0), "nan_policy": "mask"}
    result = fit(
        SCENE,
        LOIObjective(holed, **options),
        steps=40,
        learning_rate=1.5,
        optimise={"positions": Free(START, 0.0, 32.0)},
        finish="pixels",
    )
    assert result.history[-1].stage > 0
    assert result.best_value == pytest.approx(float(PixelL2(holed, **options).value(result.image)), abs=1e-15)


def test_the_verdict_and_the_search_are_about_the_objective_and_not_about_its_finish() -> None:
    renderer, goal, free = scene()
    objective = LOIObjective(target_of(renderer, goal))
    result = fit(renderer, objective, steps=160, optimise={"translation": free}, finish="pixels")
    start = renderer.render(renderer.parameters() | {"translation": free.initial})
    assert result.diagnosis is not None
    assert result.diagnosis.ok
    left = float(objective.value(result.image)) / float(objective.value(start))
    assert result.diagnosis.left == pytest.approx(left, rel=1e-6)
    assert np.hypot(*(result.best_params["translation"] - goal)) < 0.1


@pytest.mark.parametrize("stop", [5, 30, 55])
def test_a_finish_is_resumed_to_the_bit(stop: int, tmp_path: Path) -> None:
    file = tmp_path / "state.npz"

    def interrupt(step: FitStep, params: Any, image: Any) -> None:
        if step.step == stop:
            raise KeyboardInterrupt

    whole = run(finish="pixels")
    with pytest.raises(FitInterruptedError):
        run(finish="pixels", checkpoint=file, callback=interrupt)
    with pytest.raises(ParameterError, match="stages"):
        run(checkpoint=file, resume=True)
    resumed = run(finish="pixels", checkpoint=file, resume=True)
    assert stages_of(resumed) == stages_of(whole)
    np.testing.assert_array_equal(resumed.best_params["positions"], whole.best_params["positions"])


def test_a_finish_is_never_lost_and_its_rate_falls_alone() -> None:
    schedule = FarToNear(stages=3, steps=100, searches=2, enough=0.1, finish=True)
    seen = []
    for _ in range(100):
        seen.append((schedule.stage, schedule.passed))
        schedule.step(1.0)  # flat, and more than enough
        if schedule.lost:
            assert schedule.stage < 2
            schedule.begin_again()
    assert {stage for stage, _ in seen} == {0, 1, 2}
    assert all(passed == 0.0 for stage, passed in seen if stage < 2)
    last = [passed for stage, passed in seen if stage == 2]
    assert last == sorted(last)
    assert len(last) >= 20
    assert schedule.passed == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("finish", ["pixel", 1, PixelL2(REFERENCE)])
def test_a_finish_that_is_none_is_refused(finish: Any) -> None:
    with pytest.raises(OptionError, match="`finish` must be 'pixels' or None"):
        run(finish=finish)


def test_a_finish_needs_a_reference() -> None:
    class Sum:
        def value(self, image: Any) -> Any:
            return image.sum()

        def value_and_grad(self, image: Any) -> Any:
            return image.sum(), np.ones_like(image)

    with pytest.raises(OptionError, match="`finish` needs an objective that has a reference image, got Sum"):
        fit(Bowl(), Sum(), finish="pixels")


def test_a_texture_that_has_no_finish_is_told_of_it() -> None:
    target = photograph((SIZE, SIZE, 3), np.random.default_rng(8))
    free = {"pixels": Free(None, 0.0, 1.0)}
    for steps in (4, 60):  # too few, and enough
        alone, finished = (
            fit(Picture(), LOIObjective(target), steps=steps, optimise=free, finish=finish)
            for finish in (None, "pixels")
        )
        assert alone.diagnosis is not None
        assert finished.diagnosis is not None
        assert 'finish="pixels"' in alone.diagnosis.advice
        assert "finish" not in finished.diagnosis.advice
    few = run(60)
    assert few.diagnosis.ok
    assert not few.diagnosis.advice

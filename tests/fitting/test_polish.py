"""A polish compares pixels once the main objective has settled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core import Free, LogTone, LOIObjective, PixelL2, fit
from loi_core.errors import OptionError, ParameterError
from loi_core.fitting.loop import FitInterruptedError, FitStep
from loi_core.fitting.schedule import Schedule
from tests.contents import photograph
from tests.fitting.fits import REFERENCE, SCENE, START, TARGET, Bowl, run
from tests.fitting.test_far_to_near import scene, target_of

SIZE = 24


class Picture:
    """A renderer whose pixels are all free."""

    def parameters(self) -> dict[str, Any]:
        return {"pixels": np.full((SIZE, SIZE, 3), 0.5)}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return params["pixels"]

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return params["pixels"], lambda gradient: {"pixels": gradient}


def stages_of(result: Any) -> list[int]:
    return [entry.stage for entry in result.history]


def test_a_polish_raises_the_psnr_of_a_texture() -> None:
    target = photograph((SIZE, SIZE, 3), np.random.default_rng(5))
    options: dict[str, Any] = {"steps": 300, "optimise": {"pixels": Free(None, 0.0, 1.0, learning_rate=0.02)}}
    alone, polished = (fit(Picture(), LOIObjective(target), polish=polish, **options) for polish in (None, "pixels"))
    assert alone.psnr is not None
    assert polished.psnr is not None
    assert polished.psnr > alone.psnr + 10.0


def test_pixels_are_compared_in_the_last_stage() -> None:
    result = run(120, polish="pixels")
    stages = stages_of(result)
    assert stages == sorted(stages)
    assert set(stages) == {0, 1}
    assert stages.count(1) >= 0.2 * len(stages)
    assert result.best_value == pytest.approx(float(PixelL2(REFERENCE).value(result.image)), abs=1e-15)
    np.testing.assert_allclose(result.best_params["positions"], TARGET, atol=0.01)


def test_a_polish_uses_the_weights_tone_and_policy_of_the_objective() -> None:
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
        polish="pixels",
    )
    assert result.history[-1].stage > 0
    assert result.best_value == pytest.approx(float(PixelL2(holed, **options).value(result.image)), abs=1e-15)


def test_the_verdict_judges_the_objective_and_not_its_polish() -> None:
    renderer, goal, free = scene()
    objective = LOIObjective(target_of(renderer, goal))
    result = fit(renderer, objective, steps=160, optimise={"translation": free}, polish="pixels")
    start = renderer.render(renderer.parameters() | {"translation": free.initial})
    assert result.diagnosis is not None
    assert result.diagnosis.ok
    left = float(objective.value(result.image)) / float(objective.value(start))
    assert result.diagnosis.left == pytest.approx(left, rel=1e-6)
    assert np.hypot(*(result.best_params["translation"] - goal)) < 0.1


@pytest.mark.parametrize("stop", [5, 30, 55])
def test_a_polish_is_resumed_to_the_bit(stop: int, tmp_path: Path) -> None:
    file = tmp_path / "state.npz"

    def interrupt(step: FitStep, params: Any, image: Any) -> None:
        if step.step == stop:
            raise KeyboardInterrupt

    whole = run(polish="pixels")
    with pytest.raises(FitInterruptedError):
        run(polish="pixels", checkpoint=file, callback=interrupt)
    with pytest.raises(ParameterError, match="stages"):
        run(checkpoint=file, resume=True)
    resumed = run(polish="pixels", checkpoint=file, resume=True)
    assert stages_of(resumed) == stages_of(whole)
    np.testing.assert_array_equal(resumed.best_params["positions"], whole.best_params["positions"])


def test_a_polish_is_never_stuck_and_its_rate_decays_alone() -> None:
    schedule = Schedule(stages=3, steps=100, restarts=2, noise_floor=0.1, finishes=True)
    progress = []
    for _ in range(100):
        progress.append((schedule.stage, schedule.passed))
        schedule = schedule.after(1.0)  # flat, and above the noise floor
        if schedule.stuck:
            assert schedule.stage < 2
            schedule = schedule.restart()
    assert {stage for stage, _ in progress} == {0, 1, 2}
    assert all(passed == 0.0 for stage, passed in progress if stage < 2)
    last = [passed for stage, passed in progress if stage == 2]
    assert last == sorted(last)
    assert len(last) >= 20
    assert schedule.passed == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("polish", ["pixel", 1, PixelL2(REFERENCE)])
def test_an_invalid_polish_is_refused(polish: Any) -> None:
    with pytest.raises(OptionError, match="`polish` must be 'pixels' or None"):
        run(polish=polish)


def test_a_polish_needs_a_reference() -> None:
    class Sum:
        def value(self, image: Any) -> Any:
            return image.sum()

        def value_and_grad(self, image: Any) -> Any:
            return image.sum(), np.ones_like(image)

    with pytest.raises(OptionError, match="`polish` needs an objective that has a reference image, got Sum"):
        fit(Bowl(), Sum(), polish="pixels")


def test_a_fit_of_a_texture_is_advised_to_polish() -> None:
    target = photograph((SIZE, SIZE, 3), np.random.default_rng(8))
    free = {"pixels": Free(None, 0.0, 1.0)}
    for steps in (4, 60):  # too few, and enough
        alone, polished = (
            fit(Picture(), LOIObjective(target), steps=steps, optimise=free, polish=polish)
            for polish in (None, "pixels")
        )
        assert alone.diagnosis is not None
        assert polished.diagnosis is not None
        assert 'polish="pixels"' in alone.diagnosis.advice
        assert "polish" not in polished.diagnosis.advice
    few = run(60)
    assert few.diagnosis.ok
    assert not few.diagnosis.advice

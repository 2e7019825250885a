"""A fit announces its steps to renderers that depend on them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core import Free, LOIObjective, PixelL2, RendererCapabilities, fit
from loi_core.errors import FitError
from loi_core.fitting.loop import FitInterruptedError, FitStep
from loi_core.renderers import BlurredRenderer
from tests.fitting.fits import REFERENCE, SCALES, SCENE, START, Bowl

FREE = {"positions": Free(START, 0.0, 32.0)}


@dataclass
class Recording(Bowl):
    """A renderer that records the announced steps."""

    xp: Any = np
    start: Any = field(default_factory=lambda: np.zeros((2, 2, 1)))
    calls: list[tuple[int, int, float | None]] = field(default_factory=list)

    @property
    def capabilities(self) -> RendererCapabilities:
        return RendererCapabilities(at_step=self.at_step)

    def at_step(self, step: int, steps: int, value: float | None) -> None:
        self.calls.append((step, steps, value))


def test_a_renderer_receives_the_step_and_the_previous_loss() -> None:
    renderer = Recording()
    result = fit(renderer, PixelL2(np.ones((2, 2, 1))), steps=3, learning_rate=0.1, optimise=["pixels"])
    values = [entry.value for entry in result.history]
    assert renderer.calls == [(0, 3, None), (1, 3, values[0]), (2, 3, values[1])]


def test_a_renderer_of_several_views_receives_each_step_once() -> None:
    renderer, objective = Recording(), PixelL2(np.ones((2, 2, 1)))
    views = {"first": renderer, "second": renderer, "fixed": Bowl()}
    fit(views, dict.fromkeys(views, objective), steps=2, learning_rate=0.1, optimise=["pixels"], views_per_step=1)
    assert [step for step, *_ in renderer.calls] == [0, 1]


def test_rounds_of_successive_halving_are_early_steps_of_the_fit() -> None:
    renderer, objective = Recording(), PixelL2(np.ones((2, 2, 1)))
    fit(renderer, objective, steps=24, optimise={"pixels": Free(None, -1.0, 2.0)}, starts=2, learning_rate=0.1)
    rounds, fit_calls = renderer.calls[:-24], renderer.calls[-24:]
    assert rounds
    assert max(step for step, *_ in rounds) < 4
    assert {steps for _, steps, _ in renderer.calls} == {24}
    assert [step for step, *_ in fit_calls] == list(range(24))


def test_an_error_of_at_step_keeps_the_result() -> None:
    class Refuses(Recording):
        def at_step(self, step: int, steps: int, value: float | None) -> None:
            if step == 2:
                raise RuntimeError

    caught: Any
    with pytest.raises(FitError, match=r"step 2: announcing the step to the renderer failed") as caught:
        fit(Refuses(), PixelL2(np.ones((2, 2, 1))), steps=5, learning_rate=0.1, optimise=["pixels"])
    assert len(caught.value.result.history) == 2


@pytest.mark.parametrize("last", [3, 14, 18])
def test_a_resumed_blurred_fit_equals_an_uninterrupted_one(last: int, tmp_path: Path) -> None:
    """Stop before sigma decreases, when it begins to, and while it decreases."""
    file = tmp_path / "state.npz"
    objective = LOIObjective(REFERENCE, SCALES)

    def go(**options: Any) -> Any:
        blurred = BlurredRenderer(SCENE, 4.0, final_sigma=0.2, names=["positions"])
        return fit(blurred, objective, steps=30, learning_rate=1.5, optimise=FREE, **options)

    def stop(step: FitStep, params: Any, image: Any) -> None:
        if step.step == last:
            raise KeyboardInterrupt

    whole = go()
    with pytest.raises(FitInterruptedError):
        go(checkpoint=file, callback=stop)
    resumed = go(checkpoint=file, resume=True)
    np.testing.assert_array_equal(resumed.params["positions"], whole.params["positions"])
    assert [entry.value for entry in resumed.history] == [entry.value for entry in whole.history]
    assert [entry.gradient_norm for entry in resumed.history] == [entry.gradient_norm for entry in whole.history]

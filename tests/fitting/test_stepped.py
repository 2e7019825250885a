"""A fit tells a renderer that asks for it how far it has come."""

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
class Told(Bowl):
    """Keeps what it is told."""

    xp: Any = np
    start: Any = field(default_factory=lambda: np.zeros((2, 2, 1)))
    said: list[tuple[int, int, float | None]] = field(default_factory=list)

    @property
    def capabilities(self) -> RendererCapabilities:
        return RendererCapabilities(at_step=self.at_step)

    def at_step(self, step: int, steps: int, value: float | None) -> None:
        self.said.append((step, steps, value))


def test_a_renderer_is_told_the_step_and_the_loss_before_it() -> None:
    renderer = Told()
    found = fit(renderer, PixelL2(np.ones((2, 2, 1))), steps=3, learning_rate=0.1, optimise=["pixels"])
    values = [one.value for one in found.history]
    assert renderer.said == [(0, 3, None), (1, 3, values[0]), (2, 3, values[1])]


def test_a_renderer_of_several_views_is_told_once() -> None:
    renderer, objective = Told(), PixelL2(np.ones((2, 2, 1)))
    views = {"one": renderer, "other": renderer, "still": Bowl()}
    fit(views, dict.fromkeys(views, objective), steps=2, learning_rate=0.1, optimise=["pixels"], views_per_step=1)
    assert [step for step, *_ in renderer.said] == [0, 1]


def test_the_laps_of_a_race_are_early_steps_of_the_fit() -> None:
    renderer, objective = Told(), PixelL2(np.ones((2, 2, 1)))
    fit(renderer, objective, steps=24, optimise={"pixels": Free(None, -1.0, 2.0)}, starts=2, learning_rate=0.1)
    laps, rest = renderer.said[:-24], renderer.said[-24:]
    assert laps
    assert max(step for step, *_ in laps) < 4
    assert {steps for _, steps, _ in renderer.said} == {24}
    assert [step for step, *_ in rest] == list(range(24))


def test_what_a_renderer_makes_of_it_may_fail_and_leaves_a_result() -> None:
    class Refuses(Told):
        def at_step(self, step: int, steps: int, value: float | None) -> None:
            if step == 2:
                raise RuntimeError

    caught: Any
    with pytest.raises(FitError, match=r"step 2: announcing the step to the renderer failed") as caught:
        fit(Refuses(), PixelL2(np.ones((2, 2, 1))), steps=5, learning_rate=0.1, optimise=["pixels"])
    assert len(caught.value.result.history) == 2


@pytest.mark.parametrize("last", [3, 14, 18])
def test_a_blurred_fit_that_was_stopped_goes_on_as_if_it_had_not_been(last: int, tmp_path: Path) -> None:
    """Before sigma falls, as it begins to, and while it does."""
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
    assert [one.value for one in resumed.history] == [one.value for one in whole.history]
    assert [one.gradient_norm for one in resumed.history] == [one.gradient_norm for one in whole.history]

"""A fit starts its renderers, and revisits them before every step."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core import Free, LOIObjective, PixelL2, RendererCapabilities, fit
from loi_core.errors import FitError, RendererError
from loi_core.fitting.loop import FitInterruptedError, FitStep
from loi_core.renderers import BlurredRenderer
from tests.fitting.fits import REFERENCE, SCALES, SCENE, START, Bowl

FREE = {"positions": Free(START, 0.0, 32.0)}
TARGET = np.ones((2, 2, 1))


@dataclass
class Recording(Bowl):
    """A renderer that records the calls of its hooks, and of which hooks it is the result."""

    xp: Any = np
    start: Any = field(default_factory=lambda: np.zeros((2, 2, 1)))
    calls: list[tuple[int, int, float | None]] = field(default_factory=list)
    gradients: list[tuple[Any, ...]] = field(default_factory=list)
    hooks: tuple[str, ...] = ()
    rendered_after: list[tuple[str, ...]] = field(default_factory=list)

    @property
    def capabilities(self) -> RendererCapabilities:
        return RendererCapabilities(start=self.begin, revisit=self.revisit)

    def begin(self, params: Any, cotangent: Any, *, optimise: Iterable[str], seed: int = 0) -> Recording:
        self.gradients.append((params, cotangent, seed))
        return replace(self, hooks=(*self.hooks, f"start of {', '.join(optimise)}"))

    def revisit(
        self, step: int, steps: int, value: float | None, params: Any, cotangent: Any, *, seed: int = 0
    ) -> Recording:
        self.calls.append((step, steps, value))
        self.gradients.append((params, cotangent, seed))
        return replace(self, hooks=(*self.hooks, f"revisit {step}"))

    def render_vjp(self, params: Any, *, seed: int = 0) -> Any:
        self.rendered_after.append(self.hooks)
        return super().render_vjp(params, seed=seed)


def test_a_fit_starts_a_renderer_and_revisits_it_before_every_step() -> None:
    renderer = Recording()
    result = fit(renderer, PixelL2(TARGET), steps=3, learning_rate=0.1, optimise=["pixels"], seed=5)
    values = [entry.value for entry in result.history]
    assert renderer.calls == [(0, 3, None), (1, 3, values[0]), (2, 3, values[1])]
    hooks = ("start of pixels", "revisit 0", "revisit 1", "revisit 2")
    assert renderer.rendered_after == [hooks[:2], hooks[:3], hooks]
    assert renderer.hooks == ()


def test_the_hooks_get_the_gradient_of_the_loss_with_respect_to_the_image() -> None:
    renderer, objective = Recording(), PixelL2(TARGET)
    fit(renderer, objective, steps=3, learning_rate=0.1, optimise=["pixels"], seed=5)
    start, before_first, *later = renderer.gradients
    assert before_first == (None, None, 0)
    assert [seed for *_, seed in (start, *later)] == [5, 5, 6]
    for params, cotangent, _ in (start, *later):
        np.testing.assert_array_equal(cotangent, objective.value_and_grad(renderer.render(params))[1])
    np.testing.assert_array_equal(start[0]["pixels"], later[0][0]["pixels"])
    assert np.any(later[0][0]["pixels"] != later[1][0]["pixels"])


def test_a_renderer_of_several_views_receives_each_step_once() -> None:
    renderer, objective = Recording(), PixelL2(TARGET)
    views = {"first": renderer, "second": renderer, "fixed": Bowl()}
    fit(views, dict.fromkeys(views, objective), steps=2, learning_rate=0.1, optimise=["pixels"], views_per_step=1)
    assert [step for step, *_ in renderer.calls] == [0, 1]


def test_a_view_that_a_step_did_not_render_is_revisited_without_a_gradient() -> None:
    views, objective = {"first": Recording(), "second": Recording()}, PixelL2(TARGET)
    fit(views, dict.fromkeys(views, objective), steps=3, learning_rate=0.1, optimise=["pixels"], views_per_step=1)
    for step in (1, 2):
        with_gradient = [view.gradients[1 + step][1] is not None for view in views.values()]
        assert sorted(with_gradient) == [False, True]


def test_rounds_of_successive_halving_are_early_steps_of_the_fit() -> None:
    renderer, objective = Recording(), PixelL2(TARGET)
    fit(renderer, objective, steps=24, optimise={"pixels": Free(None, -1.0, 2.0)}, starts=2, learning_rate=0.1)
    rounds, fit_calls = renderer.calls[:-24], renderer.calls[-24:]
    assert rounds
    assert max(step for step, *_ in rounds) < 4
    assert {steps for _, steps, _ in renderer.calls} == {24}
    assert [step for step, *_ in fit_calls] == list(range(24))
    assert renderer.rendered_after[-24] == ("start of pixels", "revisit 0")  # the rounds leave no trace


def test_an_error_of_revisit_keeps_the_result() -> None:
    class Refuses(Recording):
        def revisit(self, step: int, *arguments: Any, seed: int = 0) -> Recording:
            if step == 2:
                raise RuntimeError
            return self

    caught: Any
    with pytest.raises(FitError, match=r"step 2: revisiting the renderer failed") as caught:
        fit(Refuses(), PixelL2(TARGET), steps=5, learning_rate=0.1, optimise=["pixels"])
    assert len(caught.value.result.history) == 2


def test_a_hook_that_returns_no_renderer_is_refused() -> None:
    class Forgets(Recording):
        def revisit(self, *_: Any, seed: int = 0) -> Any: ...

    with pytest.raises(RendererError, match=r"`revisit` of Forgets must return a renderer, got None"):
        fit(Forgets(), PixelL2(TARGET), steps=5, learning_rate=0.1, optimise=["pixels"])


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

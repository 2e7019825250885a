"""Several views in one fit share parameters and have an image each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core import FitInterruptedError, Free, LOIObjective, PixelL2, fit
from loi_core.errors import FitError, OptionError, RendererError
from loi_core.fitting.history import FitStep
from loi_core.fitting.parameters import bounds_of
from loi_core.fitting.starts import SEARCH_DRAWS, search
from loi_core.fitting.views import Views
from loi_core.renderers import Disks
from tests.helpers import Host
from tests.strategies import thorough

GOAL = np.array([22.0, 9.0, 14.0])
START = np.array([8.0, 23.0, 25.0])


class BallView:
    """A ball viewed along an axis: a disk at its coordinates on the other two axes."""

    def __init__(self, axis: int, size: int = 32, *, exposed: bool = False) -> None:
        self.axes = [k for k in range(3) if k != axis]
        self.disks = Disks(size, size, [[16.0, 16.0]], 5.0, [[0.9, 0.6, 0.1]])
        self.exposed = exposed

    def parameters(self) -> dict[str, Any]:
        gain = {"gain": np.ones(())} if self.exposed else {}
        return {"place": np.full(3, 16.0), **gain}

    def _disk(self, params: dict[str, Any]) -> dict[str, Any]:
        return self.disks.parameters() | {"positions": params["place"][self.axes][None]}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Host:
        image: Host = self.disks.render(self._disk(params)) * params.get("gain", 1.0)
        return image

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        image, pullback = self.disks.render_vjp(self._disk(params))
        gain = params.get("gain", np.ones(()))

        def pull(cotangent: Host) -> dict[str, Any]:
            slope = np.zeros(3)
            slope[self.axes] = pullback(cotangent * gain)["positions"][0]
            gain_slope = {"gain": np.asarray(np.sum(cotangent * image))} if self.exposed else {}
            return {"place": slope, **gain_slope}

        return image * gain, pull


VIEWS: dict[str, Any] = {"front": BallView(0), "side": BallView(1), "top": BallView(2, 40)}
TARGETS = {name: view.render({"place": GOAL}) for name, view in VIEWS.items()}
OBJECTIVES = {name: LOIObjective(target) for name, target in TARGETS.items()}
FREE = {"place": Free(START, 0.0, 32.0)}


def go(views: Any = None, objectives: Any = None, **options: Any) -> Any:
    arguments: dict[str, Any] = {"steps": 100, "optimise": FREE} | options
    return fit(views or VIEWS, objectives or OBJECTIVES, **arguments)


@pytest.mark.parametrize("at_once", [None, 1, pytest.param(2, marks=thorough)])
def test_views_together_find_a_position_that_no_single_view_determines(at_once: int | None) -> None:
    result = go(views_per_step=at_once)
    np.testing.assert_allclose(result.best_params["place"], GOAL, atol=0.05)
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "converged"
    assert set(result.image) == set(VIEWS)
    for name, image in result.image.items():
        np.testing.assert_array_equal(image, VIEWS[name].render(result.best_params))


def test_loss_and_gradient_of_several_views_are_the_mean_over_views() -> None:
    values: list[float] = []
    go(steps=1, stages=None, learning_rate=0.1, callback=lambda step, params, image: values.append(step.value))
    alone = [OBJECTIVES[name].value(VIEWS[name].render({"place": START})) for name in VIEWS]
    assert values == [pytest.approx(float(sum(alone)) / 3.0, rel=1e-14)]
    norms = []
    for name, view in VIEWS.items():
        image, pullback = view.render_vjp({"place": START})
        norms.append(pullback(OBJECTIVES[name].value_and_grad(image)[1])["place"])
    result = go(steps=1, stages=None, learning_rate=0.1)
    assert result.history[0].gradient_norm == pytest.approx(float(np.linalg.norm(sum(norms) / 3.0)), rel=1e-12)


def test_a_single_named_view_gives_the_same_fit_as_an_unnamed_one() -> None:
    alone = fit(VIEWS["front"], OBJECTIVES["front"], steps=30, optimise=FREE)
    named = fit({"front": VIEWS["front"]}, {"front": OBJECTIVES["front"]}, steps=30, optimise=FREE)
    assert [entry.value for entry in named.history] == [entry.value for entry in alone.history]
    np.testing.assert_array_equal(named.image["front"], alone.image)


def test_a_parameter_need_not_be_in_every_view() -> None:
    views = {**VIEWS, "top": BallView(2, 40, exposed=True)}
    targets = {name: view.render({"place": GOAL, "gain": np.asarray(0.7)}) for name, view in views.items()}
    objectives = {name: LOIObjective(target) for name, target in targets.items()}
    free = FREE | {"gain": Free(None, 0.2, 1.5)}
    result = fit(views, objectives, steps=100, optimise=free, views_per_step=1)
    np.testing.assert_allclose(result.best_params["place"], GOAL, atol=0.1)
    assert float(result.best_params["gain"]) == pytest.approx(0.7, abs=0.02)


def test_steps_that_render_some_views_render_all_equally_often_and_not_in_turn() -> None:
    rendered: list[str] = []

    def watch(step: FitStep, params: Any, image: Any) -> None:
        assert len(image) == 1
        rendered.extend(image)

    go(steps=60, views_per_step=1, callback=watch)
    assert {name: rendered.count(name) for name in VIEWS} == dict.fromkeys(VIEWS, 20)
    rounds = {tuple(rendered[k : k + 3]) for k in range(0, 60, 3)}
    assert len(rounds) > 2


@pytest.mark.parametrize(
    ("at_once", "last"),
    [
        pytest.param(None, 37, marks=thorough),
        (1, 37),
        pytest.param(1, 1, marks=thorough),
        pytest.param(2, 0, marks=thorough),
    ],
)
def test_a_resumed_fit_of_views_equals_an_uninterrupted_one(at_once: int | None, last: int, tmp_path: Path) -> None:
    whole, file = go(steps=60, views_per_step=at_once), tmp_path / "state.npz"

    def stop(step: FitStep, params: Any, image: Any) -> None:
        if step.step == last:
            raise KeyboardInterrupt

    with pytest.raises(FitInterruptedError):
        go(steps=60, views_per_step=at_once, checkpoint=file, callback=stop)
    resumed = go(steps=60, views_per_step=at_once, checkpoint=file, resume=True)
    assert [entry.value for entry in resumed.history] == [entry.value for entry in whole.history]
    assert resumed.best_value == whole.best_value
    np.testing.assert_array_equal(resumed.best_params["place"], whole.best_params["place"])


def test_successive_halving_uses_all_views() -> None:
    result = go(steps=60, starts=4, views_per_step=1)
    np.testing.assert_allclose(result.best_params["place"], GOAL, atol=0.2)
    assert result.agreeing is not None


def test_each_view_uses_its_weights() -> None:
    hidden = {
        name: np.where(np.arange(len(target))[:, None] < 4, 0.0, np.ones(len(target)))
        for name, target in TARGETS.items()
    }
    spoilt = {name: np.where(hidden[name][..., None] > 0, target, 7.0) for name, target in TARGETS.items()}
    objectives = {name: LOIObjective(spoilt[name], weights=hidden[name]) for name in VIEWS}
    np.testing.assert_allclose(go(objectives=objectives, steps=60).best_params["place"], GOAL, atol=0.05)


@pytest.mark.parametrize("stop", [12, 21, 30, *(pytest.param(stop, marks=thorough) for stop in (15, 18, 24, 27))])
def test_a_fit_that_a_callback_ends_can_be_resumed_in_any_stage(stop: int, tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    go(steps=40, checkpoint=file, callback=lambda step, params, image: step.step == stop)
    assert len(go(steps=40, checkpoint=file, resume=True).history) == 40


def test_a_view_without_far_scales_does_not_disable_them_for_others() -> None:
    result = go(objectives={**OBJECTIVES, "top": PixelL2(TARGETS["top"])}, steps=40)
    assert {entry.stage for entry in result.history} == {0, 1, 2}


def test_views_that_do_not_divide_are_drawn_without_repeats() -> None:
    views = Views.of(VIEWS, OBJECTIVES, None, 2)
    draws = [views.names_at(step, 0) for step in range(600)]
    assert all(len(set(names)) == 2 for names in draws)
    counts = [sum(name in names for names in draws) for name in VIEWS]
    assert max(counts) - min(counts) < 60  # of 400 each, give or take 12


def test_a_search_skips_points_that_cannot_be_rendered() -> None:
    """A renderer may refuse points within the bounds that a fit would never reach."""
    values: list[float] = []

    def value(params: dict[str, Any]) -> float:
        point = params["place"]
        if point[0] > 24.0:
            msg = "out of the box"
            raise ValueError(msg)
        values.append(float("nan") if point[1] > 24.0 else float(point[2]))
        return values[-1]

    start = {"place": np.full(3, 16.0)}
    best = search(value, start, bounds_of(start, FREE), 0)
    assert best is not None
    assert best[0] == np.nanmin(values)
    assert np.isnan(values).any()
    assert 0 < len(values) < SEARCH_DRAWS


def test_errors_name_the_view() -> None:
    class Broken(BallView):
        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            msg = "no light"
            raise ValueError(msg)

    with pytest.raises(FitError, match="rendering of view 'side' failed: ValueError: no light"):
        go({**VIEWS, "side": Broken(1)}, stages=None, learning_rate=1.0)


def test_values_of_different_views_are_not_compared_with_each_other() -> None:
    """The value of a blind view would always be the minimum."""

    class Blind(BallView):
        def render(self, params: dict[str, Any], *, seed: int = 0) -> Host:
            return np.zeros((32, 32, 3))

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return np.zeros((32, 32, 3)), lambda _: {"place": np.zeros(3)}

    views = {**VIEWS, "blind": Blind(0)}
    objectives = {**OBJECTIVES, "blind": LOIObjective(np.zeros((32, 32, 3)))}
    result = go(views, objectives, views_per_step=1, steps=120)
    np.testing.assert_allclose(result.best_params["place"], GOAL, atol=0.2)


@pytest.mark.parametrize(
    ("views", "objectives", "options", "error", "says"),
    [
        (VIEWS, OBJECTIVES["front"], {}, OptionError, "must have one for each view"),
        (VIEWS, {"front": OBJECTIVES["front"]}, {}, OptionError, r"\['front', 'side', 'top'\], got \['front'\]"),
        (VIEWS, OBJECTIVES, {"views_per_step": 4}, OptionError, "whole number from 1 to 3, the views, got 4"),
        (VIEWS["front"], OBJECTIVES["front"], {"views_per_step": 1}, OptionError, "left out unless .* of views, got 1"),
        ({1: VIEWS["front"]}, {1: OBJECTIVES["front"]}, {}, OptionError, "name its views by non-empty texts"),
        ({}, {}, {}, OptionError, "must have one for each view"),
        (VIEWS["front"], OBJECTIVES, {}, OptionError, "`objective` is a dict, so `renderer` must be one too"),
        (VIEWS, OBJECTIVES, {"stages": [OBJECTIVES["front"]]}, OptionError, "`stages` of several views must be scales"),
    ],
)
def test_invalid_views_are_refused(views: Any, objectives: Any, options: Any, error: Any, says: str) -> None:
    with pytest.raises(error, match=says):
        fit(views, objectives, **({"steps": 2, "learning_rate": 0.1} | options))


def test_a_parameter_of_two_shapes_is_refused() -> None:
    class FlatView(BallView):
        def parameters(self) -> dict[str, Any]:
            return {"place": np.zeros(2)}

    views = {"ball": BallView(0), "flat": FlatView(0)}
    with pytest.raises(RendererError, match=r"'place' has shape \(3,\) in one view, and \(2,\) in 'flat'"):
        Views.of(views, dict.fromkeys(views, PixelL2(TARGETS["front"])), None, 1)

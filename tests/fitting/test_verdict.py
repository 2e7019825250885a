"""What a fit says came of it is what it has seen, and what it hands out is not its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loi_core import FitStep, Free, LOIObjective, PixelL2, ScaleSpace, fit
from loi_core.errors import OptionError
from loi_core.renderers import Disks
from tests.contents import photograph

HEIGHT, WIDTH = 48, 64


def disk(place: tuple[float, float], colour: tuple[float, float, float] = (0.9, 0.5, 0.2)) -> Disks:
    return Disks(HEIGHT, WIDTH, [place], 6.0, [colour])


def seen_by(renderer: Disks) -> Any:
    return renderer.render(renderer.parameters())


class Far:
    """A disk in the middle by its distance: the same step moves its edge far less the farther it is away."""

    def parameters(self) -> dict[str, Any]:
        return {"distance": np.array(20.0)}

    def cover(self, params: dict[str, Any]) -> Any:
        y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
        beyond = (np.hypot(x - WIDTH / 2, y - HEIGHT / 2) - 60.0 / params["distance"]) / 0.7
        return 1.0 / (1.0 + np.exp(np.clip(beyond, -60.0, 60.0)))[..., None]

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return self.cover(params) * np.ones(3)

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        cover, distance = self.cover(params), float(params["distance"])
        slope = cover * (1.0 - cover) * (-60.0 / distance**2) / 0.7
        return self.render(params), lambda given: {"distance": np.array(np.sum(given * slope))}


class OnPicture:
    """A disk before a picture."""

    def __init__(self, place: tuple[float, float]) -> None:
        self.disk = disk(place, (1.0, 1.0, 1.0))
        self.behind = 0.2 + 0.5 * photograph((HEIGHT, WIDTH, 3), np.random.default_rng(1))

    def parameters(self) -> dict[str, Any]:
        return {"positions": self.disk.parameters()["positions"]}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        cover, pullback = self.disk.render_vjp({**self.disk.parameters(), **params}, seed=seed)
        ahead = np.array([0.9, 0.5, 0.2]) - self.behind
        return self.behind + cover * ahead, lambda given: {"positions": pullback(given * ahead)["positions"]}


def test_rates_are_measured_anew_where_the_fit_has_come_to() -> None:
    target = Far().render(Far().parameters())
    found = [
        fit(Far(), LOIObjective(target), steps=steps, optimise={"distance": Free(4.0, 2.0, 30.0)})
        for steps in (200, 800)
    ]
    assert abs(float(found[0].best_params["distance"]) - 20.0) < 2.5
    assert abs(float(found[1].best_params["distance"]) - 20.0) < 0.1


def test_a_difference_that_the_loss_does_not_see_is_not_called_converged() -> None:
    """Differences of colours are 0 in grey images, wherever things are."""
    start, truth = (disk(place, (0.7, 0.7, 0.7)) for place in ((12.0, 12.0), (44.0, 30.0)))
    result = fit(start, LOIObjective(seen_by(truth), colours="differences"), steps=5, optimise=["positions"])
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "no gradient"
    assert "the loss does not see it" in result.diagnosis.message
    same = fit(truth, LOIObjective(seen_by(truth), colours="differences"), steps=5, optimise=["positions"])
    assert same.diagnosis is not None
    assert same.diagnosis.verdict == "converged"


def test_pixels_of_no_weight_may_differ() -> None:
    start, truth = disk((12.0, 12.0)), disk((44.0, 30.0))
    weights = np.zeros((HEIGHT, WIDTH))
    weights[:, :2] = 1.0
    result = fit(start, PixelL2(seen_by(truth), weights=weights), steps=5, optimise=["positions"])
    assert result.diagnosis is not None
    assert "does not see" not in result.diagnosis.message


@pytest.mark.parametrize("gain", [0.3, 0.4])
def test_another_exposure_is_not_taken_for_an_encoding(gain: float) -> None:
    start, truth = OnPicture((12.0, 12.0)), OnPicture((44.0, 30.0))
    result = fit(start, LOIObjective(gain * truth.render(truth.parameters())), steps=20, optimise=["positions"])
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "other range"
    assert "times as bright as the render" in result.diagnosis.message


def test_a_parameter_without_effect_is_named_beside_one_that_is_found() -> None:
    class WithMood(OnPicture):
        def parameters(self) -> dict[str, Any]:
            return super().parameters() | {"mood": np.array(0.5)}

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            image, pullback = super().render_vjp({"positions": params["positions"]}, seed=seed)
            return image, lambda given: {**pullback(given), "mood": np.array(0.0)}

    target = OnPicture((40.0, 20.0)).render({"positions": np.array([[40.0, 20.0]])})
    free = {"positions": Free(lower=0.0, upper=[[WIDTH, HEIGHT]]), "mood": Free(lower=0.0, upper=1.0)}
    result = fit(WithMood((24.0, 30.0)), LOIObjective(target), steps=60, optimise=free)
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "converged"
    assert result.diagnosis.message.endswith(", 'mood' had no gradient and has not moved")


@pytest.mark.parametrize("steps", [1, 3, 8])
def test_a_short_fit_does_not_say_that_its_loss_no_longer_falls(steps: int) -> None:
    start, truth = disk((12.0, 12.0)), disk((44.0, 30.0))
    result = fit(start, LOIObjective(seen_by(truth)), steps=steps, learning_rate="0.1 px", optimise=["positions"])
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "still falling"


def test_a_callback_may_write_to_what_it_is_given() -> None:
    start, truth = disk((12.0, 12.0)), disk((30.0, 24.0))

    def spoil(_: FitStep, params: Any, image: Any) -> None:
        params["positions"][...] = 0.0
        image[...] = np.nan

    objective = LOIObjective(seen_by(truth))
    free = {"positions": Free(None, 0.0, 64.0)}
    plain, spoilt = (fit(start, objective, steps=30, optimise=free, callback=one) for one in (None, spoil))
    np.testing.assert_array_equal(spoilt.best_params["positions"], plain.best_params["positions"])
    np.testing.assert_array_equal(spoilt.image, plain.image)


@pytest.mark.parametrize("objective", [None, LOIObjective, np.zeros((HEIGHT, WIDTH, 3)), ScaleSpace(1, 3, 0.1)])
def test_what_is_no_objective_is_refused_before_the_first_step(objective: Any) -> None:
    with pytest.raises(OptionError, match=r"`objective` must be an Objective, such as LOIObjective\(photograph\)"):
        fit(disk((12.0, 12.0)), objective, steps=3)

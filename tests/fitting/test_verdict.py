"""The verdict of a fit agrees with the loss, the images and the parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loi_core import FitStep, Free, LOIObjective, PixelL2, ScaleSpace, fit
from loi_core.errors import OptionError
from loi_core.renderers import Disks
from tests.contents import photograph
from tests.strategies import thorough

HEIGHT, WIDTH = 48, 64


def disk(centre: tuple[float, float], colour: tuple[float, float, float] = (0.9, 0.5, 0.2)) -> Disks:
    return Disks(HEIGHT, WIDTH, [centre], 6.0, [colour])


def image_of(renderer: Disks) -> Any:
    return renderer.render(renderer.parameters())


class Far:
    """A disk in the middle, parametrised by its distance; a step moves its edge less at larger distances."""

    def parameters(self) -> dict[str, Any]:
        return {"distance": np.array(20.0)}

    def cover(self, params: dict[str, Any]) -> Any:
        y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
        distance_px = (np.hypot(x - WIDTH / 2, y - HEIGHT / 2) - 60.0 / params["distance"]) / 0.7
        return 1.0 / (1.0 + np.exp(np.clip(distance_px, -60.0, 60.0)))[..., None]

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return self.cover(params) * np.ones(3)

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        cover, distance = self.cover(params), float(params["distance"])
        slope = cover * (1.0 - cover) * (-60.0 / distance**2) / 0.7
        return self.render(params), lambda cotangent: {"distance": np.array(np.sum(cotangent * slope))}


class OnPicture:
    """A disk in front of a picture."""

    def __init__(self, centre: tuple[float, float]) -> None:
        self.disk = disk(centre, (1.0, 1.0, 1.0))
        self.background = 0.2 + 0.5 * photograph((HEIGHT, WIDTH, 3), np.random.default_rng(1))

    def parameters(self) -> dict[str, Any]:
        return {"positions": self.disk.parameters()["positions"]}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        cover, pullback = self.disk.render_vjp({**self.disk.parameters(), **params}, seed=seed)
        contrast = np.array([0.9, 0.5, 0.2]) - self.background
        return self.background + cover * contrast, lambda cotangent: {
            "positions": pullback(cotangent * contrast)["positions"]
        }


@pytest.mark.parametrize(("steps", "error"), [(200, 2.5), pytest.param(800, 0.1, marks=thorough)])
def test_rates_are_measured_anew_at_the_main_stage(steps: int, error: float) -> None:
    target = Far().render(Far().parameters())
    result = fit(Far(), LOIObjective(target), steps=steps, optimise={"distance": Free(4.0, 2.0, 30.0)})
    assert abs(float(result.best_params["distance"]) - 20.0) < error


def test_a_difference_that_the_loss_ignores_is_not_called_converged() -> None:
    """Differences of colours are 0 in any grey image."""
    start, truth = (disk(centre, (0.7, 0.7, 0.7)) for centre in ((12.0, 12.0), (44.0, 30.0)))
    result = fit(start, LOIObjective(image_of(truth), colours="differences"), steps=5, optimise=["positions"])
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "no gradient"
    assert "the loss does not see it" in result.diagnosis.message
    same = fit(truth, LOIObjective(image_of(truth), colours="differences"), steps=5, optimise=["positions"])
    assert same.diagnosis is not None
    assert same.diagnosis.verdict == "converged"


def test_pixels_without_weight_may_differ() -> None:
    start, truth = disk((12.0, 12.0)), disk((44.0, 30.0))
    weights = np.zeros((HEIGHT, WIDTH))
    weights[:, :2] = 1.0
    result = fit(start, PixelL2(image_of(truth), weights=weights), steps=5, optimise=["positions"])
    assert result.diagnosis is not None
    assert "does not see" not in result.diagnosis.message


@pytest.mark.parametrize("gain", [0.3, 0.4])
def test_another_exposure_is_not_mistaken_for_an_encoding(gain: float) -> None:
    start, truth = OnPicture((12.0, 12.0)), OnPicture((44.0, 30.0))
    result = fit(start, LOIObjective(gain * truth.render(truth.parameters())), steps=3, optimise=["positions"])
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "other range"
    assert "times as bright as the render" in result.diagnosis.message


def test_a_parameter_without_effect_is_named_in_a_converged_verdict() -> None:
    class WithMood(OnPicture):
        def parameters(self) -> dict[str, Any]:
            return super().parameters() | {"mood": np.array(0.5)}

        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            image, pullback = super().render_vjp({"positions": params["positions"]}, seed=seed)
            return image, lambda cotangent: {**pullback(cotangent), "mood": np.array(0.0)}

    target = OnPicture((40.0, 20.0)).render({"positions": np.array([[40.0, 20.0]])})
    free = {"positions": Free(lower=0.0, upper=[[WIDTH, HEIGHT]]), "mood": Free(lower=0.0, upper=1.0)}
    result = fit(WithMood((24.0, 30.0)), LOIObjective(target), steps=60, optimise=free)
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "converged"
    assert result.diagnosis.message.endswith(", 'mood' leaves no trace in the image")


@pytest.mark.parametrize("steps", [1, 3, 8])
def test_a_short_fit_is_not_called_stalled(steps: int) -> None:
    start, truth = disk((12.0, 12.0)), disk((44.0, 30.0))
    result = fit(start, LOIObjective(image_of(truth)), steps=steps, learning_rate="0.1 px", optimise=["positions"])
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "still falling"


def test_a_callback_may_modify_its_arguments() -> None:
    start, truth = disk((12.0, 12.0)), disk((30.0, 24.0))

    def spoil(_: FitStep, params: Any, image: Any) -> None:
        params["positions"][...] = 0.0
        image[...] = np.nan

    objective = LOIObjective(image_of(truth))
    free = {"positions": Free(None, 0.0, 64.0)}
    plain, spoilt = (fit(start, objective, steps=30, optimise=free, callback=callback) for callback in (None, spoil))
    np.testing.assert_array_equal(spoilt.best_params["positions"], plain.best_params["positions"])
    np.testing.assert_array_equal(spoilt.image, plain.image)


@pytest.mark.parametrize("objective", [None, LOIObjective, np.zeros((HEIGHT, WIDTH, 3)), ScaleSpace(1, 3, 0.1)])
def test_an_invalid_objective_is_refused_before_the_first_step(objective: Any) -> None:
    with pytest.raises(OptionError, match=r"`objective` must be an Objective, such as LOIObjective\(photograph\)"):
        fit(disk((12.0, 12.0)), objective, steps=3)

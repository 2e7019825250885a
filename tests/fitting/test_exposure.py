"""Fits to photographs whose exposure is not the render's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from loi_core import Free, LOIObjective, fit
from loi_core.errors import OptionError
from loi_core.fitting.exposure import exposure_is_free
from loi_core.fitting.parameters import bounds_of
from loi_core.fitting.stages import staged_objectives
from loi_core.fitting.views import Views
from loi_core.objectives import PixelL2
from loi_core.renderers import Disks, Warp
from tests.contents import photograph
from tests.helpers import Host
from tests.strategies import thorough

GOAL = np.array([[52.0, 20.0], [20.0, 50.0]])
START = np.array([[24.0, 40.0], [58.0, 30.0]])
DISKS = Disks(64, 80, START, radii=[7.0, 6.0], colours=[[0.9, 0.6, 0.2], [0.2, 0.7, 0.9]], background=[0.35] * 3)
PLACES = {"positions": Free(START, 0.0, [80.0, 64.0])}
TARGET: Host = DISKS.render({**DISKS.parameters(), "positions": GOAL})


@pytest.mark.parametrize(
    ("gain", "offset", "exposure"),
    [
        (0.9, 0.0, "given"),
        (0.7, 0.2, "matched"),
        pytest.param(0.97, 0.0, "given", marks=thorough),
        pytest.param(0.97, 0.0, "matched", marks=thorough),
        pytest.param(0.9, 0.0, "matched", marks=thorough),
        pytest.param(0.7, 0.2, "given", marks=thorough),
    ],
)
def test_a_fit_finds_disks_in_a_photograph_of_another_exposure(gain: float, offset: float, exposure: Any) -> None:
    objective = LOIObjective(gain * TARGET + offset, exposure=exposure)
    result = fit(DISKS, objective, steps=120, optimise=PLACES)
    np.testing.assert_allclose(result.best_params["positions"], GOAL, atol=0.1)


def test_the_automatic_stages_end_with_the_objective_and_detect_an_exposure() -> None:
    objective = LOIObjective(TARGET)
    staged = staged_objectives(objective, "auto", None)
    assert isinstance(staged.finish, LOIObjective)
    assert staged.finish.scales == objective.scales
    image = DISKS.render({**DISKS.parameters(), "positions": GOAL + 0.1})
    assert float(staged.finish.value(image)) == float(objective.value(image))
    assert float(staged.finish.value(0.9 * TARGET)) < 0.01 * float(objective.value(0.9 * TARGET))
    assert isinstance(staged.main, LOIObjective)
    assert (staged.main.scales, staged.main.exposure) == (replace(objective.scales, centred=True), "matched")
    assert [entry.exposure for entry in staged.far if isinstance(entry, LOIObjective)] == ["matched"]


def test_a_matched_exposure_is_regressed_in_the_main_stage_and_in_a_polish() -> None:
    staged = staged_objectives(LOIObjective(TARGET, exposure="matched"), "auto", "pixels")
    assert isinstance(staged.main, LOIObjective)
    assert isinstance(staged.finish, PixelL2)
    assert (staged.main.exposure, staged.finish.exposure) == ("regressed", "regressed")


def picture() -> Warp:
    return Warp(photograph((40, 40, 3), np.random.default_rng(2)), np.full((40, 40, 3), 0.3), scale=0.5)


@pytest.mark.parametrize(
    ("name", "is_free"), [("exposure", True), ("translation", False), ("rotation", False), ("scale", False)]
)
def test_only_a_brightness_is_taken_for_an_exposure(name: str, is_free: bool) -> None:
    warp = picture()
    views = Views.of(warp, LOIObjective(warp.render(warp.parameters())), "auto", None)
    params = warp.parameters()
    assert exposure_is_free(views, params, bounds_of(params, {name: Free()}), 0) == is_free


class Dimmed:
    """Two numbers in one array: the place of a disk, and the brightness of the image."""

    def parameters(self) -> dict[str, Any]:
        return {"x, brightness": np.array([30.0, 1.0])}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        x, brightness = params["x, brightness"]
        return brightness * DISKS.render({**DISKS.parameters(), "positions": np.array([[x, 30.0], [60.0, 50.0]])})

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        raise NotImplementedError


@pytest.mark.parametrize(("upper", "is_free"), [([80.0, 1.0], False), ([80.0, 2.0], True)])
def test_each_entry_of_an_array_may_be_a_brightness(upper: list[float], is_free: bool) -> None:
    scene = Dimmed()
    views = Views.of(scene, LOIObjective(scene.render(scene.parameters())), "auto", None)
    bounds = bounds_of(scene.parameters(), {"x, brightness": Free(None, [0.0, 1.0], upper)})
    assert exposure_is_free(views, scene.parameters(), bounds, 0) == is_free


def test_a_uniform_colour_is_compared_from_the_first_step() -> None:
    disks = Disks(24, 24, [[12.0, 12.0]], radii=5.0, colours=[[0.5] * 3], background=[0.2] * 3)
    objective = LOIObjective(disks.render({**disks.parameters(), "colours": np.array([[0.9, 0.3, 0.4]])}))
    result = fit(disks, objective, steps=60, optimise={"colours": Free(None, 0.0, 1.0)})
    np.testing.assert_allclose(result.best_params["colours"], [[0.9, 0.3, 0.4]], atol=0.02)


def test_a_brightness_alone_is_refused_under_a_matched_exposure() -> None:
    warp = picture()
    objective = LOIObjective(0.8 * warp.render(warp.parameters()), exposure="matched")
    with pytest.raises(OptionError, match="`exposure` of the objective must be 'given' to fit 'exposure'"):
        fit(warp, objective, steps=5, optimise={"exposure": Free(None, -2.0, 2.0)})


@pytest.mark.parametrize("exposure", ["given", "matched"])
def test_a_start_at_the_truth_stays_there(exposure: Any) -> None:
    free = {"positions": Free(GOAL, 0.0, [80.0, 64.0])}
    result = fit(DISKS, LOIObjective(TARGET, exposure=exposure), steps=30, optimise=free)
    np.testing.assert_allclose(result.best_params["positions"], GOAL, atol=0.05)


def test_the_result_and_the_verdict_name_the_exposure_of_a_photograph() -> None:
    result = fit(DISKS, LOIObjective(0.9 * TARGET + 0.03), steps=120, optimise=PLACES)
    np.testing.assert_allclose(result.exposure.gain, 0.9, atol=0.05)
    np.testing.assert_allclose(result.exposure.offset, 0.03, atol=0.03)
    assert result.diagnosis is not None
    assert result.diagnosis.ok
    assert "the target is about 0.9" in result.diagnosis.message


def test_the_verdict_on_a_noisy_render_of_another_exposure_allows_for_its_noise() -> None:
    """The noise is a larger share of the loss without the exposure than of the loss with it."""

    class Noisy(Disks):
        def render(self, params: Any, *, seed: int = 0) -> Host:
            image: Host = super().render(params, seed=seed)
            return image + 0.05 * np.random.default_rng(seed).standard_normal(image.shape)

    scene = Noisy(64, 80, GOAL, radii=[7.0, 6.0], colours=[[0.9, 0.6, 0.2], [0.2, 0.7, 0.9]], background=[0.35] * 3)
    free = {"positions": Free(GOAL + 12.0, 0.0, [80.0, 80.0])}
    result = fit(scene, LOIObjective(0.9 * TARGET), steps=100, optimise=free)
    assert result.diagnosis is not None
    assert result.diagnosis.ok

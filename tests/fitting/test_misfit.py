"""The misfit of a fit, and the verdict on fits to photographs that no renderer reproduces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from loi_core import Free, LOIObjective, fit
from loi_core.fitting.misfit import Misfit, measure_misfit
from loi_core.fitting.parameters import bounds_of
from loi_core.fitting.views import Views
from loi_core.renderers import Disks, Warp
from tests.contents import photograph
from tests.helpers import Host

RNG = np.random.default_rng(3)
SCENE = Warp(photograph((20, 20, 3), RNG), np.full((48, 64, 3), 0.35))
GOAL = np.array([-8.0, 5.0])
FREE = {"translation": Free(np.array([12.0, -6.0]), [-20.0, -14.0], [20.0, 14.0])}


def at(place: Any) -> dict[str, Any]:
    return SCENE.parameters() | {"translation": np.asarray(place)}


def photographed(*, noise: float = 0.0, blur: float = 0.0, gain: float = 1.0) -> Host:
    image = gain * gaussian_filter(SCENE.render(at(GOAL)), (blur, blur, 0.0))
    return image + noise * np.random.default_rng(1).standard_normal(image.shape)


def misfit_at(place: Any, target: Host) -> Misfit | None:
    views = Views.of(SCENE, LOIObjective(target), "auto", None)
    return measure_misfit(views, at(place), bounds_of(at(place), FREE), 0)


def test_the_misfit_vanishes_at_the_truth() -> None:
    misfit = misfit_at(GOAL, photographed())
    assert misfit is not None
    assert (misfit.unexplained, misfit.motion) == pytest.approx((0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("offset", [(0.4, 0.0), (0.0, -0.3)])
def test_the_misfit_estimates_a_small_displacement(offset: tuple[float, float]) -> None:
    misfit = misfit_at(GOAL + offset, photographed(noise=0.01))
    assert misfit is not None
    assert misfit.motion == pytest.approx(max(map(abs, offset)), rel=0.25)


@pytest.mark.parametrize("place", [(12.0, -6.0), (-8.0, -10.0), (0.0, 0.0)])
def test_a_wrong_place_explains_little_of_the_contrast(place: tuple[float, float]) -> None:
    misfit = misfit_at(place, photographed(noise=0.02, blur=1.0, gain=0.9))
    assert misfit is not None
    assert misfit.unexplained > 0.5


def test_a_misfit_needs_parameters_that_move_pixels() -> None:
    hidden = replace(FREE["translation"], initial=np.array([200.0, 200.0]), lower=150.0, upper=250.0)
    params = at(hidden.initial)
    views = Views.of(SCENE, LOIObjective(photographed()), "auto", None)
    assert measure_misfit(views, params, bounds_of(params, {"translation": hidden}), 0) is None


def test_a_fit_to_a_noisy_blurred_photograph_has_converged() -> None:
    result = fit(SCENE, LOIObjective(photographed(noise=0.02, blur=1.0, gain=0.95)), steps=100, optimise=FREE)
    np.testing.assert_allclose(result.best_params["translation"], GOAL, atol=0.5)
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "converged"
    assert "of the contrast in the pixels that move" in result.diagnosis.message


def test_a_fit_that_may_not_reach_the_target_has_not_converged() -> None:
    free = {"translation": Free(np.array([12.0, -6.0]), [4.0, -14.0], [20.0, 14.0])}
    result = fit(SCENE, LOIObjective(photographed(noise=0.02, blur=1.0)), steps=40, optimise=free)
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "at a bound"


def test_the_misfit_names_the_coordinates_of_a_disk_out_of_view() -> None:
    disks = Disks(32, 40, [[15.0, 16.0], [300.0, 16.0]], radii=[5.0, 5.0], colours=[[0.9, 0.5, 0.2]] * 2)
    params = disks.parameters()
    free = {"positions": Free(None, 0.0, 400.0)}
    views = Views.of(disks, LOIObjective(disks.render(params)), "auto", None)
    misfit = measure_misfit(views, params, bounds_of(params, free), 0)
    assert misfit is not None
    assert misfit.inert == ("positions[1, 0]", "positions[1, 1]")

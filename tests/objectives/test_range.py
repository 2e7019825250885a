"""Intensities beyond the bounds have the gradient of the value, and fits with wider bounds keep their stages."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import Free, LOIObjective, ScaleSpace, fit
from loi_core.objectives import RangeWarning
from loi_core.pixels.tone_curve import LogTone
from loi_core.renderers import Disks
from tests.helpers import Host

RADIANCE = np.linspace(0.0, 3.0, 24 * 32 * 3).reshape(24, 32, 3)
BRIGHT = np.full((24, 32), 1.0)
BRIGHT[8:] = 0.0  # the last two thirds are brighter than 1


def test_a_reference_beyond_the_bounds_raises_a_warning_with_its_range() -> None:
    with pytest.warns(RangeWarning, match=r"67% of the target lies beyond .* \(0, 1\), .* ranges from 0 to 3"):
        LOIObjective(RADIANCE).value(RADIANCE)


@pytest.mark.parametrize(
    "objective",
    [
        LOIObjective(np.where(RADIANCE > 2.5, 50.0, RADIANCE / 3.0)),
        LOIObjective(np.where(RADIANCE > 1.0, np.nextafter(np.float32(1.0), np.float32(2.0)), RADIANCE)),
        LOIObjective(RADIANCE, ScaleSpace.for_image(24, 32, bounds=(0.0, 3.0))),
        LOIObjective(RADIANCE, tone=LogTone(peak=3.0)),
        LOIObjective(RADIANCE, weights=BRIGHT),
    ],
    ids=["highlights", "white but for a rounding", "wider bounds", "a tone curve", "masked"],
)
def test_a_reference_that_is_mostly_within_the_bounds_raises_no_warning(objective: LOIObjective) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        objective.value(np.asarray(objective.reference))


def spot(width: float, light: float) -> Host:
    """Return a picture of a spot with constant light, shape (32, 40, 1), on grey."""
    rows, columns = np.mgrid[:32, :40]
    weights = np.exp(-((rows - 15.3) ** 2 + (columns - 19.6) ** 2) / (2.0 * width**2))
    picture: Host = (0.3 + light * weights / np.sum(weights))[..., None]
    return picture


def slopes(objective: LOIObjective, width: float, light: float, step: float = 1e-4) -> tuple[float, float]:
    """Return the slope of the value along the width of a spot, from its gradient and from central differences."""
    ahead, behind = spot(width + step, light), spot(width - step, light)
    _, gradient = objective.value_and_grad(spot(width, light))
    from_values = float(objective.value(ahead) - objective.value(behind)) / (2.0 * step)
    return float(np.sum(gradient * (ahead - behind))) / (2.0 * step), from_values


@pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")
@given(
    width=st.floats(1.2, 8.0), light=st.floats(1.0, 1e5), bounds=st.sampled_from([(0.0, 1.0), (0.5, 0.9), (-1.0, 2.0)])
)
def test_the_gradient_along_a_blur_of_constant_light_is_the_slope_of_the_value(
    width: float, light: float, bounds: tuple[float, float]
) -> None:
    # Squared differences have no kinks, at which central differences would err.
    objective = LOIObjective(spot(1.0, light), ScaleSpace((0.0, 1.0), (1.0, 9.0), 0.125, bounds, p=0.5))
    gradient, from_values = slopes(objective, width, light)
    assert gradient == pytest.approx(from_values, rel=1e-4, abs=1e-8)


@pytest.mark.parametrize("width", [2.5, 3.0])
def test_the_default_loss_of_a_highlight_has_the_slope_of_its_value(width: float) -> None:
    gradient, from_values = slopes(LOIObjective(spot(1.5, 200.0)), width, 200.0)
    assert gradient == pytest.approx(from_values, rel=1e-5)
    assert gradient > 1e-3


@pytest.mark.parametrize("value", [-0.4, 1.4, 30.0, 2e4])
def test_a_pixel_beyond_the_bounds_has_a_gradient_back_to_the_reference(value: float) -> None:
    reference, image = np.full((6, 6, 1), 0.5), np.full((6, 6, 1), 0.5)
    image[2, 3] = value
    _, gradient = LOIObjective(reference).value_and_grad(image)
    assert np.sign(gradient[2, 3, 0]) == np.sign(value - 0.5)


def test_the_range_of_the_released_convention_ends_at_the_bounds() -> None:
    limits = ScaleSpace.released(1.0, 2.0, 8, 9).intensity_range
    values = np.array([-3.0, 0.25, 5.0])
    np.testing.assert_array_equal(limits.apply(values), [0.0, 0.25, 1.0])
    np.testing.assert_array_equal(limits.pullback(values, np.ones(3)), [0.0, 1.0, 0.0])


def test_a_fit_with_wider_bounds_still_has_its_far_and_near_stages() -> None:
    disks = Disks(48, 48, positions=[[36.0, 30.0]], radii=5.0, colours=[[2.0, 2.0, 2.0]], background=[0.5] * 3)
    target = disks.render(disks.parameters())
    objective = LOIObjective(target, ScaleSpace.for_image(48, 48, bounds=(0.0, 2.0)))
    result = fit(disks, objective, steps=120, optimise={"positions": Free([[12.0, 12.0]], 0.0, 48.0)})
    assert result.history[-1].stage == 2
    assert np.max(np.abs(result.params["positions"] - [[36.0, 30.0]])) < 0.1

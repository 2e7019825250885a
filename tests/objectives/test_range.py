"""A reference that the bounds clip raises one warning, and fits with wider bounds keep their stages."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from loi_core import Free, LOIObjective, ScaleSpace, fit
from loi_core.objectives import RangeWarning
from loi_core.pixels.tone_curve import LogTone
from loi_core.renderers import Disks

RADIANCE = np.linspace(0.0, 3.0, 24 * 32 * 3).reshape(24, 32, 3)
BRIGHT = np.full((24, 32), 1.0)
BRIGHT[8:] = 0.0  # the last two thirds are brighter than 1


def test_a_reference_beyond_the_bounds_raises_a_warning_with_its_range() -> None:
    with pytest.warns(RangeWarning, match=r"67% of the reference lies beyond .* \(0, 1\) .* ranges from 0 to 3"):
        LOIObjective(RADIANCE).value(RADIANCE)


@pytest.mark.parametrize(
    "objective",
    [
        LOIObjective(np.where(RADIANCE > 2.97, 50.0, RADIANCE / 3.0)),
        LOIObjective(np.where(RADIANCE > 1.0, np.nextafter(np.float32(1.0), np.float32(2.0)), RADIANCE)),
        LOIObjective(RADIANCE, ScaleSpace.for_image(24, 32, bounds=(0.0, 3.0))),
        LOIObjective(RADIANCE, tone=LogTone(peak=3.0)),
        LOIObjective(RADIANCE, weights=BRIGHT),
    ],
    ids=["a few highlights", "white but for a rounding", "wider bounds", "a tone curve", "masked"],
)
def test_a_reference_that_is_hardly_clipped_raises_no_warning(objective: LOIObjective) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        objective.value(np.asarray(objective.reference))


def test_a_fit_with_wider_bounds_still_has_its_far_and_near_stages() -> None:
    disks = Disks(48, 48, positions=[[36.0, 30.0]], radii=5.0, colours=[[2.0, 2.0, 2.0]], background=[0.5] * 3)
    target = disks.render(disks.parameters())
    objective = LOIObjective(target, ScaleSpace.for_image(48, 48, bounds=(0.0, 2.0)))
    result = fit(disks, objective, steps=120, optimise={"positions": Free([[12.0, 12.0]], 0.0, 48.0)})
    assert result.history[-1].stage == 1
    assert np.max(np.abs(result.params["positions"] - [[36.0, 30.0]])) < 0.1

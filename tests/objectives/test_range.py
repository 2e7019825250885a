"""A reference that the bounds clip is told of once, and its scales keep their stages with bounds that hold it."""

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


def test_a_reference_beyond_the_bounds_is_told_of_with_its_range() -> None:
    with pytest.warns(RangeWarning, match=r"67% of the reference lies beyond .* \(0, 1\) .* reaches from 0 to 3"):
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
def test_nothing_is_said_where_little_is_lost(objective: LOIObjective) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        objective.value(np.asarray(objective.reference))


def test_a_fit_at_other_bounds_goes_from_far_to_near_as_well() -> None:
    disks = Disks(48, 48, positions=[[36.0, 30.0]], radii=5.0, colours=[[2.0, 2.0, 2.0]], background=[0.5] * 3)
    target = disks.render(disks.parameters())
    objective = LOIObjective(target, ScaleSpace.for_image(48, 48, bounds=(0.0, 2.0)))
    result = fit(disks, objective, steps=120, optimise={"positions": Free([[12.0, 12.0]], 0.0, 48.0)})
    assert result.history[-1].stage == 1
    assert np.max(np.abs(result.params["positions"] - [[36.0, 30.0]])) < 0.1

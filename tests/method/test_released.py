"""The released convention reproduces the numbers of the code that the paper's authors released."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from loi_core import LOIObjective, ScaleSpace
from tests.helpers import relative_error

# Loss and gradient are results of that code in float32; see ScaleSpace.released.
STORED = np.load(Path(__file__).parents[1] / "data" / "released_loss.npz", allow_pickle=False)


@pytest.mark.parametrize("case", ["a", "d"])
def test_released_reproduces_loss_and_gradient(case: str) -> None:
    config = json.loads(str(STORED[f"{case}_config"]))
    scales = ScaleSpace.released(config["sigma"], config["alpha"], config["nb"], config["ks"])
    objective = LOIObjective(STORED[f"{case}_reference"].astype(np.float64), scales)
    value, gradient = objective.value_and_grad(STORED[f"{case}_image"].astype(np.float64))
    assert float(value) == pytest.approx(float(STORED[f"{case}_loss"]), rel=1e-5)
    assert relative_error(gradient, STORED[f"{case}_grad"]) < 1e-3


def test_released_levels_are_the_centres_of_equal_bins() -> None:
    scales = ScaleSpace.released(1, 1, 8, 31)
    edges = np.linspace(-0.5, 1.5, 9)
    np.testing.assert_allclose(scales.levels(0.125), 0.5 * (edges[1:] + edges[:-1]), atol=1e-15)


def test_released_kernels_are_truncated_at_an_odd_number_of_taps() -> None:
    scales = ScaleSpace.released((1, 5), 1, 8, 30)
    assert scales.inner_taps == 21
    assert scales.extent_taps == 31
    assert ScaleSpace.released(0.2, 1, 8, 31).inner_taps == 3


@pytest.mark.parametrize("accuracy", ["exact", "balanced"])
def test_taps_beyond_the_gaussian_change_neither_work_nor_result(accuracy: str) -> None:
    rng = np.random.default_rng(0)
    image, reference = rng.uniform(size=(2, 48, 64, 1))
    results = []
    for taps in (101, 1001):  # a Gaussian ends after 8.6 of its widths, here 43 pixels
        objective = LOIObjective(reference, ScaleSpace.released((1, 5), (1, 5), 8, taps), accuracy)
        results.append((objective.plan().work, *objective.value_and_grad(image)))
    (work, value, gradient), (more_work, long_value, long_gradient) = results
    assert work == more_work
    assert float(value) == float(long_value)
    np.testing.assert_array_equal(gradient, long_gradient)

"""A start near the target ends nearer, in photographs that no renderer reproduces exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from loi_core import Free, LOIObjective, fit
from loi_core.renderers import Warp
from tests.contents import photograph
from tests.helpers import Host
from tests.strategies import thorough

HEIGHT, WIDTH = 48, 64
GOAL = np.array([-8.0, 5.0])
OFFSET = np.array([0.3, -0.4])
SCENES = [
    Warp(photograph((20, 20, 3), np.random.default_rng(3)), np.full((HEIGHT, WIDTH, 3), 0.35)),
    Warp(photograph((24, 24, 3), np.random.default_rng(4)), photograph((HEIGHT, WIDTH, 3), np.random.default_rng(5))),
]


def darker(image: Host) -> Host:
    return 0.9 * image


def noisy(image: Host) -> Host:
    return image + 0.02 * np.random.default_rng(1).standard_normal(image.shape)


def blurred(image: Host) -> Host:
    result: Host = gaussian_filter(image, (1.0, 1.0, 0.0))
    return result


def with_a_hand(image: Host) -> Host:
    covered = image.copy()
    row, column = HEIGHT // 2 + int(GOAL[1]), WIDTH // 2 + int(GOAL[0])
    covered[row : row + 10, column : column + 10] = [0.7, 0.5, 0.4]
    return covered


def error_of(spoiled: Any, scene: Warp, exposure: Any, offset: Host, steps: int = 60) -> float:
    target = spoiled(scene.render(scene.parameters() | {"translation": GOAL}))
    free = {"translation": Free(GOAL + offset, [-20.0, -14.0], [20.0, 14.0])}
    result = fit(scene, LOIObjective(target, exposure=exposure), steps=steps, optimise=free)
    return float(np.hypot(*(np.asarray(result.best_params["translation"]) - GOAL)))


@pytest.mark.parametrize(
    ("spoiled", "scene"),
    [
        (darker, SCENES[0]),
        (with_a_hand, SCENES[0]),
        (noisy, SCENES[1]),
        (blurred, SCENES[1]),
        *(pytest.param(spoiled, SCENES[1], marks=thorough) for spoiled in (darker, with_a_hand)),
        *(pytest.param(spoiled, SCENES[0], marks=thorough) for spoiled in (noisy, blurred)),
    ],
)
def test_a_start_half_a_pixel_off_ends_nearer(spoiled: Any, scene: Warp) -> None:
    assert error_of(spoiled, scene, "given", OFFSET) < 0.48


@pytest.mark.parametrize("spoiled", [darker, noisy])
def test_a_start_half_a_pixel_off_ends_at_the_target_under_a_matched_exposure(spoiled: Any) -> None:
    assert error_of(spoiled, SCENES[1], "matched", OFFSET) < 0.05


@pytest.mark.parametrize("scene", SCENES, ids=["on grey", "on a photograph"])
def test_a_fit_of_few_steps_ends_no_farther_than_a_good_start(scene: Warp) -> None:
    assert error_of(darker, scene, "given", OFFSET, steps=15) < np.hypot(*OFFSET) + 1e-12

"""Tests of the RGBXY baseline: directions of its gradient, the interval between matchings, and its errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from loi_core.errors import ImageError, OptionError
from loi_torch.mesh import Camera, draw, draw_positions, sphere
from loi_torch.rgbxy import RGBXY

VIEW = Camera((0.0, 0.0, 8.0))


def ball_at(x: float, size: int = 16) -> Any:
    """Return a ball at `x`, drawn with two channels of positions, in shape (size, size, 5)."""
    return draw_positions([sphere(centre=(x, 0, 0), subdivisions=2, colours=(0.9, 0.5, 0.2))], VIEW, size, size)


def test_rgbxy_of_a_reference_and_itself_is_zero() -> None:
    objective = RGBXY(ball_at(0.3))
    assert float(objective.value(ball_at(0.3))) < 1e-8


def test_the_rgbxy_gradient_equals_central_differences_with_fixed_matches() -> None:
    objective = RGBXY(ball_at(0.7), interval=10)
    image = ball_at(-0.8)
    value, gradient = objective.value_and_grad(image)
    direction = torch.from_numpy(np.random.default_rng(0).normal(size=image.shape))
    step = 1e-5
    upper, lower = (float(objective.value_and_grad(image + sign * step * direction)[0]) for sign in (1.0, -1.0))
    assert float((gradient * direction).sum()) == pytest.approx((upper - lower) / (2 * step), rel=1e-6)
    assert float(value) == pytest.approx(0.5 * (upper + lower), rel=1e-6)


def test_the_rgbxy_gradient_moves_a_ball_towards_a_reference_without_overlap() -> None:
    """The reference lies at larger x, so every pixel of the ball has a negative gradient with respect to x."""
    image = ball_at(-1.5)
    is_ball = image[..., 0] > 0.5
    for grid in (None, 8):
        gradient = RGBXY(ball_at(1.5), grid=grid).value_and_grad(image)[1]
        assert bool((gradient[..., 3][is_ball] < 0.0).all())


def test_rgbxy_renews_its_matches_after_an_interval_of_evaluations() -> None:
    objective = RGBXY(ball_at(1.5), interval=2)
    initial = float(objective.value_and_grad(ball_at(0.0))[0])
    with_old_matches = float(objective.value_and_grad(ball_at(1.5))[0])
    with_new_matches = float(objective.value_and_grad(ball_at(1.5))[0])
    assert with_old_matches > 0.1 * initial
    assert with_new_matches < 1e-8


@pytest.mark.parametrize(
    ("error", "options", "message"),
    [
        (OptionError, {"grid": 5}, r"`grid` must divide the sides of the image, \(16, 16\), got 5"),
        (OptionError, {"interval": 0}, "`interval` must be a whole number, 1 or more, got 0"),
        (OptionError, {"weight": -1.0}, "`weight` must be a number more than 0, got -1"),
        (ImageError, {"reference": np.zeros((4, 4, 4))}, r"`reference` must have shape \(H, W, 3\) or"),
        (
            ImageError,
            {"reference": np.full((4, 4, 3), np.nan)},
            "`reference` must have finite numbers, got 48 that are not",
        ),
    ],
)
def test_rgbxy_refuses_wrong_arguments(error: type[Exception], options: dict[str, Any], message: str) -> None:
    with pytest.raises(error, match=message):
        RGBXY(**{"reference": ball_at(0.0), **options})


def test_rgbxy_refuses_images_without_positions() -> None:
    flat = draw([sphere(subdivisions=1)], VIEW, 16, 16)
    with pytest.raises(ImageError, match=r"`image` must have shape \(16, 16, 5\), red, green, blue, x and y, got"):
        RGBXY(ball_at(0.0)).value(flat)


def test_rgbxy_refuses_images_with_infinite_pixels() -> None:
    image = ball_at(0.0)
    image[3, 4, 0] = np.inf
    with pytest.raises(ImageError, match="`image` must have finite numbers, got 1 that are not"):
        RGBXY(ball_at(0.0)).value(image)

"""The matching baseline: points are drawn to where they belong, and gradients hold the matches fixed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from loi_core.errors import ImageError, OptionError
from loi_torch.mesh import Camera, draw, draw_positions, sphere
from loi_torch.rgbxy import RGBXY

VIEW = Camera((0.0, 0.0, 8.0))


def places(x: float, side: int = 16) -> Any:
    return draw_positions([sphere(centre=(x, 0, 0), subdivisions=2, colours=(0.9, 0.5, 0.2))], VIEW, side, side)


def test_a_reference_is_at_no_distance_from_itself() -> None:
    objective = RGBXY(places(0.3))
    assert float(objective.value(places(0.3))) < 1e-8


def test_the_gradient_is_that_of_the_distance_to_fixed_matches() -> None:
    objective = RGBXY(places(0.7), interval=10)
    image = places(-0.8)
    value, gradient = objective.value_and_grad(image)
    aside = torch.from_numpy(np.random.default_rng(0).normal(size=image.shape))
    step = 1e-5
    ahead, behind = (float(objective.value_and_grad(image + sign * step * aside)[0]) for sign in (1.0, -1.0))
    assert float((gradient * aside).sum()) == pytest.approx((ahead - behind) / (2 * step), rel=1e-6)
    assert float(value) == pytest.approx(0.5 * (ahead + behind), rel=1e-6)


def test_points_are_drawn_to_where_they_are_in_the_reference() -> None:
    """The ball, which does not overlap its reference, is drawn there: pixels of its own have a gradient in x."""
    image = places(-1.5)
    ball = image[..., 0] > 0.5
    for grid in (None, 8):
        gradient = RGBXY(places(1.5), grid=grid).value_and_grad(image)[1]
        assert bool((gradient[..., 3][ball] < 0.0).all())


def test_matches_are_kept_for_an_interval() -> None:
    objective = RGBXY(places(1.5), interval=2)
    first = float(objective.value_and_grad(places(0.0))[0])
    kept = float(objective.value_and_grad(places(1.5))[0])
    anew = float(objective.value_and_grad(places(1.5))[0])
    assert kept > 0.1 * first
    assert anew < 1e-8


@pytest.mark.parametrize(
    ("error", "options", "says"),
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
def test_wrong_arguments_are_refused(error: type[Exception], options: dict[str, Any], says: str) -> None:
    with pytest.raises(error, match=says):
        RGBXY(**{"reference": places(0.0), **options})


def test_images_without_places_are_refused() -> None:
    flat = draw([sphere(subdivisions=1)], VIEW, 16, 16)
    with pytest.raises(ImageError, match=r"`image` must have shape \(16, 16, 5\), red, green, blue, x and y, got"):
        RGBXY(places(0.0)).value(flat)


def test_images_that_are_not_finite_are_refused() -> None:
    image = places(0.0)
    image[3, 4, 0] = np.inf
    with pytest.raises(ImageError, match="`image` must have finite numbers, got 1 that are not"):
        RGBXY(places(0.0)).value(image)

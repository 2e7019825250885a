"""Differences of colours: their values, their invariance to white light and its shadows, and their pullback."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import LOIObjective, ScaleSpace
from loi_core.errors import OptionError
from loi_core.fitting.stages import staged_objectives
from loi_core.pixels.colours import LARGEST_FACTOR, differences, differences_pullback
from loi_core.testing import check_objective
from tests.frameworks import array_api_strict, jnp, torch
from tests.helpers import Host
from tests.strategies import SEEDS

# Images contain values beyond the bounds, which are not the subject of these tests.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

SCALES = ScaleSpace((0, 1), (1, 5), 0.125)
SHAPES = st.sampled_from([(9, 12, 3), (2, 7, 5, 3)])
EPS = float(np.finfo(np.float64).eps)


def colour_differences(image: Host) -> Host:
    """Return the differences of an image, shape (..., 3), within [0, 1] if the image is."""
    return 0.5 + 0.5 * np.stack([image[..., c] - image[..., (c + 1) % 3] for c in range(3)], axis=-1)


def images(shape: tuple[int, ...], seed: int) -> tuple[Host, Host]:
    first, second = np.random.default_rng(seed).uniform(-0.2, 1.2, (2, *shape))
    return first, second


@given(SEEDS)
def test_the_pullback_is_the_adjoint_and_its_norm_is_the_largest_factor(seed: int) -> None:
    planes, cotangent = np.random.default_rng(seed).normal(size=(2, 6, 4, 5))
    pulled = differences_pullback(cotangent)
    assert np.vdot(differences(planes, 0.0), cotangent) == pytest.approx(np.vdot(planes, pulled), rel=1e-12, abs=1e-12)
    assert np.linalg.norm(pulled) <= LARGEST_FACTOR * np.linalg.norm(cotangent) * (1.0 + 8 * EPS)
    worst = differences_pullback(differences(planes, 0.0))  # without the channels' mean the factor is attained
    assert np.linalg.norm(worst) == pytest.approx(LARGEST_FACTOR * np.linalg.norm(differences(planes, 0.0)))


@pytest.mark.parametrize("library", [torch, jnp, array_api_strict], ids=["torch", "JAX", "strict"])
def test_colour_differences_are_equal_in_every_library(library: Any) -> None:
    planes = np.random.default_rng(0).uniform(size=(6, 4, 5))
    converted = library.asarray(planes)
    for actual, expected in (
        (differences(converted, 0.5), differences(planes, 0.5)),
        (differences_pullback(converted), differences_pullback(planes)),
    ):
        np.testing.assert_allclose(np.asarray(actual), expected, atol=4 * float(np.finfo(expected.dtype).eps))


def test_differences_of_finite_values_are_finite() -> None:
    largest = np.finfo(np.float32).max
    planes = np.array([largest, -largest, 0.0], dtype=np.float32).reshape(3, 1, 1)
    assert np.all(np.isfinite(differences(planes, 0.5)))


@given(SHAPES, SEEDS)
def test_the_colour_objective_equals_the_objective_of_explicit_differences(shape: tuple[int, ...], seed: int) -> None:
    image, reference = images(shape, seed)
    value, gradient = LOIObjective(reference, SCALES, colours="differences").value_and_grad(image)
    plain, slopes = LOIObjective(colour_differences(reference), SCALES).value_and_grad(colour_differences(image))
    expected = 0.5 * np.stack([slopes[..., c] - slopes[..., c - 1] for c in range(3)], axis=-1)
    assert float(value) == pytest.approx(float(plain), rel=1e-12)
    np.testing.assert_allclose(gradient, expected, atol=1e-11 * float(np.abs(expected).max()))


@given(SEEDS)
def test_white_light_on_a_grey_surface_changes_nothing(seed: int) -> None:
    image, reference = images((9, 12, 3), seed)
    light = np.random.default_rng(seed + 1).uniform(-1.0, 1.0, (9, 12, 1))
    objective = LOIObjective(reference, SCALES, colours="differences")
    value, gradient = objective.value_and_grad(image)
    assert float(objective.value(image + light)) == pytest.approx(float(value), rel=1e-9)
    np.testing.assert_allclose(gradient.sum(axis=-1), 0.0, atol=1e-12 * float(np.abs(gradient).max()))
    grey = np.random.default_rng(seed + 2).uniform(size=(9, 12, 1)) * np.ones(3)
    assert float(LOIObjective(grey, SCALES, colours="differences").value(light * np.ones(3))) == 0.0


@pytest.mark.parametrize("option", ["mask", "weights"])
def test_hidden_pixels_change_no_colour_difference(option: str) -> None:
    image, reference = images((9, 12, 3), 5)
    hidden = np.zeros((9, 12), dtype=bool)
    hidden[2:5, 3:8] = True
    options: dict[str, Any] = {"nan_policy": "mask"} if option == "mask" else {"weights": np.where(hidden, 0.0, 1.0)}
    objective = LOIObjective(reference, SCALES, colours="differences", **options)
    first, second = image.copy(), image.copy()
    first[hidden], second[hidden] = (np.nan, np.inf) if option == "mask" else (0.3, [0.9, 0.0, 0.2])
    value, gradient = objective.value_and_grad(first)
    second_value, slopes = objective.value_and_grad(second)
    assert float(value) == float(second_value) > 0.0
    np.testing.assert_array_equal(gradient, slopes)
    assert np.all(gradient[hidden] == 0.0)


def test_the_colour_objective_keeps_the_contract() -> None:
    check_objective(lambda reference: LOIObjective(reference, SCALES, colours="differences"))


@pytest.mark.parametrize("accuracy", ["balanced", "fast"])
@pytest.mark.parametrize("content", ["noise", "stripes"])
def test_the_colour_objective_keeps_its_accuracy(accuracy: str, content: str) -> None:
    rng = np.random.default_rng(0)
    shape, columns = (48, 64, 3), np.arange(64)[None, :, None]
    image, reference = rng.uniform(size=(2, *shape))
    if content == "stripes":
        image, reference = (
            np.broadcast_to(0.5 + 0.4 * np.sin(columns / 3.0 + np.arange(3) + phase), shape) for phase in (0, 1)
        )
    exact = LOIObjective(reference, colours="differences").value_and_grad(image)[1]
    objective = LOIObjective(reference, accuracy=accuracy, colours="differences")
    gradient = objective.value_and_grad(image)[1]
    assert np.linalg.norm(gradient - exact) <= objective.tolerance * np.linalg.norm(exact)


def test_copies_with_other_scales_or_references_keep_the_colours() -> None:
    image, reference = images((9, 12, 3), 4)
    objective = LOIObjective(reference, SCALES, colours="differences")
    assert (
        objective.with_scales(ScaleSpace(1, 2, 0.5)).colours == objective.with_reference(image).colours == "differences"
    )
    assert "colours differences" in repr(objective)
    assert "colours" not in repr(LOIObjective(reference, SCALES))


def test_default_scales_of_differences_have_half_the_beta_and_a_far_stage() -> None:
    reference = np.zeros((48, 64, 3))
    objective = LOIObjective(reference, colours="differences")
    assert objective.scales == replace(LOIObjective(reference).scales, beta=(0.0625,))
    staged = staged_objectives(objective, "auto", None)
    assert isinstance(staged.far[0], LOIObjective)
    assert (staged.far[0].colours, staged.far[0].scales.beta) == ("differences", objective.scales.beta)
    assert isinstance(staged.finish, LOIObjective)
    assert (staged.finish.colours, staged.finish.scales) == ("differences", objective.scales)


@pytest.mark.parametrize(
    ("shape", "axis", "colours", "message"),
    [
        ((8, 8, 1), -1, "differences", "for images of three channels, got images of 1"),
        ((8, 8), None, "differences", "for images of three channels, got images of none"),
        ((8, 8, 3), -1, "opponent", "`colours` must be 'channels' or 'differences', got 'opponent'"),
        ((8, 8, 3), -1, 3, "`colours` must be 'channels' or 'differences', got 3"),
    ],
)
def test_invalid_colours_are_refused(shape: tuple[int, ...], axis: int | None, colours: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        LOIObjective(np.zeros(shape), channel_axis=axis, colours=colours)

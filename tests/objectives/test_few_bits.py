"""Rounding: images of 16 bits, thousands of levels, and bounds far from 0."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

from loi_core import GaussianPyramid, LOIObjective, PixelL2, ScaleSpace, inner_images, isophotes
from loi_core.method.planner import make_plan
from loi_core.method.reference import loss_and_gradient
from loi_core.method.tonal import accumulate
from loi_core.support.arrays import namespace, widened
from tests.frameworks import jnp, torch
from tests.helpers import Host, images

FLOAT32_EPS = float(np.finfo(np.float32).eps)
SCALES = ScaleSpace((0, 2), (1, 6), 0.125)
IMAGE, REFERENCE = images((20, 24, 3), seed=1)


def float32_error(image: Host, reference: Host, scales: ScaleSpace) -> float:
    """Return the relative error of the gradient in float32, in the 1-norm."""
    image, reference = image.astype(np.float32), reference.astype(np.float32)
    expected = loss_and_gradient(image, reference, scales, eps=FLOAT32_EPS)[1]
    gradient = LOIObjective(reference, scales).value_and_grad(image)[1]
    return float(np.abs(gradient - expected).sum() / np.abs(expected).sum())


@pytest.mark.parametrize("make", [LOIObjective, PixelL2, GaussianPyramid])
@pytest.mark.parametrize(
    "rounded",
    [
        lambda: IMAGE.astype(np.float16),
        lambda: torch.tensor(IMAGE).half(),
        lambda: torch.tensor(IMAGE).bfloat16(),
        lambda: jnp.asarray(IMAGE, jnp.bfloat16),
    ],
    ids=["NumPy float16", "torch float16", "torch bfloat16", "JAX bfloat16"],
)
def test_images_of_16_bits_have_the_rounded_results_of_float32(rounded: Any, make: Any) -> None:
    objective, half = make(REFERENCE), rounded()
    single = widened(half)
    value, gradient = objective.value_and_grad(half)
    wide, slopes = objective.value_and_grad(single)
    assert value.dtype == gradient.dtype == objective.value(half).dtype == half.dtype
    xp = namespace(half)
    assert bool(value == xp.astype(xp.asarray(wide), half.dtype))
    assert bool(xp.all(gradient == xp.astype(slopes, half.dtype)))
    assert bool(xp.any(gradient != 0))


def test_each_term_of_a_16_bit_image_is_rounded() -> None:
    terms = LOIObjective(REFERENCE, SCALES).terms(IMAGE.astype(np.float16))
    assert {term.dtype for term in terms.values()} == {np.dtype(np.float16)}


def test_blurs_and_isophotes_of_16_bit_images_are_computed_in_float32() -> None:
    half = IMAGE.astype(np.float16)
    for scale, picture in inner_images(half, SCALES).items():
        assert picture.dtype == np.float16
        expected = inner_images(half.astype(np.float64), SCALES)[scale]
        np.testing.assert_allclose(picture, expected, rtol=2.0**-10, atol=2.0**-24)
    density = isophotes(half, SCALES, sigma=2, beta=0.125)
    assert density.dtype == np.float16
    np.testing.assert_allclose(
        density, isophotes(half.astype(np.float64), SCALES, sigma=2, beta=0.125), rtol=2e-3, atol=1e-6
    )


@pytest.mark.parametrize("beta", [1e-4, 1e-3, 1e-2])
def test_thousands_of_levels_keep_the_gradient_in_float32(beta: float) -> None:
    # If each level were rounded separately, the error would be 13 % at 1e-4; an intensity has the error eps / beta.
    image, reference = IMAGE[:5, :4, :1], REFERENCE[:5, :4, :1]
    assert float32_error(image, reference, ScaleSpace((0, 1), (0, 2), beta)) < FLOAT32_EPS / beta


def test_bounds_far_from_zero_add_no_error_in_float32() -> None:
    # Sixteenths are exact near 0 and near 1000 alike.
    image, reference = np.round(16.0 * IMAGE) / 16.0, np.round(16.0 * REFERENCE) / 16.0
    error_at_zero = float32_error(image, reference, ScaleSpace(2, (1, 6), 0.125))
    error_at_1000 = float32_error(1000.0 + image, 1000.0 + reference, ScaleSpace(2, (1, 6), 0.125, bounds=(1000, 1001)))
    assert error_at_1000 <= 2.0 * error_at_zero + FLOAT32_EPS


@pytest.mark.parametrize("tolerance", [0.0, 1e-2])
def test_planning_ten_thousand_levels_needs_less_than_200_megabytes(tolerance: float) -> None:
    tracemalloc.start()
    make_plan(ScaleSpace(0, 0, 1e-4), 5, 4, tolerance=tolerance, eps=FLOAT32_EPS)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e8  # bytes; a value for each level and each of its intensities would need 3 GB


@pytest.mark.parametrize("accuracy", ["exact", "balanced"])
def test_a_single_level_has_a_value_and_a_gradient(accuracy: str) -> None:
    value, gradient = LOIObjective(REFERENCE, ScaleSpace.released(1, 1, 1, 3), accuracy).value_and_grad(IMAGE)
    assert float(value) > 0.0
    assert np.any(gradient)


@pytest.mark.parametrize("continued", [False, True])
@pytest.mark.parametrize("count", [1, 64, 65, 300])
def test_running_sums_equal_sequential_addition(count: int, continued: bool) -> None:
    stack = np.random.default_rng(count).uniform(size=(count, 3))
    stack[count // 2 :] = 0.0
    start = np.full(3, 0.25) if continued else None
    expected = np.cumsum(stack, axis=0) + (0.25 if continued else 0.0)
    for xp in (np, jnp):
        sums, last = accumulate(xp.asarray(stack), None if start is None else xp.asarray(start))
        np.testing.assert_allclose(sums, expected, rtol=count * 2.3e-16)
        np.testing.assert_array_equal(last, sums[-1])
        # Adding zeros changes no bit.
        assert np.all(np.asarray(sums)[count // 2 :] == np.asarray(sums)[-1])

"""Weights of pixels multiply their contributions, and masks hide pixels."""

from __future__ import annotations

import re
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import MSSSIM, GaussianPyramid, LOIObjective, PixelL2, ScaleSpace
from loi_core.errors import ImageError, ImageTypeError, OptionError
from loi_core.method.reference import loss_and_gradient
from tests.frameworks import array_api_strict, loi_jax, loi_torch, torch
from tests.helpers import Host, directional_difference, images, relative_error, without_numba
from tests.strategies import SEEDS, Problem, max_differences, problems

# Problems are drawn with values beyond the bounds as well.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

IMAGE, REFERENCE = images((24, 19, 3), 1)
WEIGHTS: Host = np.random.default_rng(2).uniform(size=(24, 19))
MASK: Host = WEIGHTS > 0.4
SCALES = ScaleSpace((0, 1), (2, 9), 0.125)
SMOOTH_SCALES = ScaleSpace((1, 4), (2, 9), 0.125, p=0.5)  # a square has no kink that a finite difference could cross
WEIGHTED = (PixelL2, GaussianPyramid, LOIObjective)
WEIGHT_MAPS = {"graded": WEIGHTS, "a mask": MASK.astype(float), "graded and hidden": np.where(MASK, WEIGHTS, 0.0)}


@given(problems(), SEEDS, st.booleans(), st.booleans())
def test_histograms_are_sums_weighted_by_pixel(problem: Problem, seed: int, has_zeros: bool, compiled: bool) -> None:
    image, reference, scales, dtype = problem
    image, reference = image.astype(dtype), reference.astype(dtype)
    weights = np.random.default_rng(seed).uniform(size=image.shape[-3:-1])
    weights = weights / weights.max()
    if has_zeros:
        weights = np.where(weights < 0.5, 0.0, weights)
    objective = LOIObjective(reference, scales, weights=weights)
    if compiled:
        value, gradient = objective.value_and_grad(image)
    else:
        with without_numba():
            value, gradient = objective.value_and_grad(image)
    eps = float(np.finfo(dtype).eps)
    expected, slope = loss_and_gradient(image, reference, scales, eps=eps, weights=weights)
    loss, norm = max_differences(image, reference, scales)
    assert abs(float(value) - expected) <= loss
    assert float(np.abs(gradient - slope).sum()) <= norm


@pytest.mark.parametrize("make", [*WEIGHTED, MSSSIM])
def test_a_mask_hides_pixels_whatever_they_hold(make: Any) -> None:
    objective = make(REFERENCE, weights=MASK)
    value, gradient = objective.value_and_grad(IMAGE)
    with_nan = np.where(MASK[..., None], IMAGE, np.nan)
    masked_value, masked_gradient = objective.value_and_grad(with_nan)
    assert float(value) == float(masked_value)
    assert np.array_equal(gradient, masked_gradient)
    assert np.all(gradient[~MASK] == 0.0)
    assert np.any(gradient[MASK] != 0.0)
    assert float(make(np.where(MASK[..., None], REFERENCE, np.nan), weights=MASK).value(with_nan)) > 0.0


@pytest.mark.parametrize("make", WEIGHTED)
@pytest.mark.parametrize("name", WEIGHT_MAPS)
def test_the_weighted_gradient_is_the_derivative_of_the_weighted_value(make: Any, name: str) -> None:
    objective = make(REFERENCE, weights=WEIGHT_MAPS[name])
    if isinstance(objective, LOIObjective):
        objective = objective.with_scales(SMOOTH_SCALES)
    direction = np.asarray(np.random.default_rng(3).standard_normal(IMAGE.shape))
    slope = float(np.sum(objective.value_and_grad(IMAGE)[1] * direction))
    expected = directional_difference(objective.value, IMAGE, direction, 1e-5)
    assert abs(slope - expected) <= 1e-6 * max(abs(expected), 1e-3)


@pytest.mark.parametrize("make", WEIGHTED)
@pytest.mark.parametrize("factor", [1e-9, 0.5, 1.0, 1e9])
def test_equal_weights_multiply_value_and_gradient(make: Any, factor: float) -> None:
    value, gradient = make(REFERENCE).value_and_grad(IMAGE)
    weighted, slope = make(REFERENCE, weights=np.full((24, 19), factor)).value_and_grad(IMAGE)
    assert float(weighted) == pytest.approx(factor * float(value), rel=1e-12)
    assert relative_error(slope, factor * gradient) <= 1e-12


def test_pixel_l2_is_the_weighted_mean_of_squares() -> None:
    expected = np.mean(WEIGHTS[..., None] * (IMAGE - REFERENCE) ** 2)
    assert float(PixelL2(REFERENCE, weights=WEIGHTS).value(IMAGE)) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("axis", [-1, 0, 1])
def test_weights_have_no_channel_axis_for_any_position_of_the_channels(axis: int) -> None:
    expected, slope = LOIObjective(REFERENCE, SCALES, weights=WEIGHTS).value_and_grad(IMAGE)
    moved = LOIObjective(np.moveaxis(REFERENCE, -1, axis), SCALES, weights=WEIGHTS, channel_axis=axis)
    value, gradient = moved.value_and_grad(np.moveaxis(IMAGE, -1, axis))
    assert float(value) == pytest.approx(float(expected), rel=1e-14)
    assert np.allclose(np.moveaxis(gradient, axis, -1), slope, rtol=0, atol=1e-18)


def test_images_of_a_batch_have_separate_or_shared_weights() -> None:
    batch, references = np.stack([IMAGE, REFERENCE]), np.stack([REFERENCE, IMAGE])
    separate = np.stack([WEIGHTS, MASK.astype(float) * WEIGHTS.max()])
    value = LOIObjective(references, SCALES, weights=separate).value(batch)
    singles = [LOIObjective(references[i], SCALES, weights=separate[i]).value(batch[i]) for i in range(2)]
    assert float(value) == pytest.approx(float(sum(singles)) / 2.0, rel=1e-12)
    value = LOIObjective(references, SCALES, weights=WEIGHTS).value(batch)
    singles = [LOIObjective(references[i], SCALES, weights=WEIGHTS).value(batch[i]) for i in range(2)]
    assert float(value) == pytest.approx(float(sum(singles)) / 2.0, rel=1e-12)


def test_a_copy_with_other_scales_or_another_reference_keeps_the_weights() -> None:
    objective = LOIObjective(REFERENCE, SCALES, weights=WEIGHTS)
    expected = LOIObjective(IMAGE, weights=WEIGHTS).value(REFERENCE)
    copy = objective.with_reference(IMAGE).with_scales(ScaleSpace.for_image(24, 19))
    assert float(copy.value(REFERENCE)) == float(expected)
    assert copy.weights is not None
    assert np.allclose(copy.weights, WEIGHTS, rtol=1e-15)


@pytest.mark.parametrize("name", WEIGHT_MAPS)
@pytest.mark.parametrize("compiled", [True, False])
def test_weights_have_the_same_effect_in_every_library(name: str, compiled: bool) -> None:
    weights = WEIGHT_MAPS[name]
    value, gradient = LOIObjective(REFERENCE, SCALES, weights=weights).value_and_grad(IMAGE)

    def check(loss: Any, slope: Any) -> None:
        assert float(loss) == pytest.approx(float(value), rel=1e-12)
        assert relative_error(np.asarray(slope), gradient) <= 1e-10

    with pytest.MonkeyPatch.context() as patch:
        if not compiled:
            patch.setenv("LOI_COMPILED", "0")
        strict = array_api_strict.asarray(IMAGE)
        objective = LOIObjective(REFERENCE, SCALES, weights=array_api_strict.asarray(weights))
        check(*objective.value_and_grad(strict))
        leaf = torch.tensor(IMAGE, requires_grad=True)
        loss = loi_torch.loi_loss(leaf, REFERENCE, SCALES, weights=torch.tensor(weights))
        loss.backward()
        check(loss.detach(), leaf.grad)


@pytest.mark.parametrize("compiled", ["1", "0"])
def test_weights_apply_to_traced_images(compiled: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from tests.frameworks import jax, jnp

    monkeypatch.setenv("LOI_COMPILED", compiled)
    value, gradient = LOIObjective(REFERENCE, SCALES, weights=MASK).value_and_grad(IMAGE)
    with_inf = jnp.asarray(np.where(MASK[..., None], IMAGE, np.inf))
    loss = partial(loi_jax.loi_loss, scales=SCALES, weights=MASK)
    traced, slope = jax.jit(jax.value_and_grad(loss))(with_inf, REFERENCE)
    assert float(traced) == pytest.approx(float(value), rel=1e-12)
    assert relative_error(np.asarray(slope), gradient) <= 1e-10


@pytest.mark.parametrize(
    ("weights", "error", "message"),
    [
        (np.ones((24, 18)), ImageError, "must have shape (24, 19), one for each pixel"),
        (np.ones((24, 19, 1)), ImageError, "must have shape (24, 19), one for each pixel"),
        (np.zeros((24, 19)), ImageError, "must not all be 0"),
        (np.full((24, 19), -1.0), ImageError, "must be finite and not negative, got -1"),
        (np.full((24, 19), np.nan), ImageError, "must be finite and not negative, got nan"),
        (np.full((24, 19), "a"), ImageTypeError, "must be real numbers"),
        ([[1.0]], ImageTypeError, "must be an array, got list"),
    ],
)
def test_invalid_weights_are_refused(weights: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=re.escape(message)):
        LOIObjective(REFERENCE, weights=weights)


def test_an_objective_that_accepts_only_masks_refuses_weights() -> None:
    with pytest.raises(OptionError, match="`weights` of MSSSIM must be a mask"):
        MSSSIM(REFERENCE, weights=WEIGHTS)

"""A difference of exposure between an image and its reference hardly changes a centred or matched comparison."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import LOIObjective, ScaleSpace
from loi_core.errors import OptionError, ScaleError
from loi_core.method.reference import loss_and_gradient
from loi_core.objectives import PixelL2
from loi_core.pixels.exposure import estimate_exposure
from loi_core.pixels.tone_curve import LogTone
from tests.helpers import Host, images, relative_error, without_numba

GAINS = np.array([0.8, 1.1, 0.9])
OFFSETS = np.array([0.1, -0.05, 0.02])
CENTRED = ScaleSpace((0.0, 2.0), (0.0, 3.0, 30.0), 0.125, centred=True)


def smooth(seed: int, shape: tuple[int, int] = (40, 48)) -> Host:
    """Return a picture of three channels with smooth content."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: shape[0], : shape[1]] / max(shape)
    waves = rng.uniform(2.0, 9.0, (3, 2)), rng.uniform(0.0, 6.0, 3)
    picture: Host = np.stack(
        [0.5 + 0.2 * np.sin(a * rows + b * columns + c) for (a, b), c in zip(*waves, strict=True)], axis=-1
    )
    return picture


@pytest.mark.parametrize("boundary", ["reflect", "zero"])
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("compiled", [False, True])
def test_every_executor_centres_like_the_brute_force_reference(boundary: Any, weighted: bool, compiled: bool) -> None:
    image, reference = images((13, 17, 3), 0)
    weights = np.random.default_rng(1).uniform(0.1, 1.0, (13, 17)) if weighted else None
    if weights is not None:
        weights /= weights.max()
    scales = replace(CENTRED, boundary=boundary)
    expected, slopes = loss_and_gradient(image, reference, scales, weights=weights)
    if compiled:
        value, gradient = LOIObjective(reference, scales, weights=weights).value_and_grad(image)
    else:
        with without_numba():
            value, gradient = LOIObjective(reference, scales, weights=weights).value_and_grad(image)
    assert float(value) == pytest.approx(expected, rel=1e-13)
    assert relative_error(gradient, slopes) < 1e-12


def test_images_that_differ_by_a_constant_are_equal_when_centred() -> None:
    grey, white = np.full((9, 11, 3), 0.4), np.full((9, 11, 3), 0.9)
    value, gradient = LOIObjective(grey, CENTRED).value_and_grad(white)
    assert float(value) == 0.0
    assert not np.any(gradient)
    assert float(LOIObjective(grey).value(white)) > 0.4


def test_an_object_is_pulled_by_a_darker_photograph_when_centred() -> None:
    def disk(column: float) -> Host:
        rows, columns = np.mgrid[:48, :64]
        inside = np.clip(6.5 - np.hypot(rows - 24.0, columns - column), 0.0, 1.0)
        picture: Host = (0.35 + 0.5 * inside)[..., None]
        return picture

    scales = ScaleSpace.for_image(48, 64)
    along = (disk(16.1) - disk(15.9)) / 0.2

    def pull(factor: float, *, centred: bool) -> float:
        objective = LOIObjective(factor * disk(48.0), replace(scales, centred=centred))
        return -float(np.sum(objective.value_and_grad(disk(16.0))[1] * along))

    assert pull(0.9, centred=False) < 0.5 * pull(1.0, centred=False)
    assert pull(0.9, centred=True) > 0.8 * pull(1.0, centred=False)


@pytest.mark.parametrize("exposure", ["matched", "regressed", "detected"])
@pytest.mark.parametrize("make", [LOIObjective, PixelL2])
def test_a_photograph_of_another_exposure_equals_its_render(make: Any, exposure: Any) -> None:
    image = smooth(3)
    photograph = image * GAINS + OFFSETS
    assert float(make(photograph, exposure=exposure).value(image)) < 1e-6
    assert float(make(photograph).value(image)) > 5e-4


@given(st.integers(0, 2**32 - 1), st.sampled_from(["matched", "regressed", "detected"]), st.booleans(), st.booleans())
def test_the_gradient_is_the_gain_times_the_gradient_with_the_exposure_held(
    seed: int, exposure: Any, weighted: bool, batched: bool
) -> None:
    image, reference = images((2, 9, 12, 3) if batched else (9, 12, 3), seed)
    weights = np.random.default_rng(seed).uniform(0.0, 1.0, image.shape[:-1]).round(1) if weighted else None
    if weights is not None:
        weights[..., 0, 0] = 1.0
    value, gradient = LOIObjective(reference, exposure=exposure, weights=weights).value_and_grad(image)
    planes, expected = (np.moveaxis(array, -1, -3).reshape(-1, 9, 12) for array in (image, reference))
    plane_weights = None if weights is None else np.repeat(weights.reshape(-1, 9, 12), 3, axis=0)
    held = estimate_exposure(planes, expected, plane_weights, exposure)
    gain, offset = (np.moveaxis(part.reshape(*image.shape[:-3], 3, 1, 1), -3, -1) for part in (held.gain, held.offset))
    plain, slopes = LOIObjective(reference, weights=weights).value_and_grad(gain * image + offset)
    assert float(value) == pytest.approx(float(plain), rel=1e-12, abs=1e-15)
    np.testing.assert_allclose(gradient, gain * slopes, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(("gain", "offset", "is_other"), [(0.999, 0.0, False), (0.99, 0.0, True), (1.0, 0.003, True)])
def test_an_exposure_is_detected_from_half_a_step_of_eight_bits_on(gain: float, offset: float, is_other: bool) -> None:
    image = smooth(3)
    photograph = gain * image + offset
    plain, regressed, detected = (
        float(LOIObjective(photograph, exposure=exposure).value(image))
        for exposure in ("given", "regressed", "detected")
    )
    assert detected == (regressed if is_other else plain)


def test_a_patch_that_only_the_photograph_has_hardly_changes_the_regression() -> None:
    image = smooth(5)
    photograph = image * GAINS + OFFSETS
    photograph[4:12, 6:14] = [0.9, 0.6, 0.5]
    planes, expected = (np.moveaxis(array, -1, 0) for array in (image, photograph))
    regressed = estimate_exposure(planes, expected, None, "regressed")
    np.testing.assert_allclose(regressed.gain.ravel(), GAINS, atol=0.02)
    np.testing.assert_allclose(regressed.offset.ravel(), OFFSETS, atol=0.02)


@pytest.mark.parametrize(("image", "reference"), [(0.3, 0.6), (0.0, 0.0)])
@pytest.mark.parametrize("exposure", ["matched", "regressed"])
def test_two_constant_images_differ_by_an_offset_alone(image: float, reference: float, exposure: Any) -> None:
    planes, expected = np.full((1, 6, 7), image), np.full((1, 6, 7), reference)
    estimated = estimate_exposure(planes, expected, None, exposure)
    np.testing.assert_allclose(estimated.gain, 1.0, rtol=1e-6)
    np.testing.assert_allclose(estimated.apply(planes), expected, atol=1e-12)


def test_the_exposure_is_matched_in_linear_radiance_before_the_tone_curve() -> None:
    radiance = 20.0 * smooth(7)
    objective = LOIObjective(1.5 * radiance, exposure="matched", tone=LogTone(20.0))
    assert float(objective.value(radiance)) < 1e-6


def test_pixels_that_are_masked_do_not_change_the_exposure() -> None:
    image = smooth(9)
    photograph = image * GAINS + OFFSETS
    weights = np.ones(image.shape[:2])
    weights[:10] = 0.0
    photograph[:10] = 7.0
    assert float(LOIObjective(photograph, exposure="matched", weights=weights).value(image)) < 1e-6


def test_exposures_and_centring_of_other_kinds_are_refused() -> None:
    with pytest.raises(OptionError, match="'given', 'matched', 'regressed', 'detected', got 'auto'"):
        LOIObjective(smooth(0), exposure="auto")  # type: ignore[arg-type]  # on purpose
    with pytest.raises(ScaleError, match="`centred` must be True or False, got 'yes'"):
        ScaleSpace(1.0, 5.0, 0.125, centred="yes")  # type: ignore[arg-type]  # on purpose

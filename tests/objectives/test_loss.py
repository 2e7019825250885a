"""Properties of the loss: a distance between local histograms, averaged and summed as documented."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats

from loi_core import GaussianPyramid, LOIObjective, PixelL2, ScaleSpace, inner_images, isophotes, local_histograms
from tests.helpers import SCALES, Host, images, relative_error
from tests.strategies import SEEDS

SHAPES = st.tuples(st.integers(1, 12), st.integers(1, 12), st.integers(1, 4))
SPACES = st.sampled_from(list(SCALES.values()))


@given(SHAPES, SEEDS, SPACES)
def test_loss_is_zero_for_equal_images_and_positive_otherwise(
    shape: tuple[int, ...], seed: int, scales: ScaleSpace
) -> None:
    image, reference = images(shape, seed)
    objective = LOIObjective(reference, scales)
    assert float(objective.value(reference)) == 0.0
    assert float(objective.value(image)) > 0.0


@given(SHAPES, SEEDS, SPACES, st.integers(1, 3), st.integers(1, 3))
def test_a_batch_is_the_mean_of_its_images(
    shape: tuple[int, ...], seed: int, scales: ScaleSpace, first: int, second: int
) -> None:
    image, reference = images((first, second, *shape), seed)
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    count = first * second
    singles: list[tuple[float, Host]] = [
        LOIObjective(reference[index], scales).value_and_grad(image[index]) for index in np.ndindex(first, second)
    ]
    assert float(value) == pytest.approx(np.mean([float(single) for single, _ in singles]), rel=1e-12)
    stacked = np.stack([slope / count for _, slope in singles]).reshape(gradient.shape)
    assert relative_error(gradient, stacked) < 1e-10


@given(SHAPES, SEEDS)
def test_one_reference_serves_a_batch(shape: tuple[int, ...], seed: int) -> None:
    batch, _ = images((3, *shape), seed)
    reference = images(shape, seed + 1)[0]
    scales = SCALES["for image"]
    value, gradient = LOIObjective(reference, scales).value_and_grad(batch)
    repeated = LOIObjective(np.stack([reference] * 3), scales).value_and_grad(batch)
    assert float(value) == float(repeated[0])
    np.testing.assert_array_equal(gradient, repeated[1])


@given(SHAPES, SEEDS, st.sampled_from([0, 1, 2, -1, -2, -3]))
def test_the_channel_axis_only_moves_the_channels(shape: tuple[int, ...], seed: int, axis: int) -> None:
    image, reference = images(shape, seed)
    value, gradient = LOIObjective(reference, SCALES["for image"]).value_and_grad(image)
    moved = LOIObjective(np.moveaxis(reference, -1, axis), SCALES["for image"], channel_axis=axis)
    moved_value, moved_gradient = moved.value_and_grad(np.moveaxis(image, -1, axis))
    assert float(moved_value) == float(value)
    np.testing.assert_array_equal(moved_gradient, np.moveaxis(gradient, -1, axis))


def test_images_without_channels_are_images_of_one_channel() -> None:
    image, reference = images((9, 7), seed=1)
    flat = LOIObjective(reference, SCALES["for image"], channel_axis=None).value_and_grad(image)
    single = LOIObjective(reference[..., None], SCALES["for image"]).value_and_grad(image[..., None])
    assert float(flat[0]) == float(single[0])
    np.testing.assert_array_equal(flat[1], single[1][..., 0])


@given(SEEDS, st.integers(2, 9), st.integers(2, 9))
def test_over_a_whole_image_the_loss_is_the_wasserstein_distance_of_its_intensities(
    seed: int, height: int, width: int
) -> None:
    # An extent far beyond the image makes every neighbourhood the whole image. Smoothing both histograms by beta
    # changes their distance by about the level spacing times the fraction of crossings of the two CDFs.
    image, reference = images((height, width, 1), seed)
    beta = 1e-3
    value = LOIObjective(reference, ScaleSpace(0, 1e6, beta)).value(image)
    expected = stats.wasserstein_distance(image.ravel(), reference.ravel())
    assert float(value) == pytest.approx(expected, abs=beta)


def test_the_wasserstein_limit_is_reached_as_beta_shrinks() -> None:
    image, reference = images((8, 8, 1), seed=11)
    expected = stats.wasserstein_distance(image.ravel(), reference.ravel())
    errors = [
        abs(float(LOIObjective(reference, ScaleSpace(0, 1e6, beta)).value(image)) - expected)
        for beta in (3e-2, 1e-2, 3e-3, 1e-3)
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-4


@given(
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    SPACES.filter(lambda s: s.convention == "paper" and s.p == 1.0 and not s.centred),
)
def test_between_two_flat_images_the_loss_is_the_difference_of_their_values(
    first: float, second: float, scales: ScaleSpace
) -> None:
    assume(scales.boundary != "zero")  # black pixels beyond the border would count
    image, reference = np.full((5, 6, 2), first), np.full((5, 6, 2), second)
    for (_, beta, _), term in LOIObjective(reference, scales).terms(image).items():
        # The mass beyond tails of 4 beta, below 7e-5 of a saturated pixel, is lost.
        assert float(term) == pytest.approx(abs(first - second), abs=1e-4 * beta + 1e-7)


def test_reflection_keeps_the_loss_falling_towards_the_reference_and_zero_does_not() -> None:
    # With black padding the loss falls as an object leaves the image.
    def blob(x: float) -> Host:
        rows, columns = np.mgrid[:32, :64] + 0.5
        image: Host = np.exp(-((columns - x) ** 2 + (rows - 16) ** 2) / 18.0)[..., None]
        return image

    positions = np.arange(6.0, 59.0, 4.0)
    for boundary, monotone in (("reflect", True), ("zero", False)):
        scales = ScaleSpace(1, (5, 15), 0.125, boundary=boundary)  # type: ignore[arg-type]  # a plain str
        objective = LOIObjective(blob(50.0), scales)
        values = [float(objective.value(blob(x))) for x in positions[positions < 50.0]]
        assert (np.diff(values) < 0).all() == monotone


@given(SHAPES, SEEDS, SPACES.filter(lambda s: s.convention == "paper"))
def test_isophotes_are_densities(shape: tuple[int, ...], seed: int, scales: ScaleSpace) -> None:
    image, _ = images(shape, seed)
    sigma, beta, alpha = scales.sigma[0], scales.beta[0], scales.alpha[-1]
    density = isophotes(image, scales, sigma=sigma, beta=beta)
    assert density.shape == (scales.level_count(beta), *shape)
    np.testing.assert_allclose(density.sum(axis=0) * scales.spacing(beta), 1.0, atol=1e-4)
    mean = np.tensordot(scales.levels(beta), density, axes=1) * scales.spacing(beta)
    if scales.boundary == "reflect":
        np.testing.assert_allclose(mean, inner_images(image, scales)[sigma], atol=1e-3)
        local = local_histograms(image, scales, sigma=sigma, beta=beta, alpha=alpha)
        np.testing.assert_allclose(local.sum(axis=0) * scales.spacing(beta), 1.0, atol=1e-4)


def test_baselines_equal_their_definitions() -> None:
    image, reference = images((16, 16, 3), seed=2)
    assert float(PixelL2(reference).value(image)) == pytest.approx(np.mean((image - reference) ** 2))
    assert float(GaussianPyramid(reference, levels=1).value(image)) == pytest.approx(np.mean((image - reference) ** 2))
    terms = GaussianPyramid(reference, levels=4).terms(image)
    assert list(terms) == [0, 1, 2, 3]
    offset = GaussianPyramid(reference, levels=4).terms(reference + 0.25)
    assert [float(term) for term in offset.values()] == pytest.approx([0.0625] * 4)

"""Pixels that are not finite are counted, located and explained, or masked so that their values change nothing."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import GaussianPyramid, LogTone, LOIObjective, PixelL2, ScaleSpace, inner_images
from loi_core.errors import NonFiniteImageError
from tests.frameworks import jax, jnp, loi_jax, torch
from tests.helpers import Host, images

SCALES = ScaleSpace((0, 2), (1, 4), 0.125)
SHAPE = (6, 7, 3)
BAD = (np.nan, np.inf, -np.inf)
MASKING: dict[str, Callable[..., Any]] = {
    "loi": lambda reference, **options: LOIObjective(reference, SCALES, nan_policy="mask", **options),
    "pixel": lambda reference, **options: PixelL2(reference, nan_policy="mask", **options),
    "pyramid": lambda reference, **options: GaussianPyramid(reference, nan_policy="mask", **options),
}


def scattered(image: Host) -> None:
    image[1, 2, 0] = image[4, 5, 2] = np.nan


def fireflies(image: Host) -> None:
    image[1, 2] = np.inf


def everything(image: Host) -> None:
    image[...] = np.nan


def one_channel(image: Host) -> None:
    image[..., 1] = np.nan


def rows(image: Host) -> None:
    image[4:] = np.nan


def columns(image: Host) -> None:
    image[:, 0, 1] = np.nan


def connected_pixels(image: Host) -> None:
    image[2:4, 2:5] = np.nan


def negative_infinities(image: Host) -> None:
    image[2:4, 2:5] = -np.inf


def overflow(image: Host) -> None:
    image[2:4, 2:5] = np.inf
    image[2, 2, 0] = np.nan


@pytest.mark.parametrize(
    ("corrupt", "counts", "message"),
    [
        (scattered, (2, 0, 0), r"\(2 NaN\), the first at .* = \(1, 2, 0\): isolated pixels, .* 0/0 in shading"),
        (fireflies, (0, 3, 0), r"\(3 \+inf\), .*: isolated pixels, which suggests an overflow: exp, a division by alm"),
        (everything, (126, 0, 0), "every value, which suggests parameters that are not finite since the last step"),
        (one_channel, (42, 0, 0), "all of channel 1, which suggests a parameter of that channel"),
        (rows, (42, 0, 0), "whole rows, which suggests an unfinished render"),
        (columns, (6, 0, 0), "whole columns, which suggests an unfinished render"),
        (connected_pixels, (18, 0, 0), "connected pixels, which suggests one object"),
        (negative_infinities, (0, 0, 18), r"\(18 -inf\), .*: connected pixels, which suggests a logarithm of 0"),
        (overflow, (1, 17, 0), r"\(1 NaN, 17 \+inf\), .* suggests an overflow: .* float16 beyond 65504"),
    ],
)
def test_the_error_counts_each_kind_of_value_and_names_the_likely_cause(
    corrupt: Callable[[Host], None], counts: tuple[int, int, int], message: str
) -> None:
    image, reference = images(SHAPE, seed=1)
    corrupt(image)
    with pytest.raises(NonFiniteImageError, match=message) as caught:
        LOIObjective(reference, SCALES).value(image)
    error = caught.value
    assert "\n" not in str(error)
    assert (error.nan, error.positive, error.negative) == counts
    assert error.count == sum(counts)
    # With all pixels masked, the loss would be 0.
    assert ("nan_policy='mask'" in str(error)) == (error.count < image.size)
    unpickled = pickle.loads(pickle.dumps(error))  # noqa: S301 - written here, as by a worker process
    assert (str(unpickled), vars(unpickled)) == (str(error), vars(error))


@pytest.mark.parametrize(
    ("shape", "axis", "hole", "message"),
    [
        ((4, 6, 7, 3), -1, (2,), r"\(\*batch, y, x, c\) = \(2, 0, 0, 0\): only image 2 of the batch, every value, "),
        ((2, 2, 6, 7, 3), -1, (1, 0, 3, 4), r"only image \(1, 0\) of the batch, isolated pixels, "),
        ((4, 3, 6, 7), -3, (slice(None), 1), r"\(\*batch, c, y, x\) = \(0, 1, 0, 0\): all of channel 1, "),
        ((3, 6, 7), 0, (2, 5, 6), r"\(c, y, x\) = \(2, 5, 6\): isolated pixels"),
        ((6, 7), None, (3, 4), r"\(y, x\) = \(3, 4\): isolated pixels"),
        ((2, 6, 7), None, (1,), r"\(\*batch, y, x\) = \(1, 0, 0\): only image 1 of the batch, every value, "),
        ((1, 9, 1), -1, (0, 3, 0), "isolated pixels"),
    ],
)
def test_the_error_names_the_axes_of_the_image(
    shape: tuple[int, ...], axis: int | None, hole: tuple[Any, ...], message: str
) -> None:
    image, reference = images(shape, seed=2)
    image[hole] = np.nan
    with pytest.raises(NonFiniteImageError, match=message):
        LOIObjective(reference, SCALES, channel_axis=axis).value(image)
    with pytest.raises(NonFiniteImageError, match=message):
        inner_images(image, SCALES, channel_axis=axis)
    with pytest.raises(NonFiniteImageError, match=r"`reference` has .*fix the reference"):
        LOIObjective(image, SCALES, channel_axis=axis)


@given(st.data(), st.sampled_from(list(MASKING)), st.booleans())
def test_values_of_masked_pixels_change_nothing_to_the_bit(data: st.DataObject, name: str, curved: bool) -> None:
    seed = data.draw(st.integers(0, 2**31))
    rng = np.random.default_rng(seed)
    image, reference = images(SHAPE, seed)
    hidden, missing = rng.uniform(size=(2, *SHAPE)) < data.draw(st.sampled_from([0.02, 0.3, 1.0]))
    tone = LogTone(1.0) if curved else None
    results = []
    for _ in range(2):
        image[hidden] = rng.choice(BAD, size=int(hidden.sum()))
        image[missing & ~hidden] = rng.uniform(-1e3, 1e3, int((missing & ~hidden).sum()))
        reference[missing] = rng.choice(BAD, size=int(missing.sum()))
        results.append(MASKING[name](reference, tone=tone).value_and_grad(image))
    (value, gradient), (second_value, slopes) = results
    assert np.isfinite(value)
    assert value == second_value
    np.testing.assert_array_equal(gradient, slopes)
    assert not np.any(gradient[hidden | missing])
    assert np.all(np.isfinite(gradient))


@pytest.mark.parametrize("name", MASKING)
@pytest.mark.parametrize("tone", [None, LogTone(1.0)], ids=["plain", "tone"])
@pytest.mark.parametrize("masked", ["image", "reference", "both"])
def test_value_and_gradient_are_zero_if_all_pixels_are_masked(name: str, tone: LogTone | None, masked: str) -> None:
    image, reference = images(SHAPE, seed=5)
    nan = np.full(SHAPE, np.nan)
    objective = MASKING[name](reference if masked == "image" else nan, tone=tone)
    value, gradient = objective.value_and_grad(image if masked == "reference" else nan)
    assert float(value) == 0.0
    assert not np.any(gradient)


@pytest.mark.parametrize(("masked", "tone"), [("image", LogTone(1.0)), ("reference", None)])
def test_masking_works_under_jit(masked: str, tone: LogTone | None) -> None:
    scales = ScaleSpace(1, 2, 0.25)
    image, reference = images(SHAPE, seed=6)
    hole = (slice(1, 3), slice(2, 6), 1)
    results = []
    compiled = jax.jit(jax.value_and_grad(partial(loi_jax.loi_loss, scales=scales, nan_policy="mask", tone=tone)))
    for bad in (np.nan, -np.inf):
        (image if masked == "image" else reference)[hole] = bad
        results.append(compiled(image, reference))
    (value, gradient), (second_value, slopes) = results
    assert float(value) == float(second_value)
    np.testing.assert_array_equal(gradient, slopes)
    assert not np.any(gradient[hole])
    objective = LOIObjective(reference, scales, nan_policy="mask", tone=tone)
    expected, slopes = objective.value_and_grad(image)
    assert float(value) == pytest.approx(float(expected), rel=1e-12)
    np.testing.assert_allclose(gradient, slopes, rtol=1e-9, atol=1e-15)
    value, gradient = compiled(jnp.full(SHAPE, jnp.nan), reference)
    assert abs(float(value)) < 1e-15  # the program may round the blur of each image in its own way
    assert not np.any(gradient)


def test_a_masked_image_of_a_batch_leaves_the_others_unchanged() -> None:
    image, reference = images((3, *SHAPE), seed=7)
    image[1] = np.nan
    value, gradient = MASKING["loi"](reference).value_and_grad(image)
    values = [float(MASKING["loi"](reference[index]).value(image[index])) for index in range(3)]
    assert values[1] == 0.0
    assert float(value) == pytest.approx(sum(values) / 3.0, rel=1e-13)
    for index in (0, 2):
        _, expected = MASKING["loi"](reference[index]).value_and_grad(image[index])
        np.testing.assert_allclose(3.0 * gradient[index], expected, rtol=1e-12, atol=1e-18)


def test_masked_pixels_leave_the_autograd_gradient_of_torch_finite() -> None:
    image, reference = images(SHAPE, seed=8)
    image[2, 3] = np.nan, np.inf, -np.inf
    objective = LOIObjective(torch.tensor(reference), SCALES, nan_policy="mask", tone=LogTone(1.0))
    leaf = torch.tensor(image, requires_grad=True)
    objective.value(leaf).backward()
    assert leaf.grad is not None
    np.testing.assert_allclose(leaf.grad, objective.value_and_grad(torch.tensor(image))[1], rtol=1e-9, atol=1e-15)

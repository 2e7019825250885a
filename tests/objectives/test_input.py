"""Invalid images raise one-line errors with the actual and the allowed value; bad pixels follow the policy."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

from loi_core import GaussianPyramid, LOIObjective, PixelL2, ScaleSpace, isophotes
from loi_core.errors import ImageError, ImageTypeError, LoiError, NonFiniteImageError, OptionError
from tests.frameworks import array_api_strict, torch
from tests.helpers import images

SCALES = ScaleSpace(1, (1, 3), 0.2)
REFERENCE = np.full((6, 5, 3), 0.5)


@pytest.mark.parametrize(
    ("image", "error", "message"),
    [
        (np.zeros((6, 5, 3), dtype=np.uint8), ImageTypeError, "dtype uint8; divide 8-bit images by 255"),
        (np.zeros((6, 5, 3), dtype=bool), ImageTypeError, "dtype bool"),
        (np.zeros((6, 5, 3), dtype=complex), ImageTypeError, "dtype complex128"),
        (np.zeros((6, 5, 3), dtype=object), ImageTypeError, "dtype object"),
        (np.ma.zeros((6, 5, 3)), ImageTypeError, "masked array"),
        ([[0.0]], ImageTypeError, "got list"),
        (None, ImageTypeError, "got NoneType"),
        (np.zeros((6, 5)), ImageError, r"at least 3 axes.*got shape \(6, 5\).*channel_axis=None"),
        (np.zeros((5, 6, 3)), ImageError, r"\(5, 6, 3\).*does not fit `reference` of shape \(6, 5, 3\)"),
        (np.zeros((6, 5, 1)), ImageError, "does not fit"),
        (np.zeros((0, 6, 5, 3)), ImageError, "must not be empty"),
    ],
)
def test_bad_images_are_refused_by_name(image: Any, error: type[LoiError], message: str) -> None:
    with pytest.raises(error, match=f"`image`.*{message}") as caught:
        LOIObjective(REFERENCE, SCALES).value_and_grad(image)
    assert isinstance(caught.value, ValueError | TypeError)
    assert "\n" not in str(caught.value)


def test_integers_of_another_library_are_refused_by_name() -> None:
    with pytest.raises(ImageTypeError, match=r"`image`.*torch\.int64"):
        LOIObjective(REFERENCE, SCALES).value_and_grad(torch.zeros(6, 5, 3, dtype=torch.int64))


def test_a_reference_of_another_library_is_refused_with_the_fix() -> None:
    objective = PixelL2(torch.zeros(6, 5, 3))
    with pytest.raises(ImageTypeError, match="array of numpy, `reference` of torch; pass `reference` as NumPy"):
        objective.value(REFERENCE)


def test_a_numpy_reference_serves_every_library_and_dtype() -> None:
    image, reference = images((6, 5, 3), seed=1)
    objective = LOIObjective(reference, SCALES)
    expected = float(objective.value(image))
    assert float(objective.value(torch.tensor(image))) == pytest.approx(expected, rel=1e-12)
    assert float(objective.value(array_api_strict.asarray(image))) == pytest.approx(expected, rel=1e-12)
    value, gradient = objective.value_and_grad(torch.tensor(image, dtype=torch.float32))
    assert value.dtype == gradient.dtype == torch.float32
    assert float(value) == pytest.approx(expected, rel=1e-5)


def test_the_reference_is_copied() -> None:
    image, reference = images((6, 5, 3), seed=2)
    objective = LOIObjective(reference, SCALES)
    expected = float(LOIObjective(reference.copy(), SCALES).value(image))
    reference[:] = 0.0
    assert float(objective.value(image)) == expected


def test_a_torch_image_may_be_a_lazy_negative_of_its_memory() -> None:
    image, reference = images((6, 5, 3), seed=1)
    negated = torch.view_as_complex(torch.tensor(np.stack([image, -image], -1))).conj().imag
    assert negated.is_neg()
    expected, slopes = LOIObjective(reference, SCALES).value_and_grad(image)
    value, gradient = LOIObjective(reference, SCALES).value_and_grad(negated)
    assert value == expected
    np.testing.assert_array_equal(gradient, slopes)


def test_objectives_can_be_copied_and_pickled_before_and_after_use() -> None:
    image, reference = images((6, 5, 3), seed=1)
    used, new = LOIObjective(reference, SCALES), LOIObjective(reference, SCALES)
    expected = used.value(image)
    for objective in (used, new):
        restored = pickle.loads(pickle.dumps(objective))  # noqa: S301  # written here
        assert copy.deepcopy(objective).value(image) == restored.value(image) == expected


def test_the_image_is_not_written_to() -> None:
    image, reference = images((6, 5, 3), seed=2)
    image.flags.writeable = False
    for objective in (LOIObjective(reference, SCALES), PixelL2(reference), GaussianPyramid(reference)):
        objective.value_and_grad(image)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"accuracy": "best"}, "`accuracy` must be one of 'exact', 'balanced', 'fast', or a relative error"),
        ({"accuracy": 1.5}, "`accuracy`.*got 1.5"),
        ({"channel_axis": "last"}, "`channel_axis`"),
        ({"channel_axis": 3}, r"`channel_axis` is 3, but `reference` has shape \(6, 5, 3\)"),
        ({"nan_policy": "ignore"}, "`nan_policy` must be one of 'raise', 'mask', got 'ignore'"),
        ({"scales": 5}, "`scales` must be a ScaleSpace, got int"),
    ],
)
def test_bad_options_are_refused_by_name(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        LOIObjective(REFERENCE, **options)
    assert isinstance(caught.value, OptionError | ImageError)


@pytest.mark.parametrize("levels", [0, 9, True, 2.0])
def test_pyramid_levels_that_do_not_fit_the_image_are_refused(levels: Any) -> None:
    with pytest.raises(OptionError, match="`levels` must be a whole number from 1 to 2"):
        GaussianPyramid(REFERENCE, levels=levels)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_the_error_counts_bad_pixels_and_names_the_first(bad: float) -> None:
    image = REFERENCE.copy()
    image[2, 3, 1] = image[4, 0, 0] = bad
    with pytest.raises(NonFiniteImageError, match=r"`image` has 2 non-finite values of 90.*= \(2, 3, 1\)") as caught:
        LOIObjective(REFERENCE, SCALES).value(image)
    assert (caught.value.count, caught.value.first) == (2, (2, 3, 1))
    assert isinstance(caught.value, ValueError)
    unpickled = pickle.loads(pickle.dumps(caught.value))  # noqa: S301 - written here, as by a worker process
    assert (str(unpickled), unpickled.count) == (str(caught.value), 2)
    with pytest.raises(NonFiniteImageError, match="`reference` has"):
        LOIObjective(image, SCALES)


@pytest.mark.parametrize("masked", ["image", "reference", "both"])
def test_masked_pixels_have_no_gradient_and_a_finite_value(masked: str) -> None:
    image, reference = images((6, 5, 3), seed=4)
    hole = (slice(1, 3), slice(2, 4), 1)
    bad_image, bad_reference = image.copy(), reference.copy()
    if masked != "reference":
        bad_image[hole] = np.nan
    if masked != "image":
        bad_reference[hole] = np.inf
    for make in (lambda r: LOIObjective(r, SCALES, nan_policy="mask"), lambda r: PixelL2(r, nan_policy="mask")):
        value, gradient = make(bad_reference).value_and_grad(bad_image)
        assert np.isfinite(value)
        assert np.all(np.isfinite(gradient))
        assert not np.any(gradient[hole])
    # Masking changes nothing if both images are finite.
    _, gradient = LOIObjective(reference, SCALES, nan_policy="mask").value_and_grad(image)
    np.testing.assert_array_equal(gradient, LOIObjective(reference, SCALES).value_and_grad(image)[1])


@pytest.mark.parametrize(("level", "reference", "sign"), [(1.5, 0.2, 1.0), (-0.5, 0.8, -1.0)])
def test_a_clipped_value_keeps_the_gradient_that_points_back_inside(
    level: float, reference: float, sign: float
) -> None:
    objective = LOIObjective(np.full((6, 5, 1), reference), SCALES)
    _, gradient = objective.value_and_grad(np.full((6, 5, 1), level))
    assert np.all(np.sign(gradient) == sign)


def test_zero_padding_is_the_bound_nearest_to_black() -> None:
    image = np.full((9, 9, 1), 1.2)
    scales = ScaleSpace(4, 0, 0.05, bounds=(1, 2), boundary="zero")
    density = isophotes(image, scales, sigma=4, beta=0.05)
    np.testing.assert_allclose(density.sum(axis=0) * 0.05, 1.0, atol=1e-4)
    assert ScaleSpace(1, 1, 0.1, boundary="zero").padding == 0.0


def test_a_positive_channel_axis_refuses_images_with_more_batch_axes() -> None:
    reference = np.random.default_rng(0).uniform(size=(3, 8, 8))
    batch = np.stack([reference] * 3)
    with pytest.raises(ImageError, match="`channel_axis` must count from the end"):
        LOIObjective(reference, SCALES, channel_axis=0).value(batch)
    assert float(LOIObjective(reference, SCALES, channel_axis=-3).value(batch)) == 0.0


def test_a_torch_gradient_carries_no_graph() -> None:
    image = torch.rand(6, 5, 3, requires_grad=True)
    objective = LOIObjective(torch.rand(6, 5, 3, requires_grad=True), SCALES)
    value, gradient = objective.value_and_grad(image)
    assert not value.requires_grad
    assert not gradient.requires_grad
    assert objective.value(image).requires_grad  # autograd can still differentiate the value


@pytest.mark.parametrize("make", [int, float, np.float32, np.array, lambda number: torch.tensor(float(number))])
def test_scales_may_be_numbers_of_any_library(make: Any) -> None:
    scalar = make(3)
    assert ScaleSpace(scalar, scalar, 0.1) == ScaleSpace(3.0, 3.0, 0.1)


def test_images_in_foreign_byte_order_are_refused() -> None:
    with pytest.raises(ImageTypeError, match="byte order"):
        LOIObjective(REFERENCE, SCALES).value(REFERENCE.astype(">f8"))

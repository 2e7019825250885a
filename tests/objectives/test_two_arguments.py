"""The loss of an image and a target has the value of an objective prepared for the target, and keeps nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import LogTone, LOIObjective, ScaleSpace, Target, loi_loss
from loi_core.errors import ImageError, ImageTypeError, LoiError, NonFiniteImageError, OptionError, ScaleError
from loi_core.objectives import RangeWarning
from tests.frameworks import array_api_strict, torch
from tests.helpers import images
from tests.strategies import SEEDS

SHAPE = (2, 12, 15, 3)
IMAGE, TARGET = images(SHAPE, 1)
SCALES = ScaleSpace((0, 2), (1, 5), 0.125)
MASK = np.random.default_rng(2).uniform(size=SHAPE[1:3]) > 0.4
OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "balanced": {"accuracy": "balanced"},
    "tone": {"tone": LogTone(1.0)},
    "exposure": {"exposure": "matched"},
    "colours": {"colours": "differences"},
    "mask policy": {"nan_policy": "mask"},
}


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
@given(SEEDS, st.booleans())
def test_the_loss_is_the_value_of_the_objective(options: dict[str, Any], seed: int, weighted: bool) -> None:
    image, target = images(SHAPE, seed)
    weights = np.random.default_rng(seed).uniform(size=SHAPE[:-1]) if weighted else None
    expected = LOIObjective(target, SCALES, **options).value(image, weights=weights)
    assert float(loi_loss(image, target, SCALES, weights=weights, **options)) == pytest.approx(
        float(expected), rel=1e-13, abs=1e-300
    )


def test_the_default_scales_are_those_of_the_images_size() -> None:
    for colours in ("channels", "differences"):
        options: dict[str, Any] = {"colours": colours}
        assert float(loi_loss(IMAGE, TARGET, **options)) == float(LOIObjective(TARGET, **options).value(IMAGE))


@pytest.mark.parametrize("target", [TARGET, TARGET[0], TARGET[:1]], ids=["each", "shared", "one"])
def test_a_reduction_combines_the_losses_of_the_images(target: Any) -> None:
    pairs = zip(IMAGE, np.broadcast_to(target, SHAPE), strict=True)
    values = [float(LOIObjective(single, SCALES).value(image)) for image, single in pairs]
    np.testing.assert_allclose(loi_loss(IMAGE, target, SCALES, reduction="none"), values, rtol=1e-13)
    assert float(loi_loss(IMAGE, target, SCALES, reduction="sum")) == pytest.approx(sum(values), rel=1e-13)
    assert float(loi_loss(IMAGE, target, SCALES)) == pytest.approx(np.mean(values), rel=1e-13)


def test_one_image_is_a_batch_without_axes() -> None:
    values = [loi_loss(IMAGE[0], TARGET[0], SCALES, reduction=name) for name in ("mean", "sum", "none")]
    assert {np.shape(value) for value in values} == {()}
    assert len(set(map(float, values))) == 1


@pytest.mark.parametrize("convert", [array_api_strict.asarray, torch.tensor], ids=["array_api_strict", "torch"])
def test_the_value_has_the_library_and_dtype_of_the_image(convert: Any) -> None:
    expected = loi_loss(IMAGE, TARGET, SCALES, reduction="none")
    for target in (TARGET, convert(TARGET)):
        values = loi_loss(convert(IMAGE), target, SCALES, reduction="none")
        assert type(values) is type(convert(IMAGE))
        np.testing.assert_allclose(np.asarray(values), expected, rtol=1e-12)
    assert loi_loss(convert(IMAGE.astype(np.float32)), TARGET).dtype == convert(IMAGE.astype(np.float32)).dtype


@pytest.mark.parametrize("compiled", ["1", "0"])
def test_pixels_of_weight_0_are_equal_to_the_target(compiled: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOI_COMPILED", compiled)
    for target in (TARGET, np.where(MASK[..., None], TARGET, np.nan)):
        values = [
            float(loi_loss(np.where(MASK[..., None], IMAGE, filling), target, SCALES, weights=MASK))
            for filling in (0.0, 1.0, np.nan)
        ]
        assert len(set(values)) == 1
        assert 0.0 < values[0] < np.inf
    assert float(loi_loss(IMAGE, TARGET, SCALES, weights=np.zeros(SHAPE[1:3]))) == 0.0


def test_only_visible_pixels_of_a_target_are_warned_of() -> None:
    radiance = np.where(MASK[..., None], TARGET, 1e3)
    loi_loss(IMAGE, radiance, SCALES, weights=MASK)
    with pytest.warns(RangeWarning, match="of the target lies beyond"):
        loi_loss(IMAGE, radiance, SCALES)


def test_a_read_only_target_is_no_warning() -> None:
    target = TARGET.copy()
    target.flags.writeable = False
    assert float(loi_loss(torch.tensor(IMAGE), target, SCALES)) == float(loi_loss(IMAGE, TARGET, SCALES))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"target": TARGET[:, 1:]}, ImageError, r"does not fit `target` of shape \(2, 11, 15, 3\)"),
        ({"image": IMAGE[0]}, ImageError, r"`image` has shape \(12, 15, 3\), which does not fit `target` of shape"),
        ({"target": TARGET > 0.5}, ImageTypeError, "`target` must hold real floating-point values, got dtype bool"),
        ({"target": None}, ImageTypeError, "`target` must be an array of an array API library, got NoneType"),
        ({"target": torch.tensor(TARGET)}, ImageTypeError, "an array of numpy, `target` of torch"),
        ({"target": np.full(SHAPE, np.nan)}, NonFiniteImageError, "`target` has 1080 non-finite values"),
        ({"image": np.full(SHAPE, np.nan)}, NonFiniteImageError, "`image` has 1080 non-finite values"),
        ({"scales": 1.0}, ScaleError, "`scales` must be a ScaleSpace, got float"),
        ({"reduction": "max"}, OptionError, "`reduction` must be one of 'mean', 'sum', 'none', got 'max'"),
        ({"colours": "differences", "channel_axis": None}, OptionError, "three channels, got images of none"),
        ({"colours": "hue"}, OptionError, "`colours` must be 'channels' or 'differences'"),
        (
            {"image": IMAGE[0], "target": TARGET, "channel_axis": 2},
            ImageError,
            "`channel_axis` must count from the end",
        ),
        ({"weights": np.ones((3, 3))}, ImageError, "`weights` must have shape"),
        ({"image": np.zeros((3, 20, 24)), "target": np.zeros((3, 20, 24))}, ImageError, "pass channel_axis=-3"),
    ],
)
def test_errors_name_the_image_or_the_target(arguments: Any, error: type[LoiError], message: str) -> None:
    with pytest.raises(error, match=message):
        loi_loss(**{"image": IMAGE, "target": TARGET, **arguments})


@pytest.mark.parametrize("make", [np.asarray, torch.tensor], ids=["numpy", "torch"])
@pytest.mark.parametrize("axis", [-1, -3])
@pytest.mark.parametrize("call_weights", [None, MASK, MASK * 0.5], ids=["none", "mask", "weights"])
def test_a_target_stands_for_its_image_and_weights(make: Any, axis: int, call_weights: Any) -> None:
    opacity = np.random.default_rng(3).uniform(size=MASK.shape)
    target = Target(TARGET[0], opacity)
    image, reference = (np.moveaxis(array, -1, axis) for array in (IMAGE, TARGET[0]))
    weights = opacity if call_weights is None else opacity * call_weights
    expected = loi_loss(image, reference, SCALES, channel_axis=axis, weights=weights)
    given_weights = None if call_weights is None else make(call_weights)
    value = loi_loss(make(image), target, SCALES, channel_axis=axis, weights=given_weights)
    objective = LOIObjective(target, SCALES, channel_axis=axis)
    rtol = 1e-6  # weights are of float32 where the call's are a mask
    np.testing.assert_allclose(float(value), float(expected), rtol=rtol)
    np.testing.assert_allclose(float(objective.value(make(image), weights=given_weights)), float(expected), rtol=rtol)


def test_an_image_with_opacity_and_one_without_are_compared_once_one_is_composited() -> None:
    with pytest.raises(ImageError, match=r"composite the image of four channels over a background"):
        loi_loss(IMAGE, np.ones((*SHAPE[:3], 4)))
    with pytest.raises(ImageError, match=r"does not fit `target` of shape \(2, 12, 15, 2\)$"):
        loi_loss(IMAGE, np.ones((*SHAPE[:3], 2)))

"""Images with their channels first are noticed, and images with their channels last are never taken for them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import LOIObjective, PixelL2
from loi_core.errors import ImageError
from loi_core.pixels.layout import Layout

COUNTS = st.sampled_from([1, 3, 4])
BATCHES = st.lists(st.integers(1, 5), max_size=2).map(tuple)
SIDES_PX = st.integers(5, 300)


@given(batch=BATCHES, channels=COUNTS, height=SIDES_PX, width=SIDES_PX)
def test_channels_first_is_an_error_that_names_the_axis(
    batch: tuple[int, ...], channels: int, height: int, width: int
) -> None:
    shape = (*batch, channels, height, width)
    with pytest.raises(ImageError, match=r"channel_axis=-3") as caught:
        Layout.of("image", shape, -1)
    assert "\n" not in str(caught.value)
    assert Layout.of("image", shape, -3).planes_shape == shape
    assert Layout.of("image", shape, len(shape) - 1).height == channels  # an axis counted from the front is believed


@given(batch=BATCHES, height=st.integers(1, 300), width=st.integers(1, 300), channels=COUNTS)
def test_grey_and_colour_images_with_channels_last_pass(
    batch: tuple[int, ...], height: int, width: int, channels: int
) -> None:
    layout = Layout.of("image", (*batch, height, width, channels), -1)
    assert (layout.height, layout.width) == (height, width)


@given(batch=BATCHES, height=st.integers(5, 300), width=st.integers(1, 300), channels=st.integers(1, 300))
def test_any_number_of_channels_passes_from_5_rows_on(
    batch: tuple[int, ...], height: int, width: int, channels: int
) -> None:
    assert Layout.of("image", (*batch, height, width, channels), -1).height == height


@given(batch=BATCHES, height=COUNTS, width=st.integers(1, 300), channels=st.integers(1, 4))
def test_few_rows_with_few_channels_pass(batch: tuple[int, ...], height: int, width: int, channels: int) -> None:
    assert Layout.of("image", (*batch, height, width, channels), -1).height == height


@given(batch=BATCHES, height=COUNTS, width=st.integers(1, 4), channels=st.integers(1, 300))
def test_few_rows_with_few_columns_pass(batch: tuple[int, ...], height: int, width: int, channels: int) -> None:
    assert Layout.of("image", (*batch, height, width, channels), -1).width == width


@pytest.mark.parametrize("shape", [(3, 16, 20), (2, 3, 16, 20)], ids=str)
@pytest.mark.parametrize("objective", [LOIObjective, PixelL2])
def test_references_and_images_are_both_checked(
    objective: type[LOIObjective] | type[PixelL2], shape: tuple[int, ...]
) -> None:
    picture = np.zeros(shape)
    with pytest.raises(ImageError, match=r"`reference` has shape .* pass channel_axis=-3"):
        objective(picture)
    with pytest.raises(ImageError, match=r"`image` has shape .* pass channel_axis=-3"):
        objective(np.moveaxis(picture, -3, -1)).value(picture)
    assert objective(picture, channel_axis=-3).value(picture) == 0.0

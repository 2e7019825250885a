"""Leaving out pixels and levels that cannot differ changes neither loss nor gradient."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import LOIObjective, ScaleSpace
from loi_core.method import array_comparison as arrays
from loi_core.method import compiled
from loi_core.method.blurs import GaussianBlur
from loi_core.method.compiled.tables import BlurColumn, PassColumn
from loi_core.method.distance import sum_of_costs
from loi_core.method.gaussian import AxisBlur, AxisGrid
from loi_core.method.plane_blurs import PlaneBlur, PlaneGrid
from loi_core.method.scales import Boundary
from loi_core.method.windows import Window, window_of
from loi_core.support.arrays import Array
from tests.contents import CONTENTS
from tests.frameworks import torch
from tests.helpers import Host, without_numba
from tests.strategies import max_differences

SIZES = st.integers(1, 150)
SMALL_SIZES = st.integers(1, 64)  # for bounds that are derived pixel by pixel


@contextmanager
def without_reading_values() -> Iterator[None]:
    """Compare all pixels and levels, as for arrays whose values cannot be read."""
    with without_numba(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(arrays, "values_may_decide", lambda _: False)
        yield


@st.composite
def ranges(draw: st.DrawFn, size: int) -> range:
    start = draw(st.integers(0, size - 1))
    return range(start, draw(st.integers(start + 1, size)))


@st.composite
def local_changes(draw: st.DrawFn) -> tuple[Host, Host]:
    """Draw a reference, and an image that differs from it in one rectangle, within a range of intensities."""
    height, width = draw(SMALL_SIZES), draw(SMALL_SIZES)
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    reference = CONTENTS[draw(st.sampled_from(["flat", "photographs", "sparse"]))]((height, width, 2), rng)[0]
    image = reference.copy()
    rectangle = np.ix_(draw(ranges(height)), draw(ranges(width)))
    image[rectangle] = rng.uniform(size=image[rectangle].shape)
    darkest, brightest = sorted(draw(st.tuples(st.floats(0, 1), st.floats(0, 1))))
    return darkest + (brightest - darkest) * image, darkest + (brightest - darkest) * reference


def scales_for(shape: tuple[int, ...]) -> list[ScaleSpace]:
    height, width = shape[:2]
    return [
        ScaleSpace.for_image(height, width),
        ScaleSpace((0, 1, 5), (0, 1, 5, 15), (0.05, 0.125)),
        ScaleSpace.paper("path", boundary="zero"),
        ScaleSpace.released((1, 5), (1, 5), 8, 21),
    ]


@given(
    local_changes(), st.integers(0, 3), st.sampled_from(["exact", "balanced"]), st.sampled_from(["float64", "float32"]),
    st.sampled_from([nullcontext, without_numba]),
)  # fmt: skip
def test_leaving_out_equal_pixels_and_levels_changes_neither_loss_nor_gradient(
    pair: tuple[Host, Host], index: int, accuracy: str, dtype: str, backend: Callable[[], AbstractContextManager[None]]
) -> None:
    image, reference = (planes.astype(dtype) for planes in pair)
    scales = scales_for(image.shape)[index]
    with backend():
        value, gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)
        value_alone = LOIObjective(reference, scales, accuracy).value(image)
    with without_reading_values():
        expected, expected_gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    loss_bound, gradient_bound = max_differences(image, reference, scales)
    assert abs(float(value) - float(expected)) <= loss_bound
    assert np.abs(gradient - expected_gradient).sum() <= gradient_bound
    assert abs(float(value_alone) - float(expected)) <= loss_bound


@given(st.data(), SIZES, SIZES, st.floats(0.1, 60.0), st.sampled_from(["reflect", "zero"]), st.booleans())
def test_blurring_a_window_equals_blurring_the_plane(
    data: st.DataObject, height: int, width: int, scale: float, boundary: Boundary, coarser: bool
) -> None:
    rng = np.random.default_rng(height)
    pixels = PlaneGrid.pixels(height, width)
    target = PlaneGrid(*(AxisGrid(size, (size + 1) // 2 if coarser else size) for size in (height, width)))
    blur = GaussianBlur(
        PlaneBlur(
            AxisBlur(pixels.rows, target.rows, scale, boundary),
            AxisBlur(pixels.columns, target.columns, scale, boundary),
        ),
        rng.uniform(size=1),
    )
    for apply, support_of, grid in (
        (blur.apply, blur.blur.support_of, pixels),
        (blur.adjoint, blur.blur.adjoint_support_of, target),
    ):
        window = Window(data.draw(ranges(grid.rows.cells)), data.draw(ranges(grid.columns.cells)))
        planes = rng.uniform(size=(2, *window.shape))
        expected = apply(window.paste(planes, grid.rows.cells, grid.columns.cells))
        actual = support_of(window).paste(apply(planes, window), *expected.shape[-2:])
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-14 * planes.size)


@given(st.data(), SIZES, SIZES)
def test_the_window_of_a_mask_is_its_bounding_box(data: st.DataObject, height: int, width: int) -> None:
    window = Window(data.draw(ranges(height)), data.draw(ranges(width)))
    corners = np.zeros((2, height, width), dtype=bool)
    corners[0, window.rows[0], window.columns[-1]] = True
    corners[1, window.rows[-1], window.columns[0]] = True
    assert window_of(corners) == window
    assert window_of(torch.tensor(corners)) == window
    assert window_of(np.zeros((2, height, width), dtype=bool)) is None


@pytest.mark.parametrize("backend", [nullcontext, without_numba])
def test_equal_images_are_not_compared(backend: Callable[[], AbstractContextManager[None]]) -> None:
    image = np.random.default_rng(0).uniform(size=(30, 40, 3))
    objective = LOIObjective(image, ScaleSpace.paper("path"))
    with backend(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(arrays, "weights_and_slopes", None)
        if compiled.available():
            patch.setattr("loi_core.method.compiled.loop_comparison.compare_levels", None)
        value, gradient = objective.value_and_grad(image.copy())
    assert float(value) == 0.0
    assert not np.any(gradient)


def test_the_work_is_proportional_to_the_pixels_that_differ() -> None:
    rng = np.random.default_rng(0)
    reference = rng.uniform(size=(256, 256, 1))
    image = reference.copy()
    image[100:110, 60:70] += 0.1
    blurred: list[int] = []

    def counting(difference: Host, slope: Host, p: float) -> Array:
        blurred.append(difference.size)
        return sum_of_costs(difference, slope, p)

    objective = LOIObjective(reference, ScaleSpace(0, 1, 0.125))
    with without_numba(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(arrays, "sum_of_costs", counting)
        objective.value_and_grad(image)
    size = 10 + 2 * 9  # pixels: the kernel ends after 8.6 pixels
    assert 0 < sum(blurred) <= 17 * size**2


def test_the_schedule_of_the_loops_compares_only_pixels_that_can_differ() -> None:
    scheduler = pytest.importorskip("loi_core.method.compiled.schedule", reason="needs Numba").Scheduler
    rng = np.random.default_rng(0)
    reference = rng.uniform(size=(256, 256, 1))
    image = reference.copy()
    image[100:110, 60:70] += 0.1
    schedules: list[Any] = []
    make_schedule = scheduler.schedule

    def recording(self: Any, *arguments: Any, **options: Any) -> Any:
        schedules.append(make_schedule(self, *arguments, **options))
        return schedules[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scheduler, "schedule", recording)
        LOIObjective(reference, ScaleSpace(0, 1, 0.125)).value_and_grad(image)
    (schedule,) = schedules
    ((top, bottom, left, right),) = schedule.blurs[
        :, BlurColumn.ADJOINT + PassColumn.TOP : BlurColumn.ADJOINT + PassColumn.GROUPS
    ]
    assert (bottom - top, right - left) == (10 + 2 * 8, 10 + 2 * 8)
    lines = str(schedule).splitlines()
    assert lines[1].startswith("level 0: DIFFERENCE ")
    assert lines[2] == "level 0 to extent 0:"
    assert f"TOP {top}, BOTTOM {bottom}, LEFT {left}, RIGHT {right}" in lines[4]

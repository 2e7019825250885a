"""Only what can differ is computed, and that changes nothing: not the loss, not the gradient."""

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
from loi_core.method.blurs import GaussianBlur, PlaneBlur, PlaneGrid
from loi_core.method.compiled.records import EdgeColumn, PassColumn
from loi_core.method.distance import sum_of_costs
from loi_core.method.gaussian import AxisBlur, AxisGrid
from loi_core.method.scales import Boundary
from loi_core.method.scope import Scope
from loi_core.method.windows import Window, window_of
from loi_core.support.arrays import Array
from tests.contents import CONTENTS
from tests.frameworks import torch
from tests.helpers import Host, without_numba
from tests.strategies import max_differences

SIZES = st.integers(1, 150)
SIDES = st.integers(1, 64)  # where every bound is derived pixel by pixel


@contextmanager
def everything_computed() -> Iterator[None]:
    """As where values cannot be looked at."""
    with without_numba(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(arrays, "values_may_decide", lambda _: False)
        yield


@st.composite
def ranges(draw: st.DrawFn, size: int) -> range:
    start = draw(st.integers(0, size - 1))
    return range(start, draw(st.integers(start + 1, size)))


@st.composite
def local_changes(draw: st.DrawFn) -> tuple[Host, Host]:
    """A reference, and an image that differs from it in one rectangle, all in a part of the range of intensities."""
    height, width = draw(SIDES), draw(SIDES)
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    reference = CONTENTS[draw(st.sampled_from(["flat", "photographs", "sparse"]))]((height, width, 2), rng)[0]
    image = reference.copy()
    inside = np.ix_(draw(ranges(height)), draw(ranges(width)))
    image[inside] = rng.uniform(size=image[inside].shape)
    low, high = sorted(draw(st.tuples(st.floats(0, 1), st.floats(0, 1))))
    return low + (high - low) * image, low + (high - low) * reference


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
def test_leaving_out_what_cannot_differ_changes_nothing(
    pair: tuple[Host, Host], which: int, accuracy: str, dtype: str, way: Callable[[], AbstractContextManager[None]]
) -> None:
    image, reference = (each.astype(dtype) for each in pair)
    scales = scales_for(image.shape)[which]
    with way():
        value, gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)
        alone = LOIObjective(reference, scales, accuracy).value(image)
    with everything_computed():
        wanted, slopes = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    loss_bound, gradient_bound = max_differences(image, reference, scales)
    assert abs(float(value) - float(wanted)) <= loss_bound
    assert np.abs(gradient - slopes).sum() <= gradient_bound
    assert abs(float(alone) - float(wanted)) <= loss_bound


@given(st.data(), SIZES, SIZES, st.floats(0.1, 60.0), st.sampled_from(["reflect", "zero"]), st.booleans())
def test_a_blur_of_a_window_is_that_of_the_plane(
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
    for apply, reached, grid in (
        (blur.apply, blur.blur.reached, pixels),
        (blur.adjoint, blur.blur.reached_back, target),
    ):
        window = Window(data.draw(ranges(grid.rows.cells)), data.draw(ranges(grid.columns.cells)))
        part = rng.uniform(size=(2, *window.shape))
        whole = apply(window.paste(part, grid.rows.cells, grid.columns.cells))
        got = reached(window).paste(apply(part, window), *whole.shape[-2:])
        np.testing.assert_allclose(got, whole, rtol=0, atol=1e-14 * part.size)


@given(st.data(), SIZES, SIZES)
def test_a_window_holds_all_that_is_true(data: st.DataObject, height: int, width: int) -> None:
    window = Window(data.draw(ranges(height)), data.draw(ranges(width)))
    corners = np.zeros((2, height, width), dtype=bool)
    corners[0, window.rows[0], window.columns[-1]] = True
    corners[1, window.rows[-1], window.columns[0]] = True
    assert window_of(corners) == window
    assert window_of(torch.tensor(corners)) == window
    assert window_of(np.zeros((2, height, width), dtype=bool)) is None


@pytest.mark.parametrize("way", [nullcontext, without_numba])
def test_equal_images_take_no_comparison(way: Callable[[], AbstractContextManager[None]]) -> None:
    image = np.random.default_rng(0).uniform(size=(30, 40, 3))
    objective = LOIObjective(image, ScaleSpace.paper("path"))
    with way(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(arrays, "weights_and_slopes", None)
        if compiled.available():
            patch.setattr("loi_core.method.compiled.loop_comparison.compare_levels", None)
        value, gradient = objective.value_and_grad(image.copy())
    assert float(value) == 0.0
    assert not np.any(gradient)


def test_a_small_difference_takes_a_small_part_of_the_work() -> None:
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
    reached = 10 + 2 * 9  # pixels a side: the kernel ends after 8.6 pixels
    assert 0 < sum(blurred) <= 17 * reached**2


def test_loops_are_told_to_compute_no_more_than_that() -> None:
    wiring = pytest.importorskip("loi_core.method.compiled.program", reason="needs Numba").Wiring
    rng = np.random.default_rng(0)
    reference = rng.uniform(size=(256, 256, 1))
    image = reference.copy()
    image[100:110, 60:70] += 0.1
    compared: list[Host] = []
    program = wiring.program

    def counting(self: Any, scope: Scope) -> Any:
        made = program(self, scope)
        compared.extend(made.edges[:, EdgeColumn.BACK + PassColumn.TOP : EdgeColumn.BACK + PassColumn.GROUPS])
        return made

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wiring, "program", counting)
        LOIObjective(reference, ScaleSpace(0, 1, 0.125)).value_and_grad(image)
    ((top, bottom, left, right),) = compared
    assert (bottom - top, right - left) == (10 + 2 * 8, 10 + 2 * 8)

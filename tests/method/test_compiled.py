"""Compiled kernels give the same results as whole-array operations."""

from __future__ import annotations

from pathlib import Path

import mpmath
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

pytest.importorskip("numba")

from loi_core import LOIObjective, ScaleSpace
from loi_core.method.compiled import compiling, rows, schedule
from loi_core.method.compiled.bands import Band, adjoint_band, forward_band
from loi_core.method.compiled.exponential import exponential
from loi_core.method.compiled.inner import InnerBlur
from loi_core.method.compiled.levels import compare_levels
from loi_core.method.compiled.tables import GROUP_ROWS, SQUARE_SIDE, Plane
from loi_core.method.compiled.workspace import Workspace
from loi_core.method.gaussian import AxisBlur, AxisGrid
from loi_core.method.plane_blurs import PlaneBlur, PlaneGrid
from tests.contents import CONTENTS
from tests.helpers import Host, program_output, without_numba
from tests.strategies import SEEDS, THOROUGH, Problem, max_differences, problems

# Problems are drawn with values beyond the bounds as well.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

KINDS = sorted(CONTENTS)
DTYPES = ("float32", "float64")


@compiling.compiled
def exponentials(values: Host) -> Host:
    result = np.empty_like(values)
    for index in range(values.size):
        result[index] = exponential(values[index])
    return result


@pytest.mark.parametrize("dtype", DTYPES)
def test_the_exponential_is_within_two_roundings(dtype: str) -> None:
    # Seven or thirteen terms, each with a rounding, and the sum of the last of them near 1: two in all.
    lowest = float(np.log(np.finfo(dtype).tiny))
    values = np.concat([np.linspace(lowest, 0.0, 4001), -np.logspace(-9, 0, 500)]).astype(dtype)
    actual = exponentials(values)
    assert actual.dtype == values.dtype
    expected = np.asarray([float(mpmath.exp(mpmath.mpf(float(value)))) for value in values])
    assert np.max(np.abs(actual / expected - 1.0)) <= 2.0 * np.finfo(dtype).eps


def dense(band: Band) -> Host:
    """Return the matrix of a band, with the columns beyond its last."""
    matrix = np.zeros((GROUP_ROWS * len(band.starts), band.height))
    for group, start in enumerate(band.starts):
        group_rows = slice(GROUP_ROWS * group, GROUP_ROWS * (group + 1))
        matrix[group_rows, start : start + band.taps] = band.weights[group].T
    return matrix


@given(
    st.integers(1, 200), st.integers(1, 4), st.floats(0.5, 150.0), st.sampled_from(["reflect", "zero"]),
    st.sampled_from([None, 1, 21]),
)  # fmt: skip
def test_bands_hold_the_matrix_and_its_transpose(
    size: int, ratio: int, scale: float, boundary: str, taps: int | None
) -> None:
    source, target = AxisGrid(size, size), AxisGrid(size, -(-size // ratio))
    scale *= ratio  # narrower, and a kernel may fall between two samples
    blur = AxisBlur(source, target, scale, boundary, taps)  # type: ignore[arg-type]  # drawn from its two values
    double = np.dtype(np.float64)
    for band, expected in ((forward_band(blur, double), blur.matrix()), (adjoint_band(blur, double), blur.matrix().T)):
        actual = dense(band)
        height, width = expected.shape
        assert not np.any(actual[height:])
        assert not np.any(actual[:, width:])
        assert np.all(np.diff(band.starts) >= 0)
        # The matrix of a sampling onto itself is treated as symmetric, but computed to a rounding or two only.
        np.testing.assert_allclose(actual[:height, :width], expected, rtol=0, atol=2 * np.finfo(np.float64).eps)


@given(st.integers(1, 200), st.floats(0.3, 9.0), st.sampled_from(["reflect", "zero"]), st.sampled_from([None, 5, 21]))
@example(64, 1.0, "reflect", None)
def test_symmetric_groups_hold_the_weights_of_their_band(
    size: int, scale: float, boundary: str, taps: int | None
) -> None:
    grid = AxisGrid(size, size)
    blur = AxisBlur(grid, grid, scale, boundary, taps)  # type: ignore[arg-type]  # drawn from its two values
    band = forward_band(blur, np.dtype(np.float64))
    symmetric, expected = band.symmetric, dense(band)
    actual = expected.copy()
    for group in symmetric.groups:
        for row in range(GROUP_ROWS * group, GROUP_ROWS * (group + 1)):
            centre = int(band.starts[group]) + symmetric.centre + row - GROUP_ROWS * group
            actual[row] = 0.0
            for distance, weight in enumerate(symmetric.kernel, symmetric.nearest):
                actual[row, centre - distance] += weight
                actual[row, centre + distance] += weight
    np.testing.assert_array_equal(actual, expected)


@pytest.mark.parametrize("scale", [1.0, 5.0])
def test_groups_are_symmetric_except_near_the_ends_of_the_axis(scale: float) -> None:
    grid = AxisGrid(256, 256)
    blur = AxisBlur(grid, grid, scale, "reflect")
    groups = forward_band(blur, np.dtype(np.float32)).symmetric.groups
    assert groups.start * GROUP_ROWS <= blur.radius + 2 * GROUP_ROWS
    assert groups.stop * GROUP_ROWS >= 256 - blur.radius - 2 * GROUP_ROWS


@given(
    st.tuples(st.integers(1, 90), st.integers(1, 90)), st.integers(1, 3), st.floats(0.5, 40.0),
    st.sampled_from(["reflect", "zero"]), st.sampled_from(DTYPES),
)  # fmt: skip
def test_inner_blurs_are_products_with_two_matrices(
    shape: tuple[int, int], ratio: int, scale: float, boundary: str, dtype: str
) -> None:
    pixels = PlaneGrid.pixels(*shape)
    sampled = PlaneGrid(*(AxisGrid(size, -(-size // ratio)) for size in shape))
    axes = ((pixels.rows, sampled.rows), (pixels.columns, sampled.columns))
    vertical, horizontal = (AxisBlur(*axis, ratio * scale, boundary) for axis in axes)  # type: ignore[arg-type]  # as above
    blur = InnerBlur.of(PlaneBlur(vertical, horizontal), np.dtype(dtype))
    workspace = Workspace(np.dtype(dtype))
    rng = np.random.default_rng(0)
    plane = rng.uniform(size=shape)
    cotangent = rng.uniform(size=(sampled.rows.cells, sampled.columns.cells))
    blurred = vertical.matrix() @ plane @ horizontal.matrix().T
    pulled = vertical.matrix().T @ cotangent @ horizontal.matrix()
    # All products are positive, so each of the sum(shape) roundings along both axes is relative to a partial sum.
    bound = 2 * sum(shape) * float(np.finfo(dtype).eps)
    np.testing.assert_allclose(blur.apply(plane.astype(dtype), workspace), blurred, rtol=bound, atol=bound)
    np.testing.assert_allclose(blur.adjoint(cotangent.astype(dtype), workspace), pulled, rtol=bound, atol=bound)


def both_backends(image: Host, reference: Host, scales: ScaleSpace, accuracy: str | float) -> list[tuple[float, Host]]:
    """Return value and gradient, computed by kernels and by array operations."""
    value, gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    with without_numba():
        expected, expected_gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    return [(float(value), gradient), (float(expected), expected_gradient)]


@given(problems(), st.sampled_from(["exact", "balanced"]))
def test_kernels_and_arrays_agree(problem: Problem, accuracy: str) -> None:
    image, reference, scales, dtype = problem
    image, reference = image.astype(dtype), reference.astype(dtype)
    (value, gradient), (expected, expected_gradient) = both_backends(image, reference, scales, accuracy)
    loss_bound, gradient_bound = max_differences(image, reference, scales)
    assert abs(value - expected) <= loss_bound
    assert np.abs(gradient - expected_gradient).sum() <= gradient_bound
    assert abs(float(LOIObjective(reference, scales, accuracy).value(image)) - expected) <= loss_bound


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("preset", ["path", "released"])
@pytest.mark.parametrize("content", KINDS)
def test_kernels_and_arrays_agree_where_blurs_pass_through_pyramids(content: str, preset: str, dtype: str) -> None:
    reference, image = (planes.astype(dtype) for planes in CONTENTS[content]((48, 63, 1), np.random.default_rng(1)))
    released = ScaleSpace.released((1, 5), (1, 5, 15), 8, 61)
    scales = released if preset == "released" else ScaleSpace.paper("path")
    for accuracy in ("exact", 5e-2):
        (value, gradient), (expected, expected_gradient) = both_backends(image, reference, scales, accuracy)
        loss_bound, gradient_bound = max_differences(image, reference, scales)
        assert abs(value - expected) <= loss_bound
        assert np.abs(gradient - expected_gradient).sum() <= gradient_bound


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("p", [0.4, 0.5, 2.0, 5.0])
def test_kernels_and_arrays_agree_on_every_power(p: float, dtype: str) -> None:
    reference, image = (
        planes.astype(dtype) for planes in CONTENTS["photographs"]((40, 31, 3), np.random.default_rng(2))
    )
    scales = ScaleSpace((0, 2), (0, 1, 6), (0.125, 0.25), p=p)
    (value, gradient), (expected, expected_gradient) = both_backends(image, reference, scales, "exact")
    loss_bound, gradient_bound = max_differences(image, reference, scales)
    assert abs(value - expected) <= loss_bound
    assert np.abs(gradient - expected_gradient).sum() <= gradient_bound


@given(
    st.integers(1, 120), st.integers(1, 120), st.sampled_from(["exact", "balanced", 5e-2]),
    st.sampled_from(["zero", "reflect"]), st.sampled_from([1, 2**12, 2**14]), st.data(),
)  # fmt: skip
def test_the_size_of_chunks_changes_no_bit_of_the_gradient(
    height: int, width: int, accuracy: str | float, boundary: str, max_bytes: int, data: st.DataObject
) -> None:
    image, reference = np.random.default_rng(0).uniform(size=(2, height, width, 1)).astype(np.float32)
    top, left = data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))
    image[:top], image[:, :left] = reference[:top], reference[:, :left]  # a window is compared, or everything
    scales = ScaleSpace((0, 3), (0, 1, 4, 15), 0.25, boundary=boundary)  # type: ignore[arg-type]  # of its two values
    value, gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schedule, "MAX_CHUNK_BYTES", max_bytes)
        chunked, chunked_gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    np.testing.assert_array_equal(gradient, chunked_gradient)
    # Costs are summed chunk by chunk: a sum of positive numbers may be rounded as often as it has terms.
    assert chunked == pytest.approx(float(value), rel=image.size * float(np.finfo(np.float32).eps), abs=0.0)


def test_kernels_are_compiled_once_for_a_dtype_whatever_the_layout() -> None:
    # Numba would compile again, for seconds, for arrays that are not contiguous or not writable.
    rng = np.random.default_rng(0)
    image, reference = rng.uniform(size=(2, 2, 3, 12, 16))
    unblurred = ScaleSpace(0, (0, 1), 0.125)
    LOIObjective(reference[0], unblurred, channel_axis=0).value_and_grad(image[0])
    compiled = set(compare_levels.signatures)  # type: ignore[attr-defined]  # an attribute of Numba; includes signatures of other tests
    for axis in (-1, -3, 0):
        moved = [np.moveaxis(planes, 1, axis) for planes in (image, reference)]
        for first, second in (moved, [np.asfortranarray(planes) for planes in moved]):
            first.setflags(write=False)
            LOIObjective(second, unblurred, channel_axis=axis).value_and_grad(first)
    LOIObjective(reference[0, 0], unblurred, channel_axis=None).value_and_grad(image[0, 0].T.copy().T)
    assert set(compare_levels.signatures) == compiled  # type: ignore[attr-defined]


@given(st.integers(1, 6), st.integers(1, 48), st.sampled_from(DTYPES), SEEDS)
def test_rows_are_transposed(groups: int, width: int, dtype: str, seed: int) -> None:
    stride, height = 64, GROUP_ROWS * groups
    source, target = Plane(0, stride), Plane(32 * stride, stride)
    for transpose in (rows.transpose, rows.plain_transpose):
        workspace = np.random.default_rng(seed).uniform(size=(128, stride)).astype(dtype)
        expected = workspace[:height, :width].T.copy()
        transpose(workspace.ravel(), source, width, groups, target)
        np.testing.assert_array_equal(workspace[32 : 32 + width, :height], expected)
    assert height + SQUARE_SIDE <= 32


OTHER_NUMBA = """
import numba.extending
def changed(*_, **__):
    raise AttributeError("as in another Numba")
numba.extending.intrinsic = changed
import numpy as np
from loi_core import LOIObjective, ScaleSpace
from loi_core.method.dispatch import NUMBA, choose_backend
image, reference = np.random.default_rng(0).uniform(size=(2, 40, 30, 1))
value = LOIObjective(reference, ScaleSpace.paper("path")).value(image)
from loi_core.method.compiled import rows
print(repr(float(value)), choose_backend(image) is NUMBA, rows.transpose is rows.plain_transpose)
"""


@pytest.mark.skipif(not THOROUGH, reason="compiles all kernels again; in the thorough tier")
def test_kernels_compile_with_a_numba_whose_intrinsics_have_changed(tmp_path: Path) -> None:
    image, reference = np.random.default_rng(0).uniform(size=(2, 40, 30, 1))
    expected = float(LOIObjective(reference, ScaleSpace.paper("path")).value(image))
    value, compiled, plain = program_output(OTHER_NUMBA, NUMBA_CACHE_DIR=str(tmp_path)).split()
    assert (compiled, plain) == ("True", "True")
    assert float(value) == pytest.approx(expected, rel=1e-12)


@given(st.tuples(st.integers(1, 30), st.integers(1, 30)), SEEDS, st.sampled_from(DTYPES))
def test_an_image_has_the_same_gradient_bits_in_any_batch(shape: tuple[int, int], seed: int, dtype: str) -> None:
    rng = np.random.default_rng(seed)
    batch, reference = rng.uniform(size=(2, 3, *shape, 2)).astype(dtype)
    changed = batch.copy()
    changed[0], changed[2] = 0.5 * batch[0], reference[2]
    objective = LOIObjective(reference, ScaleSpace.for_image(*shape))
    expected, gradient = (objective.value_and_grad(images)[1][1] for images in (batch, changed))
    np.testing.assert_array_equal(gradient, expected)

"""Compiled kernels compute what operations on whole arrays do, for any caller and on any number of threads."""

from __future__ import annotations

from pathlib import Path

import mpmath
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

pytest.importorskip("numba")

from loi_core import LOIObjective, ScaleSpace
from loi_core.method.blurs import PlaneBlur, PlaneGrid
from loi_core.method.compiled import compiling, plain_rows, program, vector_rows
from loi_core.method.compiled.arena import Arena
from loi_core.method.compiled.bands import Band, band_back, band_forth
from loi_core.method.compiled.exponential import exponential
from loi_core.method.compiled.inner import InnerBlur
from loi_core.method.compiled.levels import compare_levels
from loi_core.method.compiled.records import GROUP, PAIRS, Plane
from loi_core.method.gaussian import AxisBlur, AxisGrid
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
    got = exponentials(values)
    assert got.dtype == values.dtype
    wanted = np.asarray([float(mpmath.exp(mpmath.mpf(float(value)))) for value in values])
    assert np.max(np.abs(got / wanted - 1.0)) <= 2.0 * np.finfo(dtype).eps


def dense(band: Band) -> Host:
    """The matrix that a band is of, with the columns beyond its last."""
    matrix = np.zeros((GROUP * len(band.starts), band.height))
    for group, start in enumerate(band.starts):
        rows = slice(GROUP * group, GROUP * (group + 1))
        matrix[rows, start : start + band.taps] = band.weights[group].T
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
    for band, wanted in ((band_forth(blur, double), blur.matrix()), (band_back(blur, double), blur.matrix().T)):
        got = dense(band)
        rows, columns = wanted.shape
        assert not np.any(got[rows:])
        assert not np.any(got[:, columns:])
        assert np.all(np.diff(band.starts) >= 0)
        # The matrix of a sampling onto itself is symmetric, and taken as that, but computed to a rounding or two only.
        np.testing.assert_allclose(got[:rows, :columns], wanted, rtol=0, atol=2 * np.finfo(np.float64).eps)


@given(st.integers(1, 200), st.floats(0.3, 9.0), st.sampled_from(["reflect", "zero"]), st.sampled_from([None, 5, 21]))
@example(64, 1.0, "reflect", None)
def test_pairs_hold_the_same_weights_with_half_as_many_products(
    size: int, scale: float, boundary: str, taps: int | None
) -> None:
    grid = AxisGrid(size, size)
    blur = AxisBlur(grid, grid, scale, boundary, taps)  # type: ignore[arg-type]  # drawn from its two values
    band = band_forth(blur, np.dtype(np.float64))
    pairs, wanted = band.pairs, dense(band)
    got = wanted.copy()
    for group in pairs.groups:
        for row in range(GROUP * group, GROUP * (group + 1)):
            middle = int(band.starts[group]) + pairs.middle + row - GROUP * group
            got[row] = 0.0
            for distance, weight in enumerate(pairs.half, pairs.nearest):
                got[row, middle - distance] += weight
                got[row, middle + distance] += weight
    np.testing.assert_array_equal(got, wanted)


@pytest.mark.parametrize("scale", [1.0, 5.0])
def test_pairs_serve_all_rows_but_those_that_see_an_end(scale: float) -> None:
    grid = AxisGrid(256, 256)
    blur = AxisBlur(grid, grid, scale, "reflect")
    groups = band_forth(blur, np.dtype(np.float32)).pairs.groups
    assert groups.start * GROUP <= blur.radius + 2 * GROUP
    assert groups.stop * GROUP >= 256 - blur.radius - 2 * GROUP


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
    rows, columns = (AxisBlur(*axis, ratio * scale, boundary) for axis in axes)  # type: ignore[arg-type]  # as above
    blur, arena = InnerBlur.of(PlaneBlur(rows, columns), np.dtype(dtype)), Arena(np.dtype(dtype))
    rng = np.random.default_rng(0)
    plane = rng.uniform(size=shape)
    cotangent = rng.uniform(size=(sampled.rows.cells, sampled.columns.cells))
    blurred = rows.matrix() @ plane @ columns.matrix().T
    back = rows.matrix().T @ cotangent @ columns.matrix()
    # Products of positive numbers: each rounding, of at most so many along both axes, is of a part of the sum.
    bound = 2 * sum(shape) * float(np.finfo(dtype).eps)
    np.testing.assert_allclose(blur.apply(plane.astype(dtype), arena), blurred, rtol=bound, atol=bound)
    np.testing.assert_allclose(blur.adjoint(cotangent.astype(dtype), arena), back, rtol=bound, atol=bound)


def both_ways(image: Host, reference: Host, scales: ScaleSpace, accuracy: str | float) -> list[tuple[float, Host]]:
    """Value and gradient by kernels and by arrays."""
    value, gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    with without_numba():
        wanted, slopes = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    return [(float(value), gradient), (float(wanted), slopes)]


@given(problems(), st.sampled_from(["exact", "balanced"]))
def test_kernels_and_arrays_agree(problem: Problem, accuracy: str) -> None:
    image, reference, scales, dtype = problem
    image, reference = image.astype(dtype), reference.astype(dtype)
    (value, gradient), (wanted, slopes) = both_ways(image, reference, scales, accuracy)
    loss_bound, gradient_bound = max_differences(image, reference, scales)
    assert abs(value - wanted) <= loss_bound
    assert np.abs(gradient - slopes).sum() <= gradient_bound
    assert abs(float(LOIObjective(reference, scales, accuracy).value(image)) - wanted) <= loss_bound


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("preset", ["path", "released"])
@pytest.mark.parametrize("kind", KINDS)
def test_kernels_and_arrays_agree_where_blurs_pass_through_rungs(kind: str, preset: str, dtype: str) -> None:
    reference, image = (each.astype(dtype) for each in CONTENTS[kind]((48, 63, 1), np.random.default_rng(1)))
    released = ScaleSpace.released((1, 5), (1, 5, 15), 8, 61)
    scales = released if preset == "released" else ScaleSpace.paper("path")
    for accuracy in ("exact", 5e-2):
        (value, gradient), (wanted, slopes) = both_ways(image, reference, scales, accuracy)
        loss_bound, gradient_bound = max_differences(image, reference, scales)
        assert abs(value - wanted) <= loss_bound
        assert np.abs(gradient - slopes).sum() <= gradient_bound


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("p", [0.4, 0.5, 2.0, 5.0])
def test_kernels_and_arrays_agree_on_every_power(p: float, dtype: str) -> None:
    reference, image = (each.astype(dtype) for each in CONTENTS["photographs"]((40, 31, 3), np.random.default_rng(2)))
    scales = ScaleSpace((0, 2), (0, 1, 6), (0.125, 0.25), p=p)
    (value, gradient), (wanted, slopes) = both_ways(image, reference, scales, "exact")
    loss_bound, gradient_bound = max_differences(image, reference, scales)
    assert abs(value - wanted) <= loss_bound
    assert np.abs(gradient - slopes).sum() <= gradient_bound


@given(
    st.integers(1, 120), st.integers(1, 120), st.sampled_from(["exact", "balanced", 5e-2]),
    st.sampled_from(["zero", "reflect"]), st.sampled_from([1, 2**12, 2**14]), st.data(),
)  # fmt: skip
def test_how_much_is_blurred_together_changes_no_bit_of_the_gradient(
    height: int, width: int, accuracy: str | float, boundary: str, near: int, data: st.DataObject
) -> None:
    image, reference = np.random.default_rng(0).uniform(size=(2, height, width, 1)).astype(np.float32)
    top, left = data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))
    image[:top], image[:, :left] = reference[:top], reference[:, :left]  # all is compared, or a window
    scales = ScaleSpace((0, 3), (0, 1, 4, 15), 0.25, boundary=boundary)  # type: ignore[arg-type]  # of its two values
    value, gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program, "NEAR", near)
        other, slopes = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    np.testing.assert_array_equal(gradient, slopes)
    # Costs are summed strip by strip: a sum of positive numbers may be rounded as often as it has terms.
    assert other == pytest.approx(float(value), rel=image.size * float(np.finfo(np.float32).eps), abs=0.0)


def test_kernels_are_compiled_once_for_a_dtype_whatever_the_layout() -> None:
    # Numba compiles anew for arrays that are not contiguous, or that cannot be written to; that takes seconds.
    rng = np.random.default_rng(0)
    image, reference = rng.uniform(size=(2, 2, 3, 12, 16))
    unblurred = ScaleSpace(0, (0, 1), 0.125)
    LOIObjective(reference[0], unblurred, channel_axis=0).value_and_grad(image[0])
    compiled = set(compare_levels.signatures)  # type: ignore[attr-defined]  # Numba's own; with those of other tests
    for axis in (-1, -3, 0):
        moved = [np.moveaxis(each, 1, axis) for each in (image, reference)]
        for planes in (moved, [np.asfortranarray(each) for each in moved]):
            planes[0].setflags(write=False)
            LOIObjective(planes[1], unblurred, channel_axis=axis).value_and_grad(planes[0])
    LOIObjective(reference[0, 0], unblurred, channel_axis=None).value_and_grad(image[0, 0].T.copy().T)
    assert set(compare_levels.signatures) == compiled  # type: ignore[attr-defined]


@given(st.integers(1, 3), st.sampled_from([16, 48]), st.booleans(), st.sampled_from(DTYPES), SEEDS)
def test_plain_rows_are_those_of_vectors(threes: int, width: int, add: bool, dtype: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    half = rng.uniform(size=PAIRS * threes).astype(dtype)
    stride, rows = 64, 2 * PAIRS * threes + 2 * GROUP
    above, below = (PAIRS * (threes - 1)) * stride, (PAIRS * threes + GROUP) * stride
    arenas = [rng.uniform(size=64 * (rows + 32)).astype(dtype)]
    arenas.append(arenas[0].copy())
    made = Plane(rows * stride, stride)
    for module, arena in zip((vector_rows, plain_rows), arenas, strict=True):
        module.combine_pairs(half, arena, above, below, stride, made, width, add)
        module.transpose(arena, made, width, 2, Plane(made.at + 8 * stride, 16))
    eps = float(np.finfo(dtype).eps)
    np.testing.assert_allclose(arenas[0], arenas[1], rtol=0, atol=4.0 * half.size * eps * float(2.0 + half.sum()))


OTHER_NUMBA = """
import numba.extending
def changed(**_):
    raise AttributeError("as in another Numba")
numba.extending.intrinsic = changed
import numpy as np
from loi_core import LOIObjective, ScaleSpace
from loi_core.method.dispatch import NUMBA, choose_backend
image, reference = np.random.default_rng(0).uniform(size=(2, 40, 30, 1))
value = LOIObjective(reference, ScaleSpace.paper("path")).value(image)
from loi_core.method.compiled import rows
print(repr(float(value)), choose_backend(image) is NUMBA, rows.combine_pairs.__module__.rpartition(".")[2])
"""


@pytest.mark.skipif(not THOROUGH, reason="everything is compiled anew; in the thorough tier")
def test_with_a_numba_whose_vectors_have_changed_all_is_still_compiled(tmp_path: Path) -> None:
    image, reference = np.random.default_rng(0).uniform(size=(2, 40, 30, 1))
    wanted = float(LOIObjective(reference, ScaleSpace.paper("path")).value(image))
    value, compiled, module = program_output(OTHER_NUMBA, NUMBA_CACHE_DIR=str(tmp_path)).split()
    assert (compiled, module) == ("True", "plain_rows")
    assert float(value) == pytest.approx(wanted, rel=1e-12)


@given(st.tuples(st.integers(1, 30), st.integers(1, 30)), SEEDS, st.sampled_from(DTYPES))
def test_an_image_of_a_batch_has_the_same_bits_whatever_the_others_are(
    shape: tuple[int, int], seed: int, dtype: str
) -> None:
    rng = np.random.default_rng(seed)
    batch, reference = rng.uniform(size=(2, 3, *shape, 2)).astype(dtype)
    others = batch.copy()
    others[0], others[2] = 0.5 * batch[0], reference[2]
    objective = LOIObjective(reference, ScaleSpace.for_image(*shape))
    before, after = (objective.value_and_grad(one)[1][1] for one in (batch, others))
    np.testing.assert_array_equal(before, after)

"""Compiled kernels compute what operations on whole arrays do, for any caller and on any number of threads."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import array_api_strict
import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st

from loi_core import LOIObjective, ScaleSpace
from loi_core.method import compiled
from loi_core.method.blurs import PlaneBlur, PlaneGrid
from loi_core.method.compiled import CompiledLoopsWarning, compiling, program, threads
from loi_core.method.compiled.arena import Arena
from loi_core.method.compiled.bands import Band, band_back, band_forth
from loi_core.method.compiled.exponential import exponential
from loi_core.method.compiled.inner import InnerBlur
from loi_core.method.compiled.levels import compare_levels
from loi_core.method.compiled.loop_comparison import LoopComparison
from loi_core.method.compiled.records import GROUP
from loi_core.method.gaussian import AxisBlur, AxisGrid
from loi_core.method.ways import BY_ARRAYS, BY_LOOPS, way_for
from loi_core.support.arrays import Array
from tests.conformance.test_backends import Problem, apart, problems
from tests.contents import CONTENTS
from tests.helpers import Host, by_arrays

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
    with by_arrays():
        wanted, slopes = LOIObjective(reference, scales, accuracy).value_and_grad(image)
    return [(float(value), gradient), (float(wanted), slopes)]


@given(problems(), st.sampled_from(["exact", "balanced"]))
def test_kernels_and_arrays_agree(problem: Problem, accuracy: str) -> None:
    image, reference, scales, dtype = problem
    image, reference = image.astype(dtype), reference.astype(dtype)
    (value, gradient), (wanted, slopes) = both_ways(image, reference, scales, accuracy)
    loss_bound, gradient_bound = apart(image, reference, scales)
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
        loss_bound, gradient_bound = apart(image, reference, scales)
        assert abs(value - wanted) <= loss_bound
        assert np.abs(gradient - slopes).sum() <= gradient_bound


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("p", [0.4, 0.5, 2.0, 5.0])
def test_kernels_and_arrays_agree_on_every_power(p: float, dtype: str) -> None:
    reference, image = (each.astype(dtype) for each in CONTENTS["photographs"]((40, 31, 3), np.random.default_rng(2)))
    scales = ScaleSpace((0, 2), (0, 1, 6), (0.125, 0.25), p=p)
    (value, gradient), (wanted, slopes) = both_ways(image, reference, scales, "exact")
    loss_bound, gradient_bound = apart(image, reference, scales)
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


@given(st.integers(1, 90), st.integers(1, 90), st.sampled_from(DTYPES))
@example(1, 1, "float32")
@example(90, 90, "float64")
def test_threads_change_no_bit(height: int, width: int, dtype: str) -> None:
    rng = np.random.default_rng(0)
    image, reference = rng.uniform(size=(2, height, width, 3)).astype(dtype)
    objective = LOIObjective(reference, ScaleSpace.paper("path"), "balanced")
    found = []
    for count in (1, 2, 5):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(threads, "thread_count", lambda count=count: count)
            found.append(objective.value_and_grad(image))
    for value, gradient in found[1:]:
        assert value == found[0][0]
        np.testing.assert_array_equal(gradient, found[0][1])


def test_many_callers_at_once_get_what_one_gets() -> None:
    rng = np.random.default_rng(0)
    images, reference = rng.uniform(size=(6, 80, 70, 3)), rng.uniform(size=(80, 70, 3))
    objective = LOIObjective(reference, ScaleSpace.paper("path"))
    alone = [objective.value_and_grad(image) for image in images]
    with ThreadPoolExecutor(8) as callers:
        together = list(callers.map(objective.value_and_grad, np.concat([images] * 4)))
    for (value, gradient), (wanted, slopes) in zip(together, alone * 4, strict=True):
        assert value == wanted
        np.testing.assert_array_equal(gradient, slopes)


def test_kernels_are_compiled_once_for_a_dtype_whatever_the_layout() -> None:
    # Numba compiles anew for arrays that are not contiguous, or that cannot be written to; that takes seconds.
    rng = np.random.default_rng(0)
    image, reference = rng.uniform(size=(2, 2, 3, 12, 16))
    unblurred = ScaleSpace(0, (0, 1), 0.125)
    for axis in (-1, -3, 0):
        moved = [np.moveaxis(each, 1, axis) for each in (image, reference)]
        for planes in (moved, [np.asfortranarray(each) for each in moved]):
            planes[0].setflags(write=False)
            LOIObjective(planes[1], unblurred, channel_axis=axis).value_and_grad(planes[0])
    LOIObjective(reference[0, 0], unblurred, channel_axis=None).value_and_grad(image[0, 0].T.copy().T)
    signatures = compare_levels.signatures  # type: ignore[attr-defined]  # Numba's own
    assert len({signature[0].dtype for signature in signatures}) == len(signatures)


FORKS = """
import os, numpy as np
from loi_core import LOIObjective, ScaleSpace
from loi_core.method.compiled import compiling, threads
threads.thread_count = lambda: 3
image, reference = np.random.default_rng(0).uniform(size=(2, 80, 70, 3))
objective = LOIObjective(reference, ScaleSpace.paper("path"))
before = float(objective.value(image))
child = os.fork()
if child == 0:
    os._exit(0 if float(objective.value(image)) == before else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not fork")
def test_a_forked_process_starts_threads_of_its_own() -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORKS], capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stdout.strip() == "0"


LATE = """
import threading, numpy as np
from loi_core import LOIObjective, ScaleSpace
image, reference = np.random.default_rng(0).uniform(size=(2, 80, 70, 3))
def compare():
    threading.main_thread().join()
    print(float(LOIObjective(reference, ScaleSpace.paper("path")).value(image)) > 0)
threading.Thread(target=compare).start()
"""


def program_says(code: str, **environment: str) -> str:
    """What a program prints; warnings are written after it, and anything else on standard error is a failure."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
        env={**os.environ, "PYTHONWARNINGS": "always::RuntimeWarning", **environment},
    )
    return done.stdout.strip() + "".join(re.findall("CompiledLoopsWarning", done.stderr))


def test_a_thread_may_compare_after_the_main_one_has_ended() -> None:
    assert program_says(LATE) == "True"


FORKED_WHILE_PREPARING = """
import os, threading, time, numpy as np
from loi_core import LOIObjective, ScaleSpace
image, reference = np.random.default_rng(0).uniform(size=(2, 120, 90, 1))
def prepare(size):
    objective = LOIObjective(reference[:size], ScaleSpace.paper("path"), "fast")
    return float(objective.value_and_grad(image[:size])[0])
prepare(50)
hung = 0
for number in range(6):
    thread = threading.Thread(target=lambda: [prepare(60 + step) for step in range(30)])
    thread.start()
    time.sleep(0.004 * number)
    child = os.fork()
    if child == 0:
        prepare(70)
        os._exit(0)
    for _ in range(600):
        if os.waitpid(child, os.WNOHANG)[0]:
            break
        time.sleep(0.05)
    else:
        os.kill(child, 9)
        hung += 1
    thread.join()
print(hung)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not fork")
@pytest.mark.parametrize("switch", ["1", "0"])
def test_a_process_that_is_forked_while_another_thread_prepares_does_not_hang(switch: str) -> None:
    assert program_says(FORKED_WHILE_PREPARING, LOI_COMPILED=switch) == "0"


COMPARES = """
import sys, numpy as np
from loi_core import LOIObjective, ScaleSpace
image, reference = np.random.default_rng(0).uniform(size=(2, 40, 30, 1)).astype(np.float32)
objective = LOIObjective(reference, ScaleSpace(1, (1, 4), 0.25))
print(len({float(objective.value(image)) for _ in range(3)}), "numba" in sys.modules)
"""


def test_a_variable_keeps_numba_out() -> None:
    assert program_says(COMPARES, LOI_COMPILED="0") == "1 False"
    assert program_says(COMPARES, NUMBA_DISABLE_JIT="1") == "1 True"


def test_a_cache_that_is_damaged_costs_time_and_one_warning(tmp_path: Path) -> None:
    assert program_says(COMPARES, NUMBA_CACHE_DIR=str(tmp_path)) == "1 True"
    kept = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert kept
    for path in kept:
        os.truncate(path, path.stat().st_size // 2)
    assert program_says(COMPARES, NUMBA_CACHE_DIR=str(tmp_path)) == "1 TrueCompiledLoopsWarning"


def test_kernels_that_cannot_be_compiled_leave_it_to_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        message = "no space left on device"
        raise OSError(message)

    image, reference = np.random.default_rng(0).uniform(size=(2, 20, 30, 1))
    value = float(LOIObjective(reference).value(image))
    monkeypatch.setattr(compiled, "_NUMBA", compiled._Numba())
    monkeypatch.setattr(LoopComparison, "compare", full)
    with pytest.warns(CompiledLoopsWarning, match="OSError: no space left on device"):
        assert float(LOIObjective(reference).value(image)) == pytest.approx(value, rel=1e-12)
    assert not compiled.available()
    assert float(LOIObjective(reference).value(image)) == pytest.approx(value, rel=1e-12)  # without another warning


def test_an_error_of_ours_is_no_failure_of_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        message = "a mistake"
        raise ZeroDivisionError(message)

    image, reference = np.random.default_rng(0).uniform(size=(2, 20, 30, 1))
    objective = LOIObjective(reference)
    objective.value(image)
    monkeypatch.setattr(LoopComparison, "compare", fail)
    with pytest.raises(ZeroDivisionError, match="a mistake"):
        objective.value(image)
    assert compiled.available()


BROKEN = """
import importlib.abc, sys, time
class Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "numba":
            time.sleep(0.05)
            raise AttributeError("half of a Numba")
sys.meta_path.insert(0, Finder())
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from loi_core import LOIObjective
image, reference = np.random.default_rng(0).uniform(size=(2, 40, 30, 1))
objective = LOIObjective(reference)
with ThreadPoolExecutor(8) as threads:
    print(len(set(map(float, threads.map(objective.value, [image] * 16)))))
"""


def test_a_numba_that_cannot_be_imported_is_none_from_many_threads_at_once_too() -> None:
    assert program_says(BROKEN) == "1"


def test_what_fails_in_a_thread_is_raised() -> None:
    def fail(_: object) -> None:
        msg = "no"
        raise ArithmeticError(msg)

    with pytest.raises(ArithmeticError, match="no"):
        threads.run_all([fail] * 4, object)


@pytest.mark.parametrize(
    ("planes", "wanted"),
    [
        (np.zeros((1, 2, 2), np.float32), True),
        (torch.zeros((1, 2, 2), dtype=torch.float64), True),
        (torch.zeros((1, 2, 2), requires_grad=True), False),  # torch differentiates what follows
        (jnp.zeros((1, 2, 2), jnp.float32), True),
        (jnp.zeros((1, 2, 2), jnp.bfloat16), False),
        (array_api_strict.zeros((1, 2, 2)), False),
        (np.zeros((1, 2, 2), np.longdouble), False),
    ],
)
def test_kernels_are_for_host_arrays_that_no_framework_differentiates(planes: Array, wanted: bool) -> None:
    assert (way_for(planes) is BY_LOOPS) is wanted


def test_what_jax_traces_has_no_values_to_compare() -> None:
    served = []
    jax.jit(lambda planes: served.append(way_for(planes)))(jnp.zeros((1, 2, 2), jnp.float32))
    assert served == [BY_ARRAYS]


def test_without_numba_arrays_do_it_and_the_plan_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    objective = LOIObjective(np.zeros((4, 4, 3)))
    assert "Numba" in str(objective.plan())
    monkeypatch.setenv("LOI_COMPILED", "0")
    assert way_for(np.zeros((1, 2, 2))) is BY_ARRAYS
    assert "Numba" not in str(objective.plan())

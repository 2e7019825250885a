"""The gradient's error stays within the requested accuracy, and plans save work."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from loi_core import LogTone, LOIObjective, ScaleSpace
from loi_core.method.comparison import ComparisonResult
from loi_core.method.dispatch import ARRAY_API, NUMBA
from loi_core.method.gaussian import MATRICES, AxisBlur, AxisGrid, coarsest_spacing, equivalent_scale, pyramid_variance
from loi_core.method.plane_blurs import PlaneGrid
from loi_core.method.planner import make_plan
from loi_core.method.reference import loss_and_gradient
from loi_core.method.sampling_error import estimated_error
from loi_core.stability import allowed
from loi_core.testing import check_objective
from tests.contents import CONTENTS, HARD
from tests.frameworks import jax, loi_jax
from tests.helpers import Host, without_numba
from tests.strategies import SEEDS

# Problems are drawn with values beyond the bounds as well.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

EPS = float(np.finfo(np.float64).eps)
HEIGHTS = st.integers(16, 200)
PRESETS = st.sampled_from(["vector", "path", "raster", "for image", "released"])
KINDS = st.sampled_from(sorted(CONTENTS))


def scales_of(preset: str, height: int, width: int) -> ScaleSpace:
    if preset == "for image":
        return ScaleSpace.for_image(height, width)
    if preset == "released":
        return ScaleSpace.released((1, 5), (1, 5, 15, 45), 8, 61)
    return ScaleSpace.paper(preset)  # type: ignore[arg-type]  # one of the literals


def relative_error(gradient: Host, exact: Host) -> float:
    return float(np.linalg.norm(gradient - exact)) / max(float(np.linalg.norm(exact)), 1e-300)


@given(KINDS, PRESETS, st.sampled_from(["reflect", "zero"]), st.integers(1, 40), st.integers(1, 40), SEEDS)
def test_the_exact_loss_equals_the_reference_implementation(
    content: str, preset: str, boundary: str, height: int, width: int, seed: int
) -> None:
    image, reference = CONTENTS[content]((height, width, 2), np.random.default_rng(seed))
    scales = scales_of(preset, height, width)
    if preset not in ("released", "for image"):
        scales = ScaleSpace.paper(preset, boundary=boundary)  # type: ignore[arg-type]  # literals
    expected, expected_gradient = loss_and_gradient(image, reference, scales)
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    bound = allowed(image, reference, scales, EPS)
    assert abs(float(value) - expected) <= bound.loss
    assert np.abs(gradient - expected_gradient).sum() <= bound.norm


@given(
    st.sampled_from(sorted(CONTENTS | HARD)), PRESETS,
    st.sampled_from([("balanced", 1e-2), ("fast", 5e-2), (0.2, 0.2), (1e-3, 1e-3)]), HEIGHTS, HEIGHTS, SEEDS,
)  # fmt: skip
@example("waves", "raster", ("balanced", 1e-2), 128, 128, 3)
@example("stripes", "path", ("fast", 5e-2), 200, 190, 1)
@example("checkerboards", "vector", ("balanced", 1e-2), 160, 128, 5)
@example("a disk nearly there", "path", ("balanced", 1e-2), 128, 128, 1)
@example("a box nearly there", "raster", ("balanced", 1e-2), 128, 128, 2)
def test_the_error_of_the_gradient_is_within_every_accuracy(
    content: str, preset: str, accuracy: tuple[str | float, float], height: int, width: int, seed: int
) -> None:
    image, reference = (CONTENTS | HARD)[content]((height, width, 1), np.random.default_rng(seed))
    scales = scales_of(preset, height, width)
    exact = LOIObjective(reference, scales).value_and_grad(image)[1]
    gradient = LOIObjective(reference, scales, accuracy[0]).value_and_grad(image)[1]
    assert relative_error(gradient, exact) <= accuracy[1]


@given(
    st.sampled_from(sorted(HARD)), st.sampled_from([1e-3, 1e-2, 5e-2]), st.floats(1.0, 400.0), st.floats(0.0, 30.0),
    st.integers(100, 160), SEEDS,
)  # fmt: skip
@example("waves", 1e-2, 300.0, 1.0, 128, 0)
def test_the_error_of_a_single_scale_of_any_width_is_within_the_tolerance(
    content: str, tolerance: float, alpha: float, sigma: float, size: int, seed: int
) -> None:
    # Where a wide blur leaves almost nothing of a difference, no other scale hides its error.
    image, reference = HARD[content]((size, size, 1), np.random.default_rng(seed))
    scales = ScaleSpace(sigma, alpha, 0.125)
    exact = LOIObjective(reference, scales).value_and_grad(image)[1]
    gradient = LOIObjective(reference, scales, tolerance).value_and_grad(image)[1]
    assert relative_error(gradient, exact) <= tolerance


@pytest.mark.parametrize("policy", ["mask", "tone"])
@given(st.sampled_from(sorted(CONTENTS)), st.sampled_from(["path", "for image"]), st.sampled_from([1e-2, 5e-2]), SEEDS)
def test_the_error_of_masked_and_toned_gradients_is_within_the_tolerance(
    policy: str, content: str, preset: str, rtol: float, seed: int
) -> None:
    # A mask removes pixels, and a tone curve weights them, after the comparison.
    rng = np.random.default_rng(seed)
    image, reference = CONTENTS[content]((160, 130, 1), rng)
    options: dict[str, Any] = {"tone": LogTone(peak=1.0, compression=1000.0)}
    if policy == "mask":
        options = {"nan_policy": "mask"}
        image = np.where(rng.uniform(size=image.shape) < 0.02, image, np.nan)
    scales = scales_of(preset, 160, 130)
    exact = LOIObjective(reference, scales, **options).value_and_grad(image)[1]
    gradient = LOIObjective(reference, scales, rtol, **options).value_and_grad(image)[1]
    assert relative_error(gradient, exact) <= rtol


@given(st.sampled_from(sorted(CONTENTS | HARD)), st.sampled_from(["float32", "float64"]), SEEDS)
def test_kernels_and_arrays_estimate_the_same_error(content: str, dtype: str, seed: int) -> None:
    pytest.importorskip("numba")
    reference, image = (CONTENTS | HARD)[content]((150, 140, 1), np.random.default_rng(seed))
    reference, image = reference.astype(dtype), image.astype(dtype)
    scales = ScaleSpace.paper("path")
    plan = LOIObjective(reference, scales, "balanced").plan()
    planes = [np.moveaxis(np.clip(pixels, 0.0, 1.0), -1, 0) for pixels in (image, reference)]
    comparisons = NUMBA.comparison(scales, plan, planes[1]), ARRAY_API.comparison(scales, plan, planes[1])
    results = [comparison.compare(planes[0], gradient=True) for comparison in comparisons]
    assert plan.is_sampled
    errors = [estimated_error(result.sign_errors) for result in results]
    # A sample at the tie threshold, or a zero line midway between two pixels, may be rounded to either side.
    assert errors[0] == pytest.approx(errors[1], rel=0.05, abs=1e-3 * max_norm(results[0], planes[0]))


def max_norm(result: ComparisonResult, planes: Host) -> float:
    """Return the 2-norm of a gradient where all signs of all scales agree."""
    return len(result.terms) / math.sqrt(planes.size)


def test_traced_arrays_are_compared_exactly_at_every_accuracy() -> None:
    reference, image = CONTENTS["photographs"]((150, 140, 1), np.random.default_rng(0))
    scales = ScaleSpace.paper("path")
    with without_numba():
        compare = jax.jit(jax.grad(partial(loi_jax.loi_loss, scales=scales, accuracy="balanced")))
        gradient = np.asarray(compare(image.astype(np.float32), reference.astype(np.float32)))
        exact = LOIObjective(reference.astype(np.float32), scales).value_and_grad(image.astype(np.float32))[1]
    np.testing.assert_allclose(gradient, exact, rtol=0, atol=2e-3 * np.abs(exact).max())


def test_the_error_of_truncated_kernels_on_a_large_image_is_within_the_tolerance() -> None:
    # 121 taps truncate an extent of 45 pixels at 1.3 standard deviations; small images are sampled finely anyway.
    image, reference = CONTENTS["shifted"]((1024, 1024, 1), np.random.default_rng(0))
    scales = ScaleSpace.released((1, 5), (15, 45), 8, 121)
    exact = LOIObjective(reference, scales).value_and_grad(image)[1]
    for accuracy, tolerance in (("balanced", 1e-2), ("fast", 5e-2)):
        gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)[1]
        assert relative_error(gradient, exact) <= tolerance


@given(st.floats(2.0, 50.0), st.floats(0.1, 0.8))
def test_the_equivalent_scale_of_a_truncated_kernel_is_smaller(scale: float, relative_spacing: float) -> None:
    spacing = relative_spacing * scale
    whole, truncated = (2 * math.ceil(radius * scale) + 1 for radius in (8.0, 1.3))
    # Correlations are interpolated between whole pixels.
    assert math.isclose(equivalent_scale(scale, whole, spacing), scale, rel_tol=1.0 / spacing**2 + 1e-9)
    assert equivalent_scale(scale, truncated, spacing) < 0.9 * scale


@pytest.mark.parametrize("accuracy", ["balanced", "fast"])
@pytest.mark.parametrize("preset", ["path", "vector", "for image"])
def test_the_gradient_matches_differences_of_the_value_at_every_accuracy(accuracy: str, preset: str) -> None:
    shape = (48, 64, 1)
    check_objective(lambda reference: LOIObjective(reference, scales_of(preset, *shape[:2]), accuracy), shape=shape)


@given(st.floats(1.0, 60.0), st.integers(2, 300), st.sampled_from([EPS, 2.0**-23]))
@example(7.0, 79, EPS)
def test_a_blur_through_a_pyramid_equals_the_direct_blur_in_its_tails(scale: float, size: int, eps: float) -> None:
    spacing = coarsest_spacing(scale, eps)
    pixels, coarser = AxisGrid(size, size), AxisGrid(size, math.ceil(size / spacing))
    assume(spacing >= 2.0)
    variance = pyramid_variance(spacing, eps)
    down = AxisBlur(pixels, coarser, math.sqrt(variance), "reflect", truncate=20.0).matrix()
    up = AxisBlur(coarser, pixels, math.sqrt(scale**2 - variance), "reflect", truncate=20.0).matrix()
    expected = AxisBlur(pixels, pixels, scale, "reflect", truncate=20.0).matrix()
    min_weight = 1e-30
    tested = expected > min_weight * expected.max()
    # An exponent is the square of a rounded quotient: off by 1.5 roundings of itself, in either of the two matrices.
    exponents = 2.0 * 1.5 * -math.log(min_weight) * EPS / 2.0
    # The ripple of one sampling, the normalisation of the coarse kernel, and the rounding of the sums.
    np.testing.assert_allclose((up @ down)[tested], expected[tested], rtol=2.0 * eps + exponents + 64.0 * EPS)


@pytest.mark.parametrize("scale", [45.0, 1e6])
def test_an_extent_wider_than_the_image_has_a_single_sample(scale: float) -> None:
    plan = make_plan(ScaleSpace(1.0, scale, 0.125), 12, 16, tolerance=0.0, eps=EPS)
    assert plan.inner[0].extents[0].blur.target == PlaneGrid(AxisGrid(12, 1), AxisGrid(16, 1))


@given(PRESETS, st.integers(1, 300), st.integers(1, 300))
def test_exact_plans_compare_every_pixel_and_every_level(preset: str, height: int, width: int) -> None:
    plan = make_plan(scales_of(preset, height, width), height, width, tolerance=0.0, eps=2.0**-23)
    assert plan.error == 0.0
    assert all((tonal.first, tonal.last) == (0, tonal.count) for tonal in plan.tonal)
    for inner in plan.inner:
        for extent in inner.extents:
            flat = extent.alpha >= 2.7 * max(height, width) or inner.sigma >= 2.7 * max(height, width)
            assert flat or extent.blur.target == PlaneGrid.pixels(height, width)


@given(PRESETS, st.sampled_from([16, 64, 256, 1024, 2048]), st.floats(1e-4, 0.3))
def test_a_looser_tolerance_never_takes_more_work(preset: str, size: int, tolerance: float) -> None:
    scales = scales_of(preset, size, size)
    exact, loose = (make_plan(scales, size, size, tolerance=rtol, eps=2.0**-23) for rtol in (0.0, tolerance))
    assert loose.work <= exact.work


def test_distances_of_another_order_are_compared_exactly() -> None:
    scales = ScaleSpace(1.0, (5.0, 15.0), 0.125, p=2.0)
    assert make_plan(scales, 128, 128, tolerance=0.05, eps=EPS) == make_plan(scales, 128, 128, tolerance=0.0, eps=EPS)


def test_work_grows_in_proportion_to_the_pixels() -> None:
    small, large = (make_plan(ScaleSpace.paper("path"), n, n, tolerance=1e-2, eps=2.0**-23).work for n in (256, 2048))
    assert large / small <= 1.15 * 64


def test_a_plan_prints_a_row_for_every_pair_of_scales() -> None:
    scales = ScaleSpace.paper("path")
    plan = LOIObjective(np.zeros((64, 96, 3)), scales, "balanced").plan()
    lines = str(plan).splitlines()
    rows = [line.split() for line in lines[2 : -2 if plan.compiled else -1]]
    assert [(float(row[0]), float(row[1])) for row in rows] == [(s, a) for s in scales.sigma for a in scales.alpha]


@pytest.mark.parametrize("backend", [nullcontext, without_numba])
def test_peak_memory_is_below_four_stacks_of_levels(backend: Callable[[], AbstractContextManager[None]]) -> None:
    shape = (256, 256, 3)
    rng = np.random.default_rng(3)
    image, reference = (rng.uniform(size=shape).astype(np.float32) for _ in range(2))
    scales = ScaleSpace.paper("path")
    stack = scales.level_count(0.125) * image.nbytes
    with backend():  # compiles without tracing, which would take a minute
        LOIObjective(reference[:16], scales, "balanced").value_and_grad(image[:16])
    tracemalloc.start()
    try:
        with backend():
            objective = LOIObjective(reference, scales, "balanced")
            objective.value_and_grad(image)
            tracemalloc.reset_peak()
            objective.value_and_grad(image)
        current, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert current < peak <= 4 * stack


def test_caches_of_operators_are_bounded() -> None:
    pytest.importorskip("numba")
    for size in range(40, 60):
        for backend in (nullcontext, without_numba):
            with backend():
                LOIObjective(np.zeros((size, size, 1)), ScaleSpace.paper("path")).value(np.zeros((size, size, 1)))
    elements = MATRICES.elements
    LOIObjective(np.ones((59, 59, 1)), ScaleSpace.paper("path")).value(np.zeros((59, 59, 1)))
    assert MATRICES.elements == elements
    assert 0 < elements <= 2**24

"""Tests of the comparison that XLA keeps as loops: results equal to whole arrays, programs of bounded size."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from loi_core import ScaleSpace
from loi_core.method.array_comparison import ArrayComparison
from loi_core.method.comparison import ComparisonResult
from loi_core.method.plan import Plan
from loi_core.method.planner import make_plan
from loi_jax import scan_comparison
from loi_jax.scan_comparison import ScanComparison
from tests.strategies import FEWER_EXAMPLES, SEEDS

EPS = float(np.finfo(np.float32).eps)
PATH = ScaleSpace.paper("path")
QUICK = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}  # most of the time compiles
SCALES = [
    ScaleSpace.for_image(23, 17),
    replace(PATH, centred=True),
    replace(ScaleSpace((0.0, 2.0), (0.0, 3.0), (0.125, 0.3), boundary="zero"), p=2.0),
    ScaleSpace.released((1, 5), (1, 5), 8, 21),
]


def planes(seed: int, count: int, height: int, width: int) -> list[Any]:
    """Return planes of two images that differ in brightness, so that few differences are near a tie, and weights."""
    rng = np.random.default_rng(seed)
    image, reference = rng.uniform(size=(2, count, height, width)) * 0.6 + np.array([0.0, 0.4]).reshape(2, 1, 1, 1)
    weights = np.round(rng.uniform(size=(count, height, width)), 1)
    return [jnp.asarray(array, np.float32) for array in (image, reference, weights)]


def by_whole_arrays(scales: ScaleSpace, plan: Plan, *arrays: Any) -> ComparisonResult:
    """Return the result of NumPy for an image, a reference, and weights or None."""
    image, reference, weights = (None if array is None else np.asarray(array) for array in arrays)
    return ArrayComparison.of(scales, plan, reference, weights).compare(image, gradient=True)


@settings(FEWER_EXAMPLES, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(SEEDS, st.sampled_from(SCALES), st.booleans(), st.sampled_from([1, 5000, 10**6]))
def test_scanned_levels_and_mapped_planes_equal_whole_arrays(
    monkeypatch: pytest.MonkeyPatch, seed: int, scales: ScaleSpace, weighted: bool, elements: int
) -> None:
    monkeypatch.setattr(scan_comparison, "MAX_ELEMENTS", elements)  # from one level of one plane to everything
    monkeypatch.setattr(scan_comparison, "MAX_DENSE_CELLS", 8)
    monkeypatch.setattr(scan_comparison, "BLOCK_CELLS", 6)
    image, reference, weights = planes(seed, 3, 23, 17)
    plan = make_plan(scales, 23, 17, tolerance=0.0, eps=EPS, weighted=weighted)
    used = weights if weighted else None
    expected = by_whole_arrays(scales, plan, image, reference, used)
    assert expected.cotangent is not None

    @partial(jax.jit, compiler_options=QUICK)
    def compare(image: Any, reference: Any) -> Any:
        result = ScanComparison(scales, plan, reference, used).compare(image, gradient=True)
        return result.terms, result.cotangent

    terms, cotangent = compare(image, reference)
    assert terms.keys() == expected.terms.keys()
    for key, term in expected.terms.items():
        np.testing.assert_allclose(terms[key], term, rtol=1e-5)
    assert np.linalg.norm(cotangent - expected.cotangent) <= 1e-3 * np.linalg.norm(expected.cotangent)


def test_the_value_needs_no_gradient() -> None:
    image, reference, _ = planes(0, 2, 23, 17)
    scales = SCALES[0]
    plan = make_plan(scales, 23, 17, tolerance=0.0, eps=EPS)

    @partial(jax.jit, compiler_options=QUICK)
    def compare(image: Any, reference: Any) -> Any:
        result = ScanComparison(scales, plan, reference).compare(image, gradient=False)
        assert result.cotangent is None
        return result.terms

    terms = compare(image, reference)
    expected = by_whole_arrays(scales, plan, image, reference, None)
    for key, term in expected.terms.items():
        np.testing.assert_allclose(terms[key], term, rtol=1e-5)


@pytest.mark.parametrize(
    "scales", [ScaleSpace.for_image, lambda *_: replace(PATH, sigma=(1.0,))], ids=["default", "path"]
)
def test_programs_do_not_grow_with_the_image(scales: Any) -> None:
    def operations(height: int, width: int) -> int:
        sized = scales(height, width)
        plan = make_plan(sized, height, width, tolerance=0.0, eps=EPS)

        def compare(image: Any, reference: Any) -> Any:
            return ScanComparison(sized, plan, reference).compare(image, gradient=True).cotangent

        planes = jnp.zeros((3, height, width), np.float32)
        return len(jax.jit(compare).trace(planes, planes).lower().as_text().splitlines())

    assert operations(720, 960) <= 1.2 * operations(240, 320)

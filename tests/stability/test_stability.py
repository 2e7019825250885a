"""Every hard case keeps every rule, on every backend and in every dtype.

The catalogue is `loi_core.stability.hard_cases`; `loi_core.stability.bounds` derives the error bounds. JAX compiles
each operation for each shape, and each case again under ``jit``, which takes seconds. Here JAX therefore runs the
cases of the usual shape and scales, in float32 only, and compiled the cases of :data:`COMPILED_CASES`;
``loi doctor --stability`` runs all.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import loi_mitsuba  # noqa: F401 - before Dr.Jit, so that it gets an LLVM that works

# isort: split
import array_api_strict
import jax.numpy as jnp
import numpy as np
import pytest
import torch

from loi_core import LOIObjective, ScaleSpace
from loi_core.method.reference import DOUBLE, loss_and_gradient
from loi_core.plugins.measurement_backends import Evaluate, MeasurementBackend, NumPy, Request
from loi_core.stability import (
    STABILITY_CHECKS,
    HardCase,
    StabilityRow,
    allowed,
    hard_cases,
    stability_rows,
)
from loi_core.stability.trial import Trial, dtypes_of, try_case
from loi_core.support.arrays import Array, to_numpy
from loi_jax.backend import Jax
from loi_mitsuba.backend import Mitsuba
from loi_torch.backend import Torch
from tests.helpers import Host, without_numba
from tests.method.precise import precise

CASES = {case.name: case for case in hard_cases()}
COMPILED_CASES = ("ordinary pair", "one NaN", "one NaN, masked", "batch with one bad image, masked")
LARGE_CASES = ("3x4096", "a sum of 1e7 terms", "beta 0.0001")


class CoreBackend:
    """The core on arrays of one library, without an adapter."""

    compiled = False

    def __init__(self, asarray: Any, dtypes: tuple[str, ...], half_dtypes: tuple[str, ...] = ()) -> None:
        self.asarray = asarray
        self.dtypes = dtypes
        self.half_dtypes = half_dtypes

    def device(self) -> str:
        return "cpu"

    def prepare(self, request: Request) -> Evaluate:
        objective = LOIObjective(request.reference, request.scales, request.accuracy, nan_policy=request.nan_policy)
        image = self.converted(request.image, request.dtype)

        def evaluate() -> tuple[float, Host]:
            value, gradient = objective.value_and_grad(image)
            assert gradient.dtype == value.dtype == image.dtype
            return float(value), to_numpy(gradient)

        return evaluate

    def converted(self, image: Host, dtype: str) -> Array:
        if dtype not in self.half_dtypes:
            return self.asarray(image.astype(dtype))
        single = self.asarray(image.astype("float32"))
        return single.to(getattr(torch, dtype)) if isinstance(single, torch.Tensor) else single.astype(dtype)


class JaxWithoutNumba(Jax):
    """JAX's own compiler."""

    def prepare(self, request: Request) -> Evaluate:
        evaluate = super().prepare(request)

        def within() -> tuple[float, Host]:
            with without_numba():  # the first call compiles
                return evaluate()

        return within


BACKENDS: dict[str, MeasurementBackend] = {
    "NumPy": NumPy(),
    "array_api_strict": CoreBackend(array_api_strict.asarray, ("float32", "float64")),
    "torch": CoreBackend(Torch().asarray, ("float32", "float64"), ("float16", "bfloat16")),
    "torch autograd": Torch(),
    "JAX": CoreBackend(jnp.asarray, ("float32", "float64"), ("float16", "bfloat16")),
    "JAX, jit": Jax(),
    "JAX, jit, without Numba": JaxWithoutNumba(),
    "Dr.Jit": Mitsuba(),
}


def cases_of(backend: str) -> list[HardCase]:
    if backend.startswith("JAX, jit"):
        return [CASES[name] for name in COMPILED_CASES]
    if backend == "JAX":
        usual = CASES["ordinary pair"]
        return [
            case
            for case in CASES.values()
            if case.scales == usual.scales and case.make()[0].shape == usual.make()[0].shape
        ]
    if backend in ("NumPy", "torch autograd"):
        return list(CASES.values())
    return [case for name, case in CASES.items() if name not in LARGE_CASES]


def tried_dtypes(case: HardCase, backend: str) -> tuple[str, ...]:
    if backend.startswith("JAX"):
        half = ("float16", "bfloat16") if (case.name, backend) == ("ordinary pair", "JAX") else ()
        return ("float32", *half)
    return dtypes_of(case, BACKENDS[backend])


def trials(backend: str) -> list[Trial]:
    """All cases on one backend."""
    return [
        try_case(case, backend, BACKENDS[backend], dtype)
        for case in cases_of(backend)
        for dtype in tried_dtypes(case, backend)
    ]


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_hard_case_keeps_every_rule(backend: str) -> None:
    supported = [trial for trial in trials(backend) if not trial.unsupported]
    assert supported
    findings = {
        (check.rule, f"{trial.case} in {trial.dtype}"): check.finding(trial)
        for check in STABILITY_CHECKS
        for trial in supported
    }
    assert {names: finding for names, finding in findings.items() if finding} == {}


def test_the_catalogue_is_complete() -> None:
    names = [case.name for case in hard_cases()]
    assert len(set(names)) == len(names)
    assert len({case.danger for case in hard_cases()}) > 40
    for text in ("identical", "one pixel", "flat against flat", "all black", "all white", "just inside", "just beyond"):
        assert any(text in name for name in names), text
    terms = [_terms(case) for case in hard_cases() if case.error is None]
    assert max(terms) >= 1e7
    channels = {case.make()[0].shape[-1] for case in hard_cases()}
    assert {1, 2, 3, 16} <= channels
    levels = {case.scales.level_count(beta) for case in hard_cases() for beta in case.scales.beta}
    assert {1, 2, 1024} <= levels
    assert {1e-4, 1e-3, 1e-2, 1.0, 10.0} <= {beta for case in hard_cases() for beta in case.scales.beta}


def _terms(case: HardCase) -> int:
    return max(case.scales.level_count(beta) for beta in case.scales.beta) * case.make()[0].size


def test_a_row_is_loose_if_its_bound_is_as_large_as_the_gradient() -> None:
    cases = [CASES[name] for name in ("flat against flat", "ties", "reference plus 1e-7")]
    verdicts = {(row.case, row.dtype): row.verdict for row in stability_rows(cases, {"NumPy": NumPy()})}
    assert verdicts["flat against flat", "float32"] == "ok"
    assert verdicts["ties", "float32"] == verdicts["ties", "float64"] == "loose"
    assert (verdicts["reference plus 1e-7", "float32"], verdicts["reference plus 1e-7", "float64"]) == ("loose", "ok")


class Broken(NumPy):
    """A backend with corrupted results."""

    def __init__(self, corrupt: Callable[[float, Host], tuple[float, Host]]) -> None:
        self._corrupt = corrupt

    def prepare(self, request: Request) -> Evaluate:
        evaluate = super().prepare(request)
        return lambda: self._corrupt(*evaluate())


@pytest.mark.parametrize(
    ("case", "rule", "corrupt"),
    [
        ("ordinary pair", "finite", lambda value, slope: (value, slope * np.where(slope > 0.0, 1.0, np.nan))),
        ("ordinary pair", "not negative", lambda value, slope: (-value, slope)),
        ("identical images", "zero", lambda value, slope: (value + 1e-30, slope)),
        ("ordinary pair", "loss", lambda value, slope: (1.001 * value, slope)),
        ("flat against flat", "gradient", lambda value, slope: (value, 1.001 * slope)),
        ("one NaN, masked", "still", lambda value, slope: (value, slope + np.float32(1e-30))),
        ("batch", "apart", lambda value, slope: (value, slope * np.float32(1.0 + slope.mean()))),
        ("one NaN", "answered", None),
        ("8-bit integers", "answered", None),
    ],
)
def test_every_stability_rule_can_be_broken(case: str, rule: str, corrupt: Any) -> None:
    if corrupt is None:
        trial = try_case(dataclasses.replace(CASES[case], error=KeyError), "broken", NumPy(), "float32")
    else:
        trial = try_case(CASES[case], "broken", Broken(corrupt), "float32")
    assert [check.name for check in STABILITY_CHECKS if check.name == rule and check.finding(trial)] == [rule]
    assert StabilityRow.of(trial).verdict == "FAILED"


@pytest.mark.parametrize(
    "name",
    [
        *("beta 0.0001", "beta 10", "sigma and alpha ten times the image", "denormal radiance", "fireflies of 1e30"),
        *("radiance up to 1e4", "bounds far from zero", "p = 2"),
    ],
)
def test_the_plain_sum_is_correct_to_the_last_digits(name: str) -> None:
    case, crop = CASES[name], (slice(3, 5), slice(7, 9), slice(1))
    scales = case.scales
    if name == "beta 0.0001":  # forty digits of ten thousand levels take long
        crop, scales = (slice(1), slice(1), slice(1)), ScaleSpace(0.0, 0.0, 1e-4)
    image, reference = (array[crop] for array in case.make())
    value, gradient = loss_and_gradient(image, reference, scales)
    bound = allowed(image, reference, scales, DOUBLE)
    expected, slopes = precise(image[..., 0], reference[..., 0], scales)
    assert abs(value - expected) <= 0.5 * bound.loss  # the other half covers the rounding of a backend
    assert np.abs(gradient[..., 0] - slopes).sum() <= 0.5 * bound.norm

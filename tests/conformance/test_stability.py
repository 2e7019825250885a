"""Hard cases stay stable: on every backend, in every dtype, whatever the catalogue holds.

The catalogue is `loi_core.testing.hard_cases`, the bounds are derived in `loi_core.testing.bounds`. Compiling takes JAX
about a second for each case, so compiled JAX runs those of :data:`COMPILED` in float32 here; ``loi doctor --stability``
runs all of them.
"""

from __future__ import annotations

import functools
from typing import Any

import loi_mitsuba  # noqa: F401 - before Dr.Jit, so that it gets an LLVM that works

# isort: split
import array_api_strict
import jax.numpy as jnp
import pytest
import torch

from loi_core import LOIObjective, ScaleSpace
from loi_core.arrays import Array, to_numpy
from loi_core.backends import Backend, Evaluate, NumPy
from loi_core.nonfinite import NanPolicy
from loi_core.testing import PROPERTIES, HardCase, StabilityProperty, hard_cases
from loi_core.testing.stability import Trial, trials_of, try_case
from loi_jax.backend import Jax
from loi_mitsuba.backend import Mitsuba
from loi_torch.backend import Torch
from tests.helpers import Host

CASES = {case.name: case for case in hard_cases()}
COMPILED = ("ordinary pair", "one NaN", "one NaN, masked", "fireflies of 1e30", "batch with one bad image, masked")
LARGE = ("3x4096", "a sum of 1e7 terms", "beta 0.0001")


class OfCore:
    """The core on arrays of one library, without a bridge."""

    compiled = False

    def __init__(self, asarray: Any, dtypes: tuple[str, ...], half_dtypes: tuple[str, ...] = ()) -> None:
        self.asarray = asarray
        self.dtypes = dtypes
        self.half_dtypes = half_dtypes

    def device(self) -> str:
        return "cpu"

    def prepare(
        self,
        image: Host,
        reference: Host,
        scales: ScaleSpace,
        accuracy: str | float,
        dtype: str,
        nan_policy: NanPolicy = "raise",
    ) -> Evaluate:
        objective = LOIObjective(reference, scales, accuracy, nan_policy=nan_policy)
        given = self.held(image, dtype)

        def evaluate() -> tuple[float, Host]:
            value, gradient = objective.value_and_grad(given)
            assert gradient.dtype == value.dtype == given.dtype
            return float(value), to_numpy(gradient)

        return evaluate

    def held(self, image: Host, dtype: str) -> Array:
        if dtype not in self.half_dtypes:
            return self.asarray(image.astype(dtype))
        single = self.asarray(image.astype("float32"))
        return single.to(getattr(torch, dtype)) if isinstance(single, torch.Tensor) else single.astype(dtype)


BACKENDS: dict[str, Backend] = {
    "NumPy": NumPy(),
    "array_api_strict": OfCore(array_api_strict.asarray, ("float32", "float64")),
    "torch": OfCore(Torch().asarray, ("float32", "float64"), ("float16", "bfloat16")),
    "torch autograd": Torch(),
    "JAX": OfCore(jnp.asarray, ("float32", "float64"), ("float16", "bfloat16")),
    "JAX, jit": Jax(),
    "Dr.Jit": Mitsuba(),
}


def cases_of(backend: str) -> list[HardCase]:
    if backend == "JAX, jit":
        return [CASES[name] for name in COMPILED]
    if backend in ("NumPy", "torch autograd"):
        return list(CASES.values())
    return [case for name, case in CASES.items() if name not in LARGE]


@functools.cache
def trials(backend: str) -> list[Trial]:
    """All cases on one backend, once for all of the statements below."""
    found = []
    for case in cases_of(backend):
        dtypes = trials_of(case, BACKENDS[backend])
        found += [
            try_case(case, backend, BACKENDS[backend], dtype) for dtype in dtypes[: 1 if "jit" in backend else None]
        ]
    return found


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("rule", PROPERTIES, ids=str)
def test_every_case_keeps_the_rule(rule: StabilityProperty, backend: str) -> None:
    broken = {f"{one.case} in {one.dtype}": rule.test(one) for one in trials(backend) if not one.not_held}
    assert {name: finding for name, finding in broken.items() if finding} == {}, rule.rule

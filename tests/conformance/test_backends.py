"""Every backend gives the same loss and gradient, for whatever hypothesis can think of.

How far apart two backends may be is derived in `loi_core.stability.bounds`: each is that close to the plain sum.

With a tone curve T all this is said of T(image) and T(reference), and of the gradient by T(image), which is that by the
image over T'. Logarithms of two libraries differ by up to 4 eps, which is a shift of the intensities.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import loi_mitsuba  # before Dr.Jit, so that it gets an LLVM that works

# isort: split
import array_api_strict
import drjit as dr
import jax
import jax.numpy as jnp
import mitsuba as mi
import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st

import loi_jax
import loi_torch
from loi_core import LogTone, LOIObjective, ScaleSpace
from loi_core.support.arrays import sum_of_all
from tests.helpers import Host, by_arrays
from tests.strategies import FEWER, Problem, apart, problems, thorough

# Problems are drawn with values beyond the bounds as well.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

LOGARITHM = 4.0
COMPILED = 50  # problems for which JAX keeps what it compiled: it compiles for each shape anew, and memory would fill
Pair = tuple[Host, Host]
Backend = Callable[[Host, Host, ScaleSpace, LogTone | None], Pair]


def numpy_arrays(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    with by_arrays():
        value, gradient = LOIObjective(reference, scales, tone=tone).value_and_grad(image)
    return np.asarray(value), gradient


def strict(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    objective = LOIObjective(array_api_strict.asarray(reference), scales, tone=tone)
    value, gradient = objective.value_and_grad(array_api_strict.asarray(image))
    return np.asarray(value), np.asarray(gradient)


def torch_core(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    value, gradient = LOIObjective(torch.tensor(reference), scales, tone=tone).value_and_grad(torch.tensor(image))
    return value.numpy(), gradient.numpy()


def torch_autograd(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    leaf: Any = torch.tensor(image, requires_grad=True)
    value = loi_torch.LOILoss(torch.tensor(reference), scales, tone=tone)(leaf)
    value.backward()
    assert leaf.grad is not None
    return value.detach().numpy(), leaf.grad.numpy()


jax_calls = itertools.count(1)


def jax_eager(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    if next(jax_calls) % COMPILED == 0:
        jax.clear_caches()  # type: ignore[no-untyped-call]  # untyped in JAX
    both: Any = jax.value_and_grad(loi_jax.loi_loss(reference, scales, tone=tone))
    value, gradient = both(jnp.asarray(image))
    return np.asarray(value), np.asarray(gradient)


def jax_arrays(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    with by_arrays():
        return jax_eager(image, reference, scales, tone)


def drjit_autodiff(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    mi.set_variant("llvm_ad_rgb")
    tensor = mi.TensorXf(image)
    dr.enable_grad(tensor)
    value = loi_mitsuba.LOILoss(reference, scales, tone=tone)(tensor)
    dr.backward(value)
    return value.numpy()[0], dr.grad(tensor).numpy()


BACKENDS: dict[str, Backend] = {
    "NumPy without Numba": numpy_arrays,
    "array_api_strict": strict,
    "torch": torch_core,
    "torch autograd": torch_autograd,
    "JAX": jax_eager,
    "Dr.Jit": drjit_autodiff,
}


TIE = np.full((3, 3, 1), 0.5)
STEP = np.repeat(np.array([0.1, 0.1, 0.8]), 3).reshape(3, 3, 1)
FLAT = np.full((12, 9, 2), 0.3)  # equal entries in axes so short that XLA would add them all one after another


TONES = (None, LogTone(1.0), LogTone(30.0, 100.0))
HARD: tuple[tuple[Problem, LogTone | None], ...] = (
    ((TIE, TIE, ScaleSpace(1, (1, 5), 0.125), "float32"), None),
    ((STEP, STEP[::-1].copy(), ScaleSpace(0, (1, 5), 0.125), "float32"), None),
    ((FLAT, 3.0 * FLAT, ScaleSpace(0, (0, 1), 0.125), "float32"), None),
    ((FLAT, 3.0 * FLAT, ScaleSpace(0, (0, 1), 0.125), "float64"), None),
    ((1e4 * STEP, 1e30 * STEP[::-1], ScaleSpace(0, (1, 5), 0.125), "float32"), LogTone(1.0)),
)


def hard_problems(test: Callable[..., None]) -> Callable[..., None]:
    """Try these in any case."""
    for problem, tone in HARD:
        test = example(problem, tone)(test)
    return test


@given(problems(), st.sampled_from(TONES))
@hard_problems
def test_every_backend_gives_the_loss_and_gradient_of_numpy(problem: Problem, tone: LogTone | None) -> None:
    check(problem, tone, BACKENDS)


@thorough  # JAX compiles anew for each shape; tests/stability compiles one of each case
@FEWER
@given(problems(), st.sampled_from(TONES))
@hard_problems
def test_so_does_what_jax_compiles(problem: Problem, tone: LogTone | None) -> None:
    check(problem, tone, {"JAX without Numba": jax_arrays})


def check(problem: Problem, tone: LogTone | None, backends: dict[str, Backend]) -> None:
    image, reference, scales, dtype = problem
    image, reference = image.astype(dtype), reference.astype(dtype)
    value, gradient = LOIObjective(reference, scales, tone=tone).value_and_grad(image)
    steepness = np.ones_like(image)
    if tone is None:
        loss_bound, gradient_bound = apart(image, reference, scales)
    else:
        steepness = tone.pullback(image, steepness)
        shift = LOGARITHM * max(map(abs, scales.bounds))
        loss_bound, gradient_bound = apart(tone.apply(image), tone.apply(reference), scales, shift)
        gradient_bound += LOGARITHM * float(np.finfo(dtype).eps) * float(np.abs(gradient / steepness).sum())
    for name, backend in backends.items():
        if name == "Dr.Jit" and dtype == "float64":
            continue  # its tensors hold float32 only in the variants that people use
        other, slopes = backend(image, reference, scales, tone)
        assert other.dtype == slopes.dtype == np.dtype(dtype), name
        assert slopes.shape == image.shape, name
        assert abs(float(other) - float(value)) <= loss_bound, name
        assert float(np.abs((slopes - gradient) / steepness).sum()) <= gradient_bound, name


@given(st.lists(st.integers(1, 32), min_size=1, max_size=4), st.floats(0.01, 1.0))
@example([13, 11, 5, 3], 0.35)
def test_a_sum_of_equal_entries_is_off_by_few_roundings_whatever_their_number(sizes: list[int], entry: float) -> None:
    while np.prod(sizes) > 2**16:
        sizes = sizes[1:]
    host = np.full(sizes, entry)
    exact = float(np.longdouble(entry) * host.size)
    sums = {
        "NumPy": sum_of_all(host),
        "torch": sum_of_all(torch.tensor(host)),
        "JAX": sum_of_all(jnp.asarray(host)),
        "JAX, jit": jax.jit(sum_of_all)(jnp.asarray(host)),
    }
    for name, total in sums.items():
        # Of n equal entries, added one after another, the k-th sum is rounded by k eps / 2 of an entry at the most.
        assert abs(float(total) - exact) <= len(sizes) * (32 / 4 + 1) * np.finfo(np.float64).eps * exact, name


@pytest.mark.parametrize(("dtype", "factor"), [("float64", 1e-6), ("float32", 1e-1)])
def test_the_bound_is_far_below_the_gradient(dtype: str, factor: float) -> None:
    # A backend whose gradient were off by this share would be caught on any ordinary pair of images.
    image, reference = np.random.default_rng(0).uniform(size=(2, 12, 12, 3)).astype(dtype)
    for scales in (ScaleSpace.paper("path"), ScaleSpace.for_image(12, 12), ScaleSpace.released((1, 5), (1, 5), 8, 21)):
        gradient = LOIObjective(reference, scales).value_and_grad(image)[1]
        assert apart(image, reference, scales)[1] < factor * float(np.abs(gradient).sum())

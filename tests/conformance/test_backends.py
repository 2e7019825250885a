"""Every backend returns the same loss and gradient, for random problems of hypothesis.

`loi_core.stability.bounds` derives the largest difference of each backend from the plain sum.

With a tone curve T the bounds apply to T(image) and T(reference), and to the gradient with respect to T(image), which
is the image's gradient divided by T'. Logarithms of two libraries differ by up to 4 eps, a shift of the intensities.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial
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
from tests.helpers import Host, without_numba
from tests.strategies import FEWER_EXAMPLES, Problem, max_differences, problems, thorough

# Problems are drawn with values beyond the bounds as well.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

LOGARITHM_ERROR_EPS = 4.0
PROBLEMS_PER_CACHE = 50  # after which JAX's compilation cache is cleared, which grows with each new shape
Pair = tuple[Host, Host]
Backend = Callable[[Host, Host, ScaleSpace, LogTone | None], Pair]


def numpy_arrays(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    with without_numba():
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
    value = loi_torch.LOILoss(scales, tone=tone)(leaf, torch.tensor(reference))
    value.backward()
    assert leaf.grad is not None
    return value.detach().numpy(), leaf.grad.numpy()


jax_calls = itertools.count(1)


def jax_eager(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    if next(jax_calls) % PROBLEMS_PER_CACHE == 0:
        jax.clear_caches()  # type: ignore[no-untyped-call]  # untyped in JAX
    value_and_grad: Any = jax.value_and_grad(partial(loi_jax.loi_loss, scales=scales, tone=tone))
    value, gradient = value_and_grad(jnp.asarray(image), reference)
    return np.asarray(value), np.asarray(gradient)


def jax_arrays(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    with without_numba():
        return jax_eager(image, reference, scales, tone)


def drjit_autodiff(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    mi.set_variant("llvm_ad_rgb")
    tensor = mi.TensorXf(image)
    dr.enable_grad(tensor)
    value = loi_mitsuba.loi_loss(tensor, reference, scales, tone=tone)
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
FLAT_IMAGE = np.full((12, 9, 2), 0.3)  # equal entries in axes so short that XLA would add them all in sequence


TONES = (None, LogTone(1.0), LogTone(30.0, 100.0))
HARD_PROBLEMS: tuple[tuple[Problem, LogTone | None], ...] = (
    ((TIE, TIE, ScaleSpace(1, (1, 5), 0.125), "float32"), None),
    ((STEP, STEP[::-1].copy(), ScaleSpace(0, (1, 5), 0.125), "float32"), None),
    ((FLAT_IMAGE, 3.0 * FLAT_IMAGE, ScaleSpace(0, (0, 1), 0.125), "float32"), None),
    ((FLAT_IMAGE, 3.0 * FLAT_IMAGE, ScaleSpace(0, (0, 1), 0.125), "float64"), None),
    ((1e4 * STEP, 1e30 * STEP[::-1], ScaleSpace(0, (1, 5), 0.125), "float32"), LogTone(1.0)),
)


def hard_problems(test: Callable[..., None]) -> Callable[..., None]:
    """Add the hard problems as explicit examples."""
    for problem, tone in HARD_PROBLEMS:
        test = example(problem, tone)(test)
    return test


@given(problems(), st.sampled_from(TONES))
@hard_problems
def test_every_backend_returns_the_loss_and_gradient_of_numpy(problem: Problem, tone: LogTone | None) -> None:
    check(problem, tone, BACKENDS)


@thorough  # JAX compiles again for each shape; tests/stability compiles some cases
@FEWER_EXAMPLES
@given(problems(), st.sampled_from(TONES))
@hard_problems
def test_jax_without_numba_returns_the_loss_and_gradient_of_numpy(problem: Problem, tone: LogTone | None) -> None:
    check(problem, tone, {"JAX without Numba": jax_arrays})


def check(problem: Problem, tone: LogTone | None, backends: dict[str, Backend]) -> None:
    image, reference, scales, dtype = problem
    image, reference = image.astype(dtype), reference.astype(dtype)
    value, gradient = LOIObjective(reference, scales, tone=tone).value_and_grad(image)
    steepness = np.ones_like(image)
    if tone is None:
        loss_bound, gradient_bound = max_differences(image, reference, scales)
    else:
        steepness = tone.pullback(image, steepness)
        shift = LOGARITHM_ERROR_EPS * max(map(abs, scales.bounds))
        loss_bound, gradient_bound = max_differences(tone.apply(image), tone.apply(reference), scales, shift)
        gradient_bound += LOGARITHM_ERROR_EPS * float(np.finfo(dtype).eps) * float(np.abs(gradient / steepness).sum())
    for name, backend in backends.items():
        if name == "Dr.Jit" and dtype == "float64":
            continue  # tensors of the usual variants hold float32
        backend_value, slopes = backend(image, reference, scales, tone)
        assert backend_value.dtype == slopes.dtype == np.dtype(dtype), name
        assert slopes.shape == image.shape, name
        assert abs(float(backend_value) - float(value)) <= loss_bound, name
        assert float(np.abs((slopes - gradient) / steepness).sum()) <= gradient_bound, name


@given(st.lists(st.integers(1, 32), min_size=1, max_size=4), st.floats(0.01, 1.0))
@example([13, 11, 5, 3], 0.35)
def test_the_rounding_error_of_a_sum_does_not_grow_with_its_number_of_entries(sizes: list[int], entry: float) -> None:
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
        # In a sequential sum of equal entries, the k-th partial sum has a rounding error of at most k eps / 2 entries.
        assert abs(float(total) - exact) <= len(sizes) * (32 / 4 + 1) * np.finfo(np.float64).eps * exact, name


@pytest.mark.parametrize(("dtype", "factor"), [("float64", 1e-6), ("float32", 1e-1)])
def test_the_gradient_bound_is_far_below_the_gradient(dtype: str, factor: float) -> None:
    # A backend with this relative error of the gradient would fail for any ordinary pair of images.
    image, reference = np.random.default_rng(0).uniform(size=(2, 12, 12, 3)).astype(dtype)
    for scales in (ScaleSpace.paper("path"), ScaleSpace.for_image(12, 12), ScaleSpace.released((1, 5), (1, 5), 8, 21)):
        gradient = LOIObjective(reference, scales).value_and_grad(image)[1]
        assert max_differences(image, reference, scales)[1] < factor * float(np.abs(gradient).sum())

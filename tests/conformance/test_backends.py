"""Every backend gives the same loss and gradient, for whatever hypothesis can think of.

The bound
---------
A loss is a mean over pixels of sums over L levels of spacing times |A F|, with F a difference of CDFs in [0, 1] and
A a blur whose rows sum to at most 1. Rounding to eps changes a CDF by at most (8 + 2) eps: eight levels carry a
pixel's mass, and each exponential is off by an ulp for its argument and one for itself. Blurs and means average what
they are given, so the errors of many entries do not add up. Their own roundings do: n equal entries, added one after
another, are off by n eps / 4 at the most, and JAX adds up to 32 so along each axis (`loi_core.arrays.sum_of_all`). With
up to 14 rows, 14 columns, 8 planes and 32 levels in a piece that is 17 eps, and 2 more for dividing by four lengths
(measured: 8 at the most, for four axes of 32; libraries that add in pairs stay below 2). 32 eps of the range of the
levels bounds the loss, with 3 left for blurs and for the sum over scales.

A gradient is a sum of signs of A F, times slopes of order 1 / beta, and as exact, except where a sign changes because
|A F| is within rounding of 0. The tie rule turns such signs to 0 alike on all backends, except in a sliver about its
threshold. There one sign, of weight w, may differ by 2, which changes the 1-norm of the gradient by at most
2 w max |slope| at its level, since the columns of A sum to at most 1. So gradients are compared in the 1-norm, and
these changes are added up over the entries of A F that lie in the sliver, as computed on the NumPy backend.

With a tone curve T all this is said of T(image) and T(reference), and of the gradient by T(image), which is that by the
image over T'. Logarithms of two libraries differ by up to 4 eps; that shifts a CDF, whose slope is at most 0.4 / beta,
and widens the sliver.
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
from loi_core.arrays import sum_of_all
from loi_core.distance import TIE_ROUNDINGS
from loi_core.layout import Layout
from loi_core.operators import blur_about, gaussian_blur
from loi_core.tonal import clip, soft_cdf_and_slope
from tests.helpers import Host

ROUNDINGS = 32.0
LOGARITHM = 4.0
COMPILED = 50  # problems for which JAX keeps what it compiled: it compiles for each shape anew, and memory would fill
CONTENTS = ("flat", "ramp", "step", "noise", "hdr", "saturated")
Pair = tuple[Host, Host]
Problem = tuple[Host, Host, ScaleSpace, str]


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


def drjit_autodiff(image: Host, reference: Host, scales: ScaleSpace, tone: LogTone | None) -> Pair:
    mi.set_variant("llvm_ad_rgb")
    tensor = mi.TensorXf(image)
    dr.enable_grad(tensor)
    value = loi_mitsuba.LOILoss(reference, scales, tone=tone)(tensor)
    dr.backward(value)
    return value.numpy()[0], dr.grad(tensor).numpy()


BACKENDS: dict[str, Callable[[Host, Host, ScaleSpace, LogTone | None], Pair]] = {
    "array_api_strict": strict,
    "torch": torch_core,
    "torch autograd": torch_autograd,
    "JAX": jax_eager,
    "Dr.Jit": drjit_autodiff,
}


@st.composite
def contents(draw: st.DrawFn, shape: tuple[int, ...]) -> Host:
    """An image of one of the kinds that renderers make."""
    kind = draw(st.sampled_from(CONTENTS))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    rows, columns = np.linspace(0, 1, shape[-3])[:, None, None], np.linspace(0, 1, shape[-2])[None, :, None]
    makers: dict[str, Callable[[], Host]] = {
        "flat": lambda: np.full(shape, rng.uniform()),
        "ramp": lambda: np.broadcast_to(0.7 * rows * rng.uniform() + 0.3 * columns, shape),
        "step": lambda: np.broadcast_to(np.where(columns > rng.uniform(), 0.8, 0.1) + 0.0 * rows, shape),
        "noise": lambda: rng.uniform(size=shape),
        "hdr": lambda: rng.exponential(size=shape) * 10.0 ** rng.integers(-2, 5),
        "saturated": lambda: rng.integers(0, 2, size=shape),
    }
    return np.array(makers[kind](), dtype=np.float64)


@st.composite
def problems(draw: st.DrawFn) -> Problem:
    """Two images of one shape, scales, and a dtype."""
    batch = draw(st.sampled_from([(), (), (1,), (2,), (2, 1)]))
    size = st.integers(1, 14)
    shape = (*batch, draw(size), draw(size), draw(st.integers(1, 4)))
    scale = st.sampled_from([0.0, 0.3, 1.0, 2.5, 5.0, 15.0, 100.0])
    some = st.lists(scale, min_size=1, max_size=3, unique=True)
    presets = [ScaleSpace.paper("vector"), ScaleSpace.paper("path"), ScaleSpace.for_image(*shape[-3:-1])]
    scales = draw(
        st.one_of(
            st.sampled_from([*presets, ScaleSpace.released((1, 5), (1, 5), 8, 21)]),
            st.builds(
                ScaleSpace,
                some,
                some,
                st.sampled_from([0.05, 0.125, 0.4]),
                boundary=st.sampled_from(["reflect", "zero"]),
                bounds=st.sampled_from([(0.0, 1.0), (-0.5, 2.0)]),
            ),
        )
    )
    image, reference = draw(contents(shape)), draw(contents(shape))
    if draw(st.booleans()):  # equal in some rows, where backends that look at values compute nothing
        image[..., draw(st.integers(0, shape[-3] - 1)) :, :, :] = 0.5
        reference = np.where(image == 0.5, image, reference)
    return image, reference, scales, draw(st.sampled_from(["float64", "float32"]))


def slivers(image: Host, reference: Host, scales: ScaleSpace, shift: float) -> float:
    """By how much the 1-norm of a gradient may change where libraries take different sides of the tie threshold.

    `shift` is what libraries may differ by in intensities already, in eps.
    """
    layout = Layout.of("image", image.shape, -1)
    planes = layout.to_planes(image)
    height, width = planes.shape[-2:]
    eps = float(np.finfo(image.dtype).eps)
    change = 0.0
    for sigma, beta in itertools.product(scales.sigma, scales.beta):
        inner = gaussian_blur(height, width, sigma, scales.boundary, like=planes, taps=scales.inner_taps)
        levels, mass = scales.levels(beta).astype(planes.dtype), scales.mass(beta)
        cdf, slope = soft_cdf_and_slope(
            blur_about(inner, clip(planes, *scales.bounds), scales.padding), levels, beta, mass
        )
        wanted = clip(layout.to_planes(reference), *scales.bounds)
        difference = cdf - soft_cdf_and_slope(blur_about(inner, wanted, scales.padding), levels, beta, mass)[0]
        steepest = np.abs(slope).max(axis=(-2, -1))
        total = mass / scales.spacing(beta)
        for alpha in scales.alpha:
            extent = gaussian_blur(height, width, alpha, scales.boundary, like=planes, taps=scales.extent_taps)
            size = np.abs(extent.apply(difference)) / (eps * total)
            # Rounding of A F itself is 32 eps at the very most; within that, any side is possible.
            near = np.count_nonzero(
                (size > 0.0) & (size < TIE_ROUNDINGS + ROUNDINGS + 2.0 * shift * 0.4 / beta), axis=(-2, -1)
            )
            change += (
                2.0 * float(np.sum(near * steepest)) * scales.level_weight(beta) * scales.scale_weight / image.size
            )
    return change


def allowed(image: Host, reference: Host, scales: ScaleSpace, shift: float = 0.0) -> tuple[float, float]:
    """Largest differences of the loss, and of the gradient in the 1-norm; see the text above."""
    eps = float(np.finfo(image.dtype).eps)
    loss = gradient = 0.0
    for _, beta, _ in scales.keys:
        total = scales.mass(beta) / scales.spacing(beta)
        weight = scales.level_weight(beta) * scales.scale_weight
        loss += ROUNDINGS * eps * total * weight * scales.level_count(beta)
        gradient += ROUNDINGS * eps * total * weight * scales.level_count(beta) / beta
    return loss, gradient + slivers(image, reference, scales, shift)


TIE = np.full((3, 3, 1), 0.5)
STEP = np.repeat(np.array([0.1, 0.1, 0.8]), 3).reshape(3, 3, 1)
FLAT = np.full((12, 9, 2), 0.3)  # equal entries in axes so short that XLA would add them all one after another


TONES = (None, LogTone(1.0), LogTone(30.0, 100.0))


@given(problems(), st.sampled_from(TONES))
@example((TIE, TIE, ScaleSpace(1, (1, 5), 0.125), "float32"), None)
@example((STEP, STEP[::-1].copy(), ScaleSpace(0, (1, 5), 0.125), "float32"), None)
@example((FLAT, 3.0 * FLAT, ScaleSpace(0, (0, 1), 0.125), "float32"), None)
@example((FLAT, 3.0 * FLAT, ScaleSpace(0, (0, 1), 0.125), "float64"), None)
@example((1e4 * STEP, 1e30 * STEP[::-1], ScaleSpace(0, (1, 5), 0.125), "float32"), LogTone(1.0))
def test_every_backend_gives_the_loss_and_gradient_of_numpy(problem: Problem, tone: LogTone | None) -> None:
    image, reference, scales, dtype = problem
    image, reference = image.astype(dtype), reference.astype(dtype)
    value, gradient = LOIObjective(reference, scales, tone=tone).value_and_grad(image)
    steepness = np.ones_like(image)
    if tone is None:
        loss_bound, gradient_bound = allowed(image, reference, scales)
    else:
        steepness = tone.pullback(image, steepness)
        shift = LOGARITHM * max(map(abs, scales.bounds))
        loss_bound, gradient_bound = allowed(tone.apply(image), tone.apply(reference), scales, shift)
        gradient_bound += LOGARITHM * float(np.finfo(dtype).eps) * float(np.abs(gradient / steepness).sum())
    for name, backend in BACKENDS.items():
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
        assert allowed(image, reference, scales)[1] < factor * float(np.abs(gradient).sum())

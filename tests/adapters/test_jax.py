"""The JAX function hands the core's gradient on under every transformation, and is traced once."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import loi_jax
from loi_core import LOIObjective, ScaleSpace
from loi_core.errors import DerivativeError, ImageError, ImageTypeError, NonFiniteImageError
from loi_core.method.tonal import accumulate
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import epsilon
from loi_core.testing import check_objective
from tests.helpers import images, without_numba
from tests.strategies import thorough

SCALES = ScaleSpace(1, (1, 5), 0.25)  # few: JAX compiles all that follows from them, in every test anew
IMAGE, REFERENCE = images((17, 23, 3), seed=1)
VALUE, GRADIENT = LOIObjective(REFERENCE, SCALES).value_and_grad(IMAGE)
Loss = Callable[[Any], Any]


@pytest.fixture(params=["kernels", "arrays"], autouse=True)
def way(request: pytest.FixtureRequest) -> Iterator[None]:
    """Each statement holds with Numba and without."""
    with without_numba() if request.param == "arrays" else nullcontext():
        yield


@pytest.fixture
def loss() -> Loss:
    """A new one for each test: what JAX has compiled it keeps."""
    return loi_jax.loi_loss(REFERENCE, SCALES)


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_value_and_gradient_are_those_of_the_core(loss: Loss, wrap: Any) -> None:
    image = jnp.asarray(IMAGE)
    assert float(wrap(loss)(image)) == pytest.approx(float(VALUE), rel=1e-13)
    value, gradient = wrap(jax.value_and_grad(lambda x: 3.0 * loss(x)))(image)
    assert float(value) == pytest.approx(3.0 * float(VALUE), rel=1e-13)
    np.testing.assert_allclose(gradient, 3.0 * GRADIENT, rtol=1e-11, atol=1e-17)


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_vmap_of_the_jax_objective_is_a_loop(loss: Loss, wrap: Any) -> None:
    batch = jnp.asarray(np.stack([IMAGE, 0.5 * IMAGE, REFERENCE]))
    values = wrap(jax.vmap(loss))(batch)
    np.testing.assert_allclose(values, [float(loss(one)) for one in batch], rtol=1e-12, atol=1e-15)
    gradients = wrap(jax.vmap(jax.grad(loss)))(batch)
    np.testing.assert_allclose(gradients, jnp.stack([jax.grad(loss)(one) for one in batch]), rtol=1e-10, atol=1e-16)


def test_jax_traces_the_objective_once_for_each_shape_and_dtype(loss: Loss) -> None:
    traces = 0

    @jax.jit
    def step(image: jax.Array) -> Any:
        nonlocal traces
        traces += 1
        return jax.grad(loss)(image)

    for scale in (1.0, 0.9, 0.8):
        step(scale * jnp.asarray(IMAGE))
    assert traces == 1
    step(jnp.asarray(IMAGE, dtype=jnp.float32))
    assert traces == 2


def test_nothing_leaks_from_one_trace_into_the_next() -> None:
    loss = loi_jax.loi_loss(REFERENCE, SCALES, nan_policy="mask")
    image = jnp.asarray(IMAGE)
    with jax.checking_leaks():
        first = jax.jit(loss)(image)
    again = jax.jit(jax.grad(loss))(image)
    assert float(first) == pytest.approx(float(VALUE))
    np.testing.assert_allclose(again, GRADIENT, rtol=1e-11, atol=1e-17)


@pytest.mark.parametrize("policy", ["raise", "mask"])
def test_nothing_leaks_from_an_objective_that_is_traced_itself(policy: NanPolicy) -> None:
    objective = LOIObjective(REFERENCE, SCALES, nan_policy=policy)
    image = jnp.asarray(IMAGE)
    wanted, slopes = objective.value_and_grad(image)
    bound = 1e3 * float(np.finfo(image.dtype).eps)  # of sums that are made in another order
    for _ in range(2):
        if policy == "raise":
            with pytest.raises(jax.errors.TracerBoolConversionError):  # its pixels cannot be looked at
                jax.jit(objective.value)(image)
        else:
            assert jax.jit(objective.value)(image) == pytest.approx(float(wanted), rel=bound)
            assert jax.vmap(objective.value)(image[None])[0] == pytest.approx(float(wanted), rel=bound)
        np.testing.assert_allclose(jax.grad(objective.value)(image), slopes, atol=bound * float(np.abs(slopes).max()))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float16, jnp.bfloat16])
def test_jax_compares_low_precision_in_float32(loss: Loss, dtype: Any) -> None:
    image = jnp.asarray(IMAGE, dtype=dtype)
    value, gradient = jax.jit(jax.value_and_grad(loss))(image)
    assert value.dtype == jnp.float32
    assert gradient.dtype == dtype
    wanted = LOIObjective(REFERENCE, SCALES).value(np.asarray(image.astype(jnp.float32)))
    assert float(value) == pytest.approx(float(wanted), rel=1e-5)


@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16])
@pytest.mark.parametrize("wrap", [pytest.param(lambda f: f, marks=thorough), jax.jit], ids=["eager", "jit"])
def test_a_gradient_is_scaled_before_it_is_rounded_to_16_bits(loss: Loss, dtype: Any, wrap: Any) -> None:
    batch = jnp.broadcast_to(jnp.asarray(IMAGE, dtype=dtype), (64, *IMAGE.shape))  # of small gradients: it is a mean
    slope = jax.grad(lambda images: 3072.0 * loss(images))
    wanted = np.asarray(slope(batch.astype(jnp.float32)))
    bound = 0.5 * epsilon(batch) * np.abs(wanted) + 1e-5 * np.abs(wanted).max()
    for found in (wrap(slope)(batch), wrap(jax.vmap(slope))(batch[None])[0]):
        assert found.dtype == dtype
        assert np.all(np.abs(np.asarray(found.astype(jnp.float32)) - wanted) <= bound)


def test_the_objective_works_with_64_bits_off() -> None:
    with jax.enable_x64(False):
        image = jnp.asarray(IMAGE)
        assert image.dtype == jnp.float32
        loss = loi_jax.loi_loss(REFERENCE, SCALES)
        np.testing.assert_allclose(jax.jit(jax.grad(loss))(image), GRADIENT, rtol=1e-2, atol=1e-6)
        assert float(loss(image)) == pytest.approx(float(VALUE), rel=1e-5)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_pixels_that_are_not_finite_raise_eagerly_and_poison_traces(loss: Loss, bad: float) -> None:
    image = jnp.asarray(IMAGE).at[3, 4, 1].set(bad)
    with pytest.raises(NonFiniteImageError, match=r"= \(3, 4, 1\)"):
        loss(image)
    value, gradient = jax.jit(jax.value_and_grad(loss))(image)
    assert np.isnan(value)
    assert np.all(np.isnan(gradient))
    masked = loi_jax.loi_loss(REFERENCE, SCALES, nan_policy="mask")
    value, gradient = jax.jit(jax.value_and_grad(masked))(image)
    assert np.isfinite(value)
    assert float(gradient[3, 4, 1]) == 0.0


def test_forward_mode_is_refused_and_errors_are_those_of_the_core(loss: Loss) -> None:
    image = jnp.asarray(IMAGE)
    for forward in (lambda: jax.jvp(loss, (image,), (image,)), lambda: jax.jacfwd(loss)(image)):
        with pytest.raises(DerivativeError, match="no forward mode"):
            forward()
    with pytest.raises(ImageError, match="does not fit"):
        jax.jit(loss)(jnp.zeros((5, 5, 3)))


@pytest.mark.parametrize("name", ["reference", "weights"])
def test_what_is_traced_is_no_reference(name: str) -> None:
    def traced(given: jax.Array) -> jax.Array:
        arguments: dict[str, Any] = {"reference": REFERENCE, name: given}
        return loi_jax.loi_loss(**arguments)(jnp.asarray(IMAGE))

    with pytest.raises(ImageTypeError, match=f"`{name}` must be concrete, got a tracer; make the loss outside"):
        jax.jit(traced)(jnp.asarray(REFERENCE))


def test_the_objective_conforms_on_jax_arrays() -> None:
    check_objective(lambda reference: LOIObjective(reference, SCALES), asarray=jnp.asarray)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("scales", [SCALES, ScaleSpace(0, (0, 2), 0.02, p=2.0)], ids=["p = 1", "p = 2"])
def test_equal_images_are_equal_also_where_one_is_compiled(scales: ScaleSpace, dtype: str) -> None:
    loss = loi_jax.loi_loss(REFERENCE.astype(dtype), scales)
    value, gradient = jax.jit(jax.value_and_grad(loss))(jnp.asarray(REFERENCE, dtype=dtype))
    assert float(value) == 0.0
    assert not np.any(gradient)


def test_what_is_compiled_does_not_grow_with_the_levels() -> None:
    def operations(levels: int) -> int:
        return len(jax.make_jaxpr(lambda stack: accumulate(stack)[0])(jnp.zeros((levels, 4))).eqns)

    assert operations(4096) < 3 * operations(64)  # 64 blocks of 64, side by side


@pytest.mark.parametrize("platform", ["cuda", "tpu"])
def test_products_keep_the_precision_of_their_dtype_on_accelerators(platform: str) -> None:
    """By default JAX rounds their factors there, to 10 bits or 7."""
    image = jnp.asarray(IMAGE, dtype=jnp.float32)
    loss = loi_jax.loi_loss(REFERENCE.astype(np.float32), SCALES)
    lowered = jax.jit(jax.value_and_grad(loss)).trace(image).lower(lowering_platforms=(platform,))
    products = [line for line in lowered.as_text().splitlines() if "dot_general" in line]
    assert products
    assert all("precision = [HIGHEST, HIGHEST]" in line for line in products)


def test_the_objective_can_be_pickled_and_copied(loss: Loss) -> None:
    image = jnp.asarray(IMAGE)
    pickled = pickle.loads(pickle.dumps(loss))  # noqa: S301  # of our own making
    for other in (pickled, copy.deepcopy(loss)):
        np.testing.assert_array_equal(jax.grad(other)(image), jax.grad(loss)(image))

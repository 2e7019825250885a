"""Tests of the JAX loss: the gradient of the core under every transformation, tracing, and low precision."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import loi_jax
from loi_core import LOIObjective, ScaleSpace, Target
from loi_core.errors import DerivativeError, ImageError, NonFiniteImageError
from loi_core.method.tonal import accumulate
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import epsilon
from loi_core.testing import check_objective
from tests.helpers import images, without_numba
from tests.strategies import thorough

SCALES = ScaleSpace(1, (1, 5), 0.25)  # few scales, because JAX compiles them again in every test
IMAGE, REFERENCE = images((17, 23, 3), seed=1)
VALUE, GRADIENT = LOIObjective(REFERENCE, SCALES).value_and_grad(IMAGE)
Loss = Callable[[Any], Any]


@pytest.fixture(params=["kernels", "arrays"], autouse=True)
def backend(request: pytest.FixtureRequest) -> Iterator[None]:
    """Run each test with Numba and without."""
    with without_numba() if request.param == "arrays" else nullcontext():
        yield


@pytest.fixture
def loss() -> Loss:
    """Return a new function of the image for each test, because JAX caches compiled functions."""
    return partial(loi_jax.loi_loss, target=REFERENCE, scales=SCALES)


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_the_jax_loss_takes_a_target_with_its_weights(wrap: Any) -> None:
    opacity = np.linspace(0.0, 1.0, 17 * 23).reshape(17, 23)
    target = Target(REFERENCE, opacity)
    expected = loi_jax.loi_loss(jnp.asarray(IMAGE), REFERENCE, SCALES, weights=opacity * 0.5)
    value = wrap(lambda image, weights: loi_jax.loi_loss(image, target, SCALES, weights=weights))
    assert value(jnp.asarray(IMAGE), jnp.full((17, 23), 0.5)) == pytest.approx(float(expected), rel=1e-6)


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_the_jax_loss_has_the_value_and_gradient_of_the_core(loss: Loss, wrap: Any) -> None:
    image = jnp.asarray(IMAGE)
    assert float(wrap(loss)(image)) == pytest.approx(float(VALUE), rel=1e-13)
    value, gradient = wrap(jax.value_and_grad(lambda x: 3.0 * loss(x)))(image)
    assert float(value) == pytest.approx(3.0 * float(VALUE), rel=1e-13)
    np.testing.assert_allclose(gradient, 3.0 * GRADIENT, rtol=1e-11, atol=1e-17)


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_vmap_of_the_jax_loss_equals_a_loop_over_images(loss: Loss, wrap: Any) -> None:
    batch = jnp.asarray(np.stack([IMAGE, 0.5 * IMAGE, REFERENCE]))
    values = wrap(jax.vmap(loss))(batch)
    np.testing.assert_allclose(values, [float(loss(image)) for image in batch], rtol=1e-12, atol=1e-15)
    gradients = wrap(jax.vmap(jax.grad(loss)))(batch)
    np.testing.assert_allclose(gradients, jnp.stack([jax.grad(loss)(image) for image in batch]), rtol=1e-10, atol=1e-16)


def test_jax_traces_the_loss_once_for_each_shape_and_dtype(loss: Loss) -> None:
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


def test_the_jax_loss_leaks_no_tracers_between_traces() -> None:
    loss = partial(loi_jax.loi_loss, target=REFERENCE, scales=SCALES, nan_policy="mask")
    image = jnp.asarray(IMAGE)
    with jax.checking_leaks():
        value = jax.jit(loss)(image)
    gradient = jax.jit(jax.grad(loss))(image)
    assert float(value) == pytest.approx(float(VALUE))
    np.testing.assert_allclose(gradient, GRADIENT, rtol=1e-11, atol=1e-17)


@pytest.mark.parametrize("policy", ["raise", "mask"])
def test_a_traced_objective_of_the_core_leaks_no_tracers(policy: NanPolicy) -> None:
    objective = LOIObjective(REFERENCE, SCALES, nan_policy=policy)
    image = jnp.asarray(IMAGE)
    expected, slopes = objective.value_and_grad(image)
    bound = 1e3 * float(np.finfo(image.dtype).eps)  # a compiled sum has another order of its terms
    for _ in range(2):
        if policy == "raise":
            with pytest.raises(jax.errors.TracerBoolConversionError):  # a check of the pixels needs values
                jax.jit(objective.value)(image)
        else:
            assert jax.jit(objective.value)(image) == pytest.approx(float(expected), rel=bound)
            assert jax.vmap(objective.value)(image[None])[0] == pytest.approx(float(expected), rel=bound)
        np.testing.assert_allclose(jax.grad(objective.value)(image), slopes, atol=bound * float(np.abs(slopes).max()))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float16, jnp.bfloat16])
def test_the_jax_loss_of_a_low_precision_image_is_float32(loss: Loss, dtype: Any) -> None:
    image = jnp.asarray(IMAGE, dtype=dtype)
    value, gradient = jax.jit(jax.value_and_grad(loss))(image)
    assert value.dtype == jnp.float32
    assert gradient.dtype == dtype
    expected = LOIObjective(REFERENCE, SCALES).value(np.asarray(image.astype(jnp.float32)))
    assert float(value) == pytest.approx(float(expected), rel=1e-5)


@pytest.mark.parametrize("dtype", [pytest.param(jnp.float16, marks=thorough), jnp.bfloat16])
@pytest.mark.parametrize("wrap", [pytest.param(lambda f: f, marks=thorough), jax.jit], ids=["eager", "jit"])
def test_the_jax_gradient_is_scaled_before_it_is_rounded_to_16_bits(loss: Loss, dtype: Any, wrap: Any) -> None:
    batch = jnp.broadcast_to(jnp.asarray(IMAGE, dtype=dtype), (64, *IMAGE.shape))  # the mean has small gradients
    slope = jax.grad(lambda images: 3072.0 * loss(images))
    expected = np.asarray(slope(batch.astype(jnp.float32)))
    bound = 0.5 * epsilon(batch) * np.abs(expected) + 1e-5 * np.abs(expected).max()
    for gradient in (wrap(slope)(batch), wrap(jax.vmap(slope))(batch[None])[0]):
        assert gradient.dtype == dtype
        assert np.all(np.abs(np.asarray(gradient.astype(jnp.float32)) - expected) <= bound)


def test_the_jax_loss_works_without_64_bit_mode() -> None:
    with jax.enable_x64(False):
        image = jnp.asarray(IMAGE)
        assert image.dtype == jnp.float32
        loss = partial(loi_jax.loi_loss, target=REFERENCE, scales=SCALES)
        np.testing.assert_allclose(jax.jit(jax.grad(loss))(image), GRADIENT, rtol=1e-2, atol=1e-6)
        assert float(loss(image)) == pytest.approx(float(VALUE), rel=1e-5)


@pytest.mark.parametrize("bad_value", [np.nan, np.inf])
def test_pixels_that_are_not_finite_raise_eagerly_and_give_nan_in_jit(loss: Loss, bad_value: float) -> None:
    image = jnp.asarray(IMAGE).at[3, 4, 1].set(bad_value)
    with pytest.raises(NonFiniteImageError, match=r"= \(3, 4, 1\)"):
        loss(image)
    value, gradient = jax.jit(jax.value_and_grad(loss))(image)
    assert np.isnan(value)
    assert np.all(np.isnan(gradient))
    masked = partial(loi_jax.loi_loss, target=REFERENCE, scales=SCALES, nan_policy="mask")
    value, gradient = jax.jit(jax.value_and_grad(masked))(image)
    assert np.isfinite(value)
    assert float(gradient[3, 4, 1]) == 0.0


def test_the_jax_loss_refuses_forward_mode_and_wrong_shapes(loss: Loss) -> None:
    image = jnp.asarray(IMAGE)
    for forward in (lambda: jax.jvp(loss, (image,), (image,)), lambda: jax.jacfwd(loss)(image)):
        with pytest.raises(DerivativeError, match="no forward mode"):
            forward()
    with pytest.raises(ImageError, match="does not fit `target`"):
        jax.jit(loss)(jnp.zeros((5, 5, 3)))


def test_a_target_may_be_traced_and_gets_no_gradient() -> None:
    pair: Any = jax.jit(jax.value_and_grad(partial(loi_jax.loi_loss, scales=SCALES)))
    for target in (REFERENCE, 0.5 * REFERENCE):
        expected, slopes = LOIObjective(target, SCALES).value_and_grad(IMAGE)
        value, gradient = pair(IMAGE, target)
        assert float(value) == pytest.approx(float(expected), rel=1e-13)
        np.testing.assert_allclose(gradient, slopes, rtol=1e-11, atol=1e-17)
    assert pair._cache_size() == 1
    for wrap in (lambda f: f, jax.jit):
        assert not np.any(wrap(jax.grad(partial(loi_jax.loi_loss, scales=SCALES), argnums=1))(IMAGE, REFERENCE))


def test_a_target_that_is_not_finite_raises_eagerly_and_gives_nan_in_jit() -> None:
    target = REFERENCE.copy()
    target[3, 4, 1] = np.inf
    with pytest.raises(NonFiniteImageError, match=r"`target` has 1 non-finite value of .* = \(3, 4, 1\)"):
        loi_jax.loi_loss(IMAGE, target, SCALES)
    pair = jax.jit(jax.value_and_grad(partial(loi_jax.loi_loss, scales=SCALES)))
    assert np.all(np.isnan(jnp.concat([jnp.ravel(result) for result in pair(IMAGE, target)])))
    covered = np.ones(IMAGE.shape[:2])
    covered[3, 4] = 0.0
    visible = jax.jit(partial(loi_jax.loi_loss, scales=SCALES, weights=covered))
    assert np.isfinite(visible(IMAGE, target))


@pytest.mark.parametrize("axes", [(0, 0), (0, None), (None, 0)])
def test_vmap_maps_image_and_target(axes: tuple[int | None, int | None]) -> None:
    batches = np.stack([IMAGE, 0.5 * IMAGE]), np.stack([REFERENCE, 0.9 * REFERENCE])
    arguments = [batch if axis == 0 else batch[0] for batch, axis in zip(batches, axes, strict=True)]
    mapped = jax.vmap(partial(loi_jax.loi_loss, scales=SCALES), in_axes=axes)
    expected = [
        float(LOIObjective(target, SCALES).value(image))
        for image, target in zip(*(np.broadcast_to(array, batches[0].shape) for array in arguments), strict=True)
    ]
    for wrap in (lambda f: f, jax.jit):
        np.testing.assert_allclose(wrap(mapped)(*arguments), expected, rtol=1e-12)


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_a_reduction_combines_the_losses_of_a_batch_on_jax(wrap: Any) -> None:
    batch, factors = np.stack([IMAGE, 0.5 * IMAGE]), np.array([2.0, -3.0])
    pairs = [LOIObjective(REFERENCE, SCALES).value_and_grad(image) for image in batch]
    values, slopes = (np.stack(parts) for parts in zip(*pairs, strict=True))

    def loss(reduction: Any) -> Any:
        return partial(loi_jax.loi_loss, target=REFERENCE, scales=SCALES, reduction=reduction)

    np.testing.assert_allclose(wrap(loss("none"))(batch), values, rtol=1e-12)
    assert float(wrap(loss("sum"))(batch)) == pytest.approx(values.sum(), rel=1e-12)
    gradient = wrap(jax.grad(lambda images: jnp.sum(factors * loss("none")(images))))(batch)
    np.testing.assert_allclose(gradient, factors[:, None, None, None] * slopes, rtol=1e-10, atol=1e-16)


def test_the_objective_conforms_on_jax_arrays() -> None:
    check_objective(lambda reference: LOIObjective(reference, SCALES), asarray=jnp.asarray)


@pytest.mark.parametrize("dtype", ["float32", pytest.param("float64", marks=thorough)])
@pytest.mark.parametrize("scales", [SCALES, ScaleSpace(0, (0, 2), 0.02, p=2.0)], ids=["p = 1", "p = 2"])
def test_the_compiled_jax_loss_of_equal_images_is_exactly_zero(scales: ScaleSpace, dtype: str) -> None:
    image = REFERENCE.astype(dtype)
    value, gradient = jax.jit(jax.value_and_grad(partial(loi_jax.loi_loss, scales=scales)))(image, image)
    assert float(value) == 0.0
    assert not np.any(gradient)


def test_the_jax_program_of_a_sum_over_levels_does_not_grow_with_the_levels() -> None:
    def operations(levels: int) -> int:
        return len(jax.make_jaxpr(lambda stack: accumulate(stack)[0])(jnp.zeros((levels, 4))).eqns)

    assert operations(4096) < 3 * operations(64)  # 64 blocks of 64 levels in parallel


@pytest.mark.parametrize("platform", ["cuda", "tpu"])
def test_jax_products_have_the_full_precision_of_their_dtype_on_accelerators(platform: str) -> None:
    """By default, JAX rounds the factors to 10 bits on a GPU and to 7 bits on a TPU."""
    image = jnp.asarray(IMAGE, dtype=jnp.float32)
    loss = partial(loi_jax.loi_loss, scales=SCALES)
    lowered = jax.jit(jax.value_and_grad(loss)).trace(image, image).lower(lowering_platforms=(platform,))
    products = [line for line in lowered.as_text().splitlines() if "dot_general" in line]
    assert products
    assert all("precision = [HIGHEST, HIGHEST]" in line for line in products)

"""A call brings weights of its image, which multiply the weights of the reference."""

from __future__ import annotations

import re
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import MSSSIM, GaussianPyramid, LOIObjective, PixelL2, ScaleSpace
from loi_core.errors import ImageError, ImageTypeError, OptionError
from loi_core.method.reference import loss_and_gradient
from tests.frameworks import array_api_strict, jax, jnp, loi_jax, loi_torch, torch
from tests.helpers import Host, directional_difference, images, relative_error, without_numba
from tests.strategies import FEWER_EXAMPLES, SEEDS, Problem, max_differences, problems

# Problems are drawn with values beyond the bounds as well.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

SHAPE = (24, 19)
IMAGE, REFERENCE = images((*SHAPE, 3), 1)
RNG = np.random.default_rng(2)
FIXED: Host = RNG.uniform(0.1, 1.0, SHAPE)
WEIGHTS: Host = RNG.uniform(size=SHAPE)
COVERED: Host = WEIGHTS > 0.4
SCALES = ScaleSpace((0, 1), (2, 9), 0.125)
SMOOTH_SCALES = ScaleSpace((1, 4), (2, 9), 0.125, p=0.5)  # a square has no kink that a finite difference could cross
WEIGHT_MAPS = {"graded": 3.0 * WEIGHTS, "a mask": COVERED, "graded and hidden": np.where(COVERED, WEIGHTS, 0.0)}


@pytest.fixture(params=[True, False], ids=["compiled", "arrays"])
def executor(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if not request.param:
        monkeypatch.setenv("LOI_COMPILED", "0")


@given(problems(), SEEDS, st.booleans(), st.booleans())
def test_both_executors_compare_like_the_brute_force_reference(
    problem: Problem, seed: int, has_fixed: bool, compiled: bool
) -> None:
    image, reference, scales, dtype = problem
    image, reference = image.astype(dtype), reference.astype(dtype)
    rng = np.random.default_rng(seed)
    fixed, weights = rng.uniform(0.5, 1.0, (2, *image.shape[-3:-1]))
    weights = np.where(rng.uniform(size=weights.shape) < 0.4, 0.0, weights)
    combined = fixed * weights if has_fixed else weights
    largest = float(combined.max()) or 1.0
    objective = LOIObjective(reference, scales, weights=fixed if has_fixed else None)
    if compiled:
        value, gradient = objective.value_and_grad(image, weights=weights)
    else:
        with without_numba():
            value, gradient = objective.value_and_grad(image, weights=weights)
    eps = float(np.finfo(dtype).eps)
    expected, slope = loss_and_gradient(image, reference, scales, eps=eps, weights=combined / largest)
    loss, norm = max_differences(image, reference, scales)
    assert abs(float(value) - largest * expected) <= loss
    assert float(np.abs(gradient - largest * slope).sum()) <= norm


@pytest.mark.parametrize("make", [PixelL2, GaussianPyramid, LOIObjective])
@pytest.mark.parametrize("exposure", ["given", "matched", "regressed"])
@pytest.mark.parametrize("name", WEIGHT_MAPS)
@pytest.mark.usefixtures("executor")
def test_weights_of_a_call_multiply_weights_of_the_reference(make: Any, exposure: Any, name: str) -> None:
    def objective(weights: Any) -> Any:
        if make is GaussianPyramid:
            return make(REFERENCE, weights=weights)
        return make(REFERENCE, weights=weights, exposure=exposure)

    weights = WEIGHT_MAPS[name]
    for fixed, combined in ((None, weights), (FIXED, FIXED * weights)):
        value, gradient = objective(fixed).value_and_grad(IMAGE, weights=weights)
        expected, slope = objective(combined).value_and_grad(IMAGE)
        assert float(value) == pytest.approx(float(expected), rel=1e-13)
        assert relative_error(gradient, slope) <= 1e-12
        assert float(objective(fixed).value(IMAGE, weights=weights)) == float(value)
        assert sum(map(float, objective(fixed).terms(IMAGE, weights=weights).values())) == pytest.approx(float(value))
        gain: Host = objective(fixed).exposure_of(IMAGE, weights=weights).gain
        np.testing.assert_allclose(gain, objective(combined).exposure_of(IMAGE).gain, rtol=1e-12)


@pytest.mark.parametrize("make", [PixelL2, GaussianPyramid, MSSSIM, LOIObjective])
@pytest.mark.usefixtures("executor")
def test_what_an_image_or_its_reference_holds_where_it_is_not_covered_does_not_count(make: Any) -> None:
    value, gradient = make(REFERENCE).value_and_grad(IMAGE, weights=COVERED)
    for filling in (0.0, 1.0, np.nan):
        filled = np.where(COVERED[..., None], IMAGE, filling)
        filled_value, filled_gradient = make(REFERENCE).value_and_grad(filled, weights=COVERED)
        assert float(filled_value) == float(value)
        assert np.array_equal(filled_gradient, gradient)
    assert not np.any(gradient[~COVERED])
    assert np.any(gradient[COVERED])


def test_a_masked_pixel_that_is_not_finite_equals_the_reference_under_weights() -> None:
    bad, equal = IMAGE.copy(), IMAGE.copy()
    bad[3, 4], equal[3, 4] = np.nan, REFERENCE[3, 4]
    expected, slope = LOIObjective(REFERENCE).value_and_grad(equal, weights=WEIGHTS)
    value, gradient = LOIObjective(REFERENCE, nan_policy="mask").value_and_grad(bad, weights=WEIGHTS)
    assert float(value) == float(expected)
    slope[3, 4] = 0.0
    assert np.array_equal(gradient, slope)
    with pytest.raises(ImageError, match="non-finite"):
        LOIObjective(REFERENCE).value(bad, weights=WEIGHTS)


@given(SEEDS)
@FEWER_EXAMPLES
def test_the_gradient_is_the_derivative_of_the_value(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weights = np.where(rng.uniform(size=SHAPE) < 0.3, 0.0, rng.uniform(size=SHAPE))
    objective = LOIObjective(REFERENCE, SMOOTH_SCALES, weights=FIXED)
    direction = np.asarray(rng.standard_normal(IMAGE.shape))
    slope = float(np.sum(objective.value_and_grad(IMAGE, weights=weights)[1] * direction))
    expected = directional_difference(lambda image: objective.value(image, weights=weights), IMAGE, direction, 1e-5)
    assert abs(slope - expected) <= 1e-6 * max(abs(expected), 1e-3)


@pytest.mark.parametrize("accuracy", ["balanced", "fast"])
def test_an_approximate_gradient_keeps_its_tolerance(accuracy: Any) -> None:
    image, reference = images((160, 128, 1), 5)
    rows, columns = np.mgrid[:160, :128]
    covered = rows + columns > 70
    objective = LOIObjective(reference, accuracy=accuracy)
    gradient = objective.value_and_grad(image, weights=covered)[1]
    exact = LOIObjective(reference).value_and_grad(image, weights=covered)[1]
    assert np.linalg.norm(gradient - exact) <= objective.tolerance * np.linalg.norm(exact)


@pytest.mark.parametrize("sigma", [1.0, 1e6])
@pytest.mark.usefixtures("executor")
def test_calls_with_and_without_weights_do_not_affect_each_other(sigma: float) -> None:
    objective = LOIObjective(REFERENCE, ScaleSpace(sigma, (2.0, 1e6), 0.125))
    plain = float(objective.value(IMAGE))
    masked = float(objective.value(IMAGE, weights=COVERED))
    assert float(objective.value(IMAGE)) == plain
    assert float(objective.value(IMAGE, weights=WEIGHTS)) != masked
    assert float(objective.value(IMAGE, weights=COVERED)) == masked
    assert float(objective.value(IMAGE, weights=np.ones(SHAPE))) == pytest.approx(plain, rel=1e-12)


def test_an_image_without_a_covered_pixel_has_the_value_0() -> None:
    for objective in (
        LOIObjective(REFERENCE, weights=FIXED, exposure="matched"),
        PixelL2(REFERENCE),
        MSSSIM(REFERENCE),
    ):
        value, gradient = objective.value_and_grad(IMAGE, weights=np.zeros(SHAPE))
        assert float(value) == pytest.approx(0.0, abs=1e-12)
        assert not np.any(gradient)


@pytest.mark.usefixtures("executor")
def test_images_of_a_batch_have_separate_or_shared_weights_in_a_call() -> None:
    batch, separate = np.stack([IMAGE, REFERENCE[::-1]]), np.stack([WEIGHTS, COVERED])
    objective = LOIObjective(REFERENCE, SCALES, weights=FIXED)
    for weights, by_image in ((separate, separate), (WEIGHTS, [WEIGHTS, WEIGHTS])):
        value, gradient = objective.value_and_grad(batch, weights=weights)
        singles = [objective.value_and_grad(image, weights=by) for image, by in zip(batch, by_image, strict=True)]
        assert float(value) == pytest.approx(sum(float(single) for single, _ in singles) / 2.0, rel=1e-12)
        assert relative_error(gradient, np.stack([slope for _, slope in singles]) / 2.0) <= 1e-10
    first = np.moveaxis(batch, -1, -3)
    moved = LOIObjective(np.moveaxis(REFERENCE, -1, -3), SCALES, weights=FIXED, channel_axis=-3)
    assert float(moved.value(first, weights=separate)) == pytest.approx(
        float(objective.value(batch, weights=separate)), rel=1e-12
    )


@pytest.mark.parametrize("name", WEIGHT_MAPS)
@pytest.mark.parametrize("fixed", [None, FIXED])
@pytest.mark.usefixtures("executor")
def test_every_library_gives_the_same_numbers(name: str, fixed: Host | None) -> None:
    weights = WEIGHT_MAPS[name]
    expected, slopes = LOIObjective(REFERENCE, SCALES, weights=fixed).value_and_grad(IMAGE, weights=weights)

    def check(loss: Any, slope: Any) -> None:
        assert float(loss) == pytest.approx(float(expected), rel=1e-12)
        assert relative_error(np.asarray(slope), slopes) <= 1e-10

    strict = LOIObjective(REFERENCE, SCALES, weights=fixed)
    check(*strict.value_and_grad(array_api_strict.asarray(IMAGE), weights=array_api_strict.asarray(weights)))
    combined = weights if fixed is None else fixed * weights
    for convert in (torch.tensor, np.asarray):
        leaf = torch.tensor(IMAGE, requires_grad=True)
        loss = loi_torch.loi_loss(leaf, REFERENCE, SCALES, weights=convert(combined))
        loss.backward()
        check(loss.detach(), leaf.grad)


@pytest.mark.usefixtures("executor")
def test_traced_weights_give_the_same_numbers() -> None:
    weights = WEIGHT_MAPS["graded and hidden"]
    expected, slopes = LOIObjective(REFERENCE, SCALES).value_and_grad(IMAGE, weights=weights)
    function = jax.value_and_grad(lambda image, by: loi_jax.loi_loss(image, REFERENCE, SCALES, weights=by))
    image, by = jnp.asarray(IMAGE), jnp.asarray(weights)
    for value, slope in (jax.jit(function)(image, by), jax.jit(partial(function, image))(by)):
        assert float(value) == pytest.approx(float(expected), rel=1e-12)
        assert relative_error(np.asarray(slope), slopes) <= 1e-10


@pytest.mark.usefixtures("executor")
def test_weights_get_no_gradient_from_torch() -> None:
    leaf = torch.tensor(IMAGE, requires_grad=True)
    weights = torch.tensor(WEIGHTS, requires_grad=True)
    loi_torch.LOILoss()(leaf, REFERENCE, weights).backward()
    assert weights.grad is None
    assert leaf.grad is not None
    assert not LOIObjective(REFERENCE).value(leaf.detach(), weights=weights).requires_grad


@pytest.mark.usefixtures("executor")
def test_weights_get_no_gradient_from_jax() -> None:
    loss, image = partial(loi_jax.loi_loss, target=REFERENCE, scales=SCALES), jnp.asarray(IMAGE)
    objective = LOIObjective(REFERENCE, SCALES)
    for call in (lambda by: loss(image, weights=by), jax.jit(lambda by: loss(image, weights=by))):
        assert not np.any(jax.grad(call)(jnp.asarray(WEIGHTS)))
    assert not np.any(jax.grad(lambda by: objective.value(image, weights=by))(jnp.asarray(WEIGHTS)))


@pytest.mark.parametrize("axes", [(0, 0), (0, None), (None, 0)])
def test_vmap_equals_a_loop_over_images_and_weights(axes: tuple[int | None, int | None]) -> None:
    batch, weights = np.stack([IMAGE, REFERENCE[::-1]]), np.stack([WEIGHTS, COVERED])
    objective = LOIObjective(REFERENCE, SCALES)
    arguments = (batch if axes[0] == 0 else IMAGE, weights if axes[1] == 0 else WEIGHTS)
    pairs = [
        [part[index] if axis == 0 else part for part, axis in zip(arguments, axes, strict=True)] for index in range(2)
    ]
    expected = [objective.value_and_grad(image, weights=by) for image, by in pairs]
    values = np.array([float(value) for value, _ in expected])
    slopes = np.stack([slope for _, slope in expected])
    torch_loss = loi_torch.LOILoss(SCALES)

    def of_jax(image: Any, by: Any) -> Any:
        return loi_jax.loi_loss(image, REFERENCE, SCALES, weights=by)

    def of_torch(image: Any, by: Any) -> Any:
        return torch_loss(image, REFERENCE, by)

    for wrap in (lambda function: function, jax.jit):
        mapped = wrap(jax.vmap(jax.value_and_grad(of_jax), in_axes=axes))
        results = mapped(*map(jnp.asarray, arguments))
        np.testing.assert_allclose(results[0], values, rtol=1e-12)
        assert relative_error(np.asarray(results[1]), slopes) <= 1e-10
    tensors = [torch.tensor(argument) for argument in arguments]
    np.testing.assert_allclose(torch.func.vmap(of_torch, in_dims=axes)(*tensors), values, rtol=1e-12)
    gradients = torch.func.vmap(torch.func.grad(of_torch), in_dims=axes)(*tensors)
    assert relative_error(gradients.numpy(), slopes) <= 1e-10


def test_second_derivatives_of_jax_take_weights_as_constants() -> None:
    loss = partial(loi_jax.loi_loss, target=REFERENCE, scales=SMOOTH_SCALES)
    image, direction = jnp.asarray(IMAGE), jnp.asarray(np.random.default_rng(4).standard_normal(IMAGE.shape))

    def slope(step: Any) -> Any:
        return jnp.sum(jax.grad(lambda x: loss(x, weights=jnp.asarray(WEIGHTS)))(image + step * direction) * direction)

    second, compiled = float(jax.jit(jax.grad(slope))(0.0)), jax.jit(slope)
    assert second == pytest.approx(float(compiled(1e-5) - compiled(-1e-5)) / 2e-5, rel=1e-4)


@pytest.mark.usefixtures("executor")
def test_negative_weights_are_nan_while_jax_traces() -> None:
    loss = partial(loi_jax.loi_loss, target=REFERENCE, scales=SCALES)
    traced = jax.jit(jax.value_and_grad(lambda image, by: loss(image, weights=by)))
    value, gradient = traced(jnp.asarray(IMAGE), jnp.asarray(-WEIGHTS))
    assert np.isnan(float(value))
    assert np.all(np.isnan(gradient))
    with_nan = jnp.asarray(np.where(COVERED[..., None], IMAGE, np.nan))
    assert np.isfinite(float(traced(with_nan, jnp.asarray(COVERED))[0]))
    assert np.isnan(float(traced(with_nan, jnp.asarray(np.ones(SHAPE)))[0]))


@pytest.mark.parametrize(
    ("weights", "error", "message"),
    [
        (np.ones((24, 18)), ImageError, "`weights` must have shape (24, 19), one for each pixel of the image"),
        (np.ones((24, 19, 1)), ImageError, "must have shape (24, 19), one for each pixel of the image"),
        (np.full(SHAPE, -1.0), ImageError, "`weights` must be finite and not negative, got -1"),
        (np.full(SHAPE, np.nan), ImageError, "`weights` must be finite and not negative, got nan"),
        (np.full(SHAPE, "a"), ImageTypeError, "`weights` must be real numbers"),
        (np.full(SHAPE, 1j), ImageTypeError, "`weights` must be real numbers"),
        ([[1.0]], ImageTypeError, "`weights` must be an array, got list"),
    ],
)
def test_invalid_weights_of_a_call_are_refused(weights: Any, error: type[Exception], message: str) -> None:
    calls: list[Any] = [
        LOIObjective(REFERENCE).value_and_grad,
        PixelL2(REFERENCE).value,
        lambda image, weights: loi_torch.loi_loss(torch.tensor(image), REFERENCE, weights=weights),
        lambda image, weights: loi_jax.loi_loss(jnp.asarray(image), REFERENCE, weights=weights),
    ]
    for call in calls:
        with pytest.raises(error, match=re.escape(message)) as raised:
            call(IMAGE, weights=weights)
        assert "\n" not in str(raised.value)


def test_an_objective_that_accepts_only_masks_refuses_weights_of_a_call() -> None:
    with pytest.raises(OptionError, match="`weights` of MSSSIM must be a mask"):
        MSSSIM(REFERENCE).value(IMAGE, weights=WEIGHTS)


@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_weights_may_have_another_dtype_than_the_image(dtype: str) -> None:
    image = IMAGE.astype(dtype)
    expected = float(LOIObjective(REFERENCE).value(image.astype(np.float64), weights=1e-60 * WEIGHTS)) * 1e60
    for weights in (WEIGHTS, WEIGHTS.astype(np.float16), 1e-30 * WEIGHTS):
        value, gradient = LOIObjective(REFERENCE).value_and_grad(image, weights=weights)
        assert value.dtype == gradient.dtype == image.dtype
        if dtype == "float32":
            assert float(value) == pytest.approx(expected * float(weights.max() / WEIGHTS.max()), rel=2e-3)

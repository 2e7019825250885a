"""The analytic gradient agrees with central differences and with the autograd of torch and JAX."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loi_core import MSSSIM, GaussianPyramid, LOIObjective, PixelL2, ScaleSpace
from loi_core.method.dispatch import ARRAY_API
from loi_core.objectives import ImageObjective, ReferencePlanes
from tests.frameworks import array_api_strict, jax, jnp, torch
from tests.helpers import SCALES, directional_difference, images, relative_error
from tests.strategies import thorough

SHAPE = (24, 19, 3)


def objectives(reference: Any) -> dict[str, ImageObjective[Any]]:
    losses: dict[str, ImageObjective[Any]] = {key: LOIObjective(reference, scales) for key, scales in SCALES.items()}
    return losses | {
        "pixel": PixelL2(reference),
        "pyramid": GaussianPyramid(reference),
        "ms-ssim": MSSSIM(reference, data_range=10.0),
    }


NAMES = [*SCALES, "pixel", "pyramid", "ms-ssim"]


@pytest.mark.parametrize("name", NAMES)
def test_gradient_equals_central_differences_in_float64(name: str) -> None:
    # |x| has a kink wherever a difference of CDFs crosses 0, and a step across a kink measures no derivative.
    # Extents mix thousands of differences, so the step must be small; at 1e-7 rounding leaves about 1e-8.
    image, reference = images(SHAPE, seed=3)
    objective = objectives(reference)[name]
    _, gradient = objective.value_and_grad(image)
    for seed in range(3):
        direction = np.random.default_rng(seed).standard_normal(SHAPE)
        slope = float(np.sum(gradient * direction))
        measured = directional_difference(objective.value, image, direction, 1e-7)
        assert abs(measured - slope) < 1e-6 * np.linalg.norm(gradient)


@pytest.mark.parametrize("name", NAMES)
def test_gradient_equals_torch_autograd_through_the_same_forward_code(name: str) -> None:
    image, reference = images(SHAPE, seed=4)
    _, gradient = objectives(reference)[name].value_and_grad(image)
    leaf = torch.tensor(image, requires_grad=True)
    objectives(torch.tensor(reference))[name].value(leaf).backward()
    assert leaf.grad is not None
    assert relative_error(leaf.grad.numpy(), gradient) < 1e-10


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in ("paper path", "ms-ssim") else thorough) for name in NAMES]
)
def test_gradient_equals_jax_grad_through_the_same_forward_code(name: str) -> None:
    image, reference = images(SHAPE, seed=5)
    _, gradient = objectives(reference)[name].value_and_grad(image)
    objective = objectives(jnp.asarray(reference))[name]
    planes = jnp.moveaxis(jnp.asarray(image), -1, 0)
    comparison = objective.compare_with(ReferencePlanes(jnp.moveaxis(jnp.asarray(reference), -1, 0), None, ARRAY_API))

    def forward(stack: Any) -> Any:
        return sum(comparison.compare(stack, gradient=False).terms.values())

    traced = jnp.moveaxis(jax.jit(jax.grad(forward))(planes), 0, -1)
    assert relative_error(np.asarray(traced), gradient) < 1e-10


@pytest.mark.parametrize("name", NAMES)
def test_objectives_use_only_functions_of_the_array_api(name: str) -> None:
    image, reference = images((2, *SHAPE), seed=6)
    value, gradient = objectives(reference)[name].value_and_grad(image)
    strict = objectives(array_api_strict.asarray(reference))[name]
    strict_value, strict_gradient = strict.value_and_grad(array_api_strict.asarray(image))
    assert float(strict_value) == pytest.approx(float(value), rel=1e-13)
    assert relative_error(np.asarray(strict_gradient), gradient) < 1e-12
    assert sum(map(float, strict.terms(array_api_strict.asarray(image)).values())) == pytest.approx(float(value))


@pytest.mark.parametrize("name", NAMES)
def test_float32_stays_near_the_float64_gradient(name: str) -> None:
    image, reference = images(SHAPE, seed=7)
    value, gradient = objectives(reference)[name].value_and_grad(image)
    single_value, single_gradient = objectives(reference)[name].value_and_grad(image.astype(np.float32))
    assert single_gradient.dtype == np.float32
    assert single_value.dtype == np.float32
    assert float(single_value) == pytest.approx(float(value), rel=1e-5)
    # A sign flips where a difference of CDFs is within float32's rounding of 0: a fraction of about 1e-6 divided by the
    # spread of the differences, which is 1e-2 or more here. Each flip changes a gradient entry by its own size.
    assert relative_error(single_gradient, gradient) < 1e-3


def test_a_gradient_reaches_across_a_gap() -> None:
    reference = np.zeros((48, 48, 1))
    reference[30:36, 30:36] = 1.0
    image = np.zeros((48, 48, 1))
    image[8:14, 8:14] = 1.0
    scales = ScaleSpace(1, (1, 5, 15), 0.125)
    _, gradient = LOIObjective(reference, scales).value_and_grad(image)
    _, baseline = PixelL2(reference).value_and_grad(image)
    leading, trailing = (slice(14, 15), slice(8, 14)), (slice(7, 8), slice(8, 14))  # just past the object's two edges
    # Moving the object towards the reference brightens the pixels ahead of it, so their gradient must be lower.
    assert gradient[leading].sum() < gradient[trailing].sum()
    assert baseline[leading].sum() == baseline[trailing].sum() == 0.0


def test_the_gradient_is_zero_at_the_reference() -> None:
    reference, _ = images(SHAPE, seed=8)
    for dtype in (np.float64, np.float32):
        value, gradient = LOIObjective(reference, SCALES["paper path"]).value_and_grad(reference.astype(dtype))
        if dtype is np.float64:
            assert float(value) == 0.0
        assert not np.any(gradient)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_difference_within_rounding_is_a_tie(dtype: Any) -> None:
    # Noise of one ulp is no signal: without the tie rule its sign would be a gradient of full size.
    reference = images(SHAPE, seed=9)[0].astype(dtype)
    noisy = np.nextafter(reference, np.where(np.random.default_rng(1).uniform(size=SHAPE) < 0.5, 0, 1).astype(dtype))
    assert np.any(noisy != reference)
    objective = LOIObjective(reference, SCALES["paper path"])
    assert not np.any(objective.value_and_grad(noisy)[1])
    assert np.any(objective.value_and_grad(reference + dtype(1e-2))[1])

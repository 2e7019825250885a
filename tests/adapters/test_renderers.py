"""Tests of the renderers on torch and JAX: the contract, and agreement with the NumPy renderers."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import jax
import numpy as np
import pytest
import torch
from hypothesis import given, settings

import loi_jax.renderers
import loi_torch.renderers
import loi_torch.warp
from loi_core import LOIObjective, Renderer, ScaleSpace, fit, renderers
from loi_core.errors import ParameterError
from loi_core.renderers.contract import capabilities_of
from loi_core.support.arrays import from_numpy, library_name, to_numpy
from loi_core.testing import RendererSubject, parametrize_with_checks
from tests.helpers import Host, relative_error
from tests.strategies import SEEDS

SIZE = (20, 24)
SCALES = ScaleSpace((0, 2), (2, 6), 0.1)


def disks_options(seed: int, count: int = 5) -> dict[str, Any]:
    """Return options of overlapping disks, the first partly and the second entirely outside the frame."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-2.0, 26.0, (count, 2))
    positions[:2] = [rng.uniform(-2.0, 2.0), 9.3], [-40.0, 60.0]
    return {
        "height": SIZE[0],
        "width": SIZE[1],
        "positions": positions,
        "radii": [3.0, *rng.uniform(0.3, 7.0, count - 1)],
        "colours": rng.uniform(0, 1, (count, 3)),
        "background": (0.2, 0.3, 0.4),
    }


def warp_options(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    return {
        "picture": rng.uniform(0, 1, (7, 9, int(rng.integers(3, 5)))),
        "background": rng.uniform(0, 1, (*SIZE, 3)),
        "translation": rng.uniform(-12, 12, 2),
        "rotation": rng.uniform(-180, 180),
        "scale": rng.uniform(0.5, 2.0),
        "exposure": rng.uniform(-1, 1),
    }


def torch_disks(seed: int, **options: Any) -> Any:
    return loi_torch.renderers.Disks(**disks_options(seed), **options)


def torch_warp(seed: int, **options: Any) -> Any:
    return loi_torch.warp.Warp(**warp_options(seed), **options)


def jax_disks(seed: int, **options: Any) -> Any:
    return loi_jax.renderers.Disks(**disks_options(seed), **options)


def numpy_renderer(maker: Any, seed: int, **options: Any) -> Any:
    """Return the NumPy renderer of the same scene."""
    if maker is torch_warp:
        return renderers.Warp(**warp_options(seed), **options)
    return renderers.Disks(**disks_options(seed), **options)


MAKERS = [torch_disks, torch_warp, jax_disks]


@parametrize_with_checks(
    [
        RendererSubject(maker(4, dtype=dtype), seed=1, rtol=rtol)
        for maker in MAKERS
        for dtype, rtol in (("float64", 1e-3), ("float32", 2e-2))
    ]
)
def test_torch_and_jax_renderers_pass_the_conformance_kit(check: Any, subject: Any) -> None:
    check(subject)


def check_close(actual: Any, expected: Host, rtol: float) -> None:
    """Compare arrays with a tolerance relative to the largest expected value."""
    scale = float(np.abs(expected).max())
    np.testing.assert_allclose(to_numpy(actual), expected, rtol=0, atol=rtol * scale + 1e-300)


def compare(adapter: Any, numpy_reference: Any, rtol: float) -> None:
    """Compare image, loss, gradients and projection of an adapter's renderer with the NumPy renderer of its scene."""
    project = capabilities_of(adapter).project
    assert isinstance(adapter, Renderer)
    assert project is not None
    params, numpy_params = adapter.parameters(), numpy_reference.parameters()
    assert list(params) == list(numpy_params)
    image, pullback = adapter.render_vjp(params)
    expected, expected_pullback = numpy_reference.render_vjp(numpy_params)
    assert str(image.dtype).endswith(str(expected.dtype))
    np.testing.assert_allclose(to_numpy(image), expected, rtol=0, atol=0.1 * rtol)
    check_close(adapter.render(params), to_numpy(image), 0.1 * rtol)
    objective = LOIObjective(np.random.default_rng(8).uniform(0, 1, expected.shape), SCALES)
    value, cotangent = objective.value_and_grad(image)
    loss, slope = objective.value_and_grad(expected)
    assert float(value) == pytest.approx(float(loss), rel=rtol)
    assert library_name(cotangent) == library_name(image)
    for name, gradient in expected_pullback(slope).items():
        check_close(pullback(cotangent)[name], gradient, rtol)
    for name, legal in numpy_reference.project(numpy_params).items():
        check_close(project(params)[name], legal, 1e-15)


@pytest.mark.parametrize("maker", MAKERS)
@given(seed=SEEDS)
@settings(max_examples=15)
def test_adapter_renderers_agree_with_numpy_in_image_loss_and_gradient(maker: Any, seed: int) -> None:
    compare(maker(seed), numpy_renderer(maker, seed), 1e-9)


@pytest.mark.parametrize("maker", MAKERS)
def test_adapter_renderers_agree_with_numpy_in_float32(maker: Any) -> None:
    compare(maker(3, dtype="float32"), numpy_renderer(maker, 3, dtype="float32"), 1e-4)


@pytest.mark.parametrize("pose", [{}, {"translation": (3.0, -5.0)}, {"scale": 2.0, "translation": (0.5, 0.5)}])
def test_the_torch_warp_has_the_derivative_of_numpy_at_pixel_centres(pose: dict[str, Any]) -> None:
    rng = np.random.default_rng(2)
    scene = rng.uniform(0, 1, (6, 10, 4)), rng.uniform(0, 1, (*SIZE, 3))
    compare(loi_torch.warp.Warp(*scene, **pose), renderers.Warp(*scene, **pose), 1e-9)


@pytest.mark.parametrize("maker", [loi_torch.renderers.Disks, loi_jax.renderers.Disks])
@pytest.mark.parametrize(
    ("positions", "radii"),
    [
        ([[-50.0, 4.0], [4.0, 1e9]], [3.0, 3.0]),
        ([[4.3, 4.0], [6.0, 6.5]], [0.0, 2.0]),
        ([[4.0, 4.0], [4.0, 4.0]], [2.0, 2.0]),
        (np.zeros((0, 2)), np.zeros(0)),
    ],
    ids=["out of frame", "no radius", "on the grid", "no disks"],
)
def test_degenerate_disks_have_the_image_and_gradient_of_numpy(maker: Any, positions: Any, radii: Any) -> None:
    scene: Any = 9, 11, positions, radii, np.full((len(radii), 3), 0.7)
    image, pullback = maker(*scene).render_vjp(maker(*scene).parameters())
    expected, expected_pullback = renderers.Disks(*scene).render_vjp(renderers.Disks(*scene).parameters())
    np.testing.assert_allclose(to_numpy(image), expected, rtol=0, atol=1e-13)
    cotangent = np.random.default_rng(5).standard_normal((9, 11, 3))
    for name, gradient in expected_pullback(cotangent).items():
        np.testing.assert_allclose(to_numpy(pullback(from_numpy(cotangent, image))[name]), gradient, rtol=0, atol=1e-10)


def test_a_fit_of_disks_has_the_same_trajectory_on_numpy_torch_and_jax() -> None:
    start: dict[str, Any] = {
        "height": 32,
        "width": 32,
        "positions": [[8.2, 9.1], [22.7, 20.3]],
        "radii": [4.0, 5.5],
        "colours": [[0.9, 0.3, 0.1], [0.2, 0.5, 0.9]],
        "confine": True,
    }
    truth = renderers.Disks(**{**start, "positions": [[21.5, 8.4], [9.3, 23.6]]})
    objective = LOIObjective(truth.render(truth.parameters()), ScaleSpace.for_image(32, 32))
    trajectories: list[Host] = []
    for make in (renderers.Disks, loi_torch.renderers.Disks, loi_jax.renderers.Disks):
        trajectory: list[Host] = []

        def record(_: Any, params: Any, __: Any, trajectory: list[Host] = trajectory) -> None:
            trajectory.append(to_numpy(params["positions"]).copy())

        fit(make(**start), objective, steps=50, learning_rate=0.5, optimise=["positions"], callback=record)
        trajectories.append(np.stack(trajectory))
    assert np.abs(trajectories[0][-1] - trajectories[0][0]).max() > 5.0
    np.testing.assert_allclose(trajectories[1], trajectories[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(trajectories[2], trajectories[0], rtol=0, atol=1e-6)


def test_torch_disks_detach_their_results_and_leave_their_arguments_unchanged() -> None:
    scene = torch_disks(6)
    params = {name: value.requires_grad_() for name, value in scene.parameters().items()}
    with torch.no_grad():
        image, pullback = scene.render_vjp(params)
        gradient = pullback(image)
    assert not image.requires_grad
    assert not any(value.requires_grad for value in gradient.values())
    assert all(value.grad is None and value.requires_grad for value in params.values())
    assert not scene.render(params).requires_grad


def test_jax_disks_compute_in_float64_without_64_bit_mode() -> None:
    scene, wide = jax_disks(6, dtype="float32"), jax_disks(6)
    reference = numpy_renderer(jax_disks, 6, dtype="float32")
    with jax.enable_x64(False):
        image, pullback = scene.render_vjp(scene.parameters())
        gradient = pullback(image)
        with pytest.raises(ParameterError, match="`dtype` 'float64' needs JAX's 64-bit mode; set JAX_ENABLE_X64=1"):
            jax_disks(6)
    expected, expected_pullback = reference.render_vjp(reference.parameters())
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-7)
    for name, expected_gradient in expected_pullback(expected).items():
        assert relative_error(gradient[name], expected_gradient) < 1e-6
        assert gradient[name].dtype == np.float32
    assert wide.render(wide.parameters()).dtype == np.float64


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: torch_disks(1, device="abacus"), "`device` must name a device of torch with float64"),
        (lambda: torch_warp(1, device=3), "`device` must name a device of torch with float64"),
        (lambda: torch_warp(1, dtype="int"), "`dtype` must be 'float64' or 'float32'"),
        (lambda: jax_disks(1, dtype="int"), "`dtype` must be 'float64' or 'float32'"),
        (lambda: torch_warp(1).render({"scale": torch.ones(())}), "`params` must have exactly the names"),
        (
            lambda: torch_warp(1).render({**torch_warp(1).parameters(), "scale": torch.zeros(())}),
            "`scale` must be more than 0",
        ),
        (
            lambda: torch_disks(1).render({**torch_disks(1).parameters(), "radii": torch.ones(3)}),
            r"`radii` must have shape \(5,\)",
        ),
        (
            lambda: jax_disks(1).render({**jax_disks(1).parameters(), "radii": np.full(5, np.nan)}),
            "`radii` must be finite",
        ),
    ],
)
def test_torch_and_jax_renderers_refuse_wrong_values(make: Any, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        make()


def test_importing_loi_torch_does_not_import_kornia() -> None:
    code = "import sys, loi_torch; print('kornia' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("maker", [torch_disks, torch_warp])
def test_torch_renderers_agree_with_numpy_on_a_gpu(maker: Any) -> None:
    scene = maker(5, device="cuda")
    assert scene.render(scene.parameters()).device.type == "cuda"
    compare(scene, numpy_renderer(maker, 5), 1e-9)

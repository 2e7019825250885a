"""Gradient terms that bypass the film equal Mitsuba's, at half its cost: no primal image is rendered."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import MitsubaRenderer, Translate
from loi_mitsuba.renderer import split_seed
from mitsuba_boundaries.area_jacobian import corrected_sample
from mitsuba_boundaries.integrator_view import IntegratorView
from mitsuba_boundaries.received_shadows import ReceivedShadowBoundary
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.strategies import thorough

SAMPLES = 8
CROP = {"crop_offset_x": 8, "crop_offset_y": 4, "crop_width": WIDTH - 16, "crop_height": HEIGHT - 8}
MOVES = {"x": Translate("ball", (1, 0, 0))}
START = {"x": np.float32(0.0)}
MIN_OPERATIONS = 500  # of a kernel that traces rays


def integrator(integrator_type: str, term: str, samples: int = SAMPLES) -> dict[str, Any]:
    return {"type": integrator_type, "guiding": "none", "sppc": 0, "sppp": 0, "sppi": 0, term: samples}


def ball_in_view(**film: Any) -> dict[str, Any]:
    scene = shadow_scene(ball={"type": "sphere", "to_world": mi.ScalarTransform4f().translate([0, 1.5, 0]).scale(0.6)})
    scene["sensor"]["film"] |= film
    return scene


def correlated_noise(image: Host) -> Host:
    return np.cumsum(np.random.default_rng(0).standard_normal(image.shape), axis=1).astype(np.float32)


def ray_tracing_kernels() -> list[dict[str, Any]]:
    """Return the kernels that have traced rays since the last call."""
    history = dr.kernel_history([dr.KernelType.JIT])
    return [kernel for kernel in history if kernel["operation_count"] > MIN_OPERATIONS]


@pytest.mark.parametrize(
    ("term", "film"),
    [
        ("sppp", {}),
        ("sppi", {}),
        ("sppc", CROP | {"rfilter": {"type": "gaussian"}}),
        ("sppc", {"sample_border": True, "rfilter": {"type": "tent"}}),
        ("sppc", {"pixel_format": "luminance", "width": 100, "height": 75}),
    ],
)
@pytest.mark.parametrize("integrator_type", ["direct_projective", "prb_projective"])
def test_each_term_of_the_gradient_equals_mitsuba_s(integrator_type: str, term: str, film: dict[str, Any]) -> None:
    """For silhouettes with a box filter only: with others, Mitsuba divides by the weights of the pixels in reach."""
    description = integrator(integrator_type, term)
    renderer = MitsubaRenderer(ball_in_view(**film), MOVES, integrator=description)
    weight = correlated_noise(renderer.render(START))
    gradient = float(renderer.vjp(START, weight, seed=3)["x"])

    params = mi.traverse(renderer.scene)
    x = mi.Float(0.0)
    dr.enable_grad(x)
    params["ball.to_world"] = mi.Transform4f().translate(mi.Vector3f(x, 0.0, 0.0)) @ params["ball.to_world"]
    params.update()
    reference = mi.load_dict(description)
    corrected = IntegratorView(reference, sample=corrected_sample(reference, renderer.scene))
    type(reference).render_backward(
        corrected, renderer.scene, params, mi.TensorXf(weight), renderer.sensor, split_seed(3)[1], 0
    )
    expected = float(dr.grad(x)[0])
    assert abs(expected) > 1.0
    assert gradient == pytest.approx(expected, rel=1e-4)  # sums of some ten thousand float32 terms


def check_same_gradient(term: str, samples: int, *views: tuple[dict[str, Any], Host], seeds: int = 6) -> None:
    """Check that two scenes, each with a cotangent, have the same mean gradient within standard errors."""
    draws = []
    for scene, weight in views:
        renderer = MitsubaRenderer(scene, MOVES, integrator=integrator("direct_projective", term, samples))
        draws.append([float(renderer.vjp(START, weight, seed=seed)["x"]) for seed in range(seeds)])
    expected, actual = np.mean(draws, axis=1)
    error = float(np.linalg.norm(np.std(draws, axis=1, ddof=1)) / np.sqrt(seeds))
    assert abs(expected) > 8.0 * error
    assert actual == pytest.approx(expected, abs=4.0 * error)


@pytest.mark.parametrize("term", [pytest.param("sppp", marks=thorough), "sppi"])
def test_a_crop_window_has_the_gradient_of_that_region_of_the_film(term: str) -> None:
    """Mitsuba's own gradient belongs to a region shifted by the offset of the window."""
    rows, columns = (slice(CROP[f"crop_offset_{axis}"], -CROP[f"crop_offset_{axis}"]) for axis in "yx")
    weight = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    weight[rows, columns] = np.linspace(-1.0, 1.0, WIDTH)[None, columns, None]
    check_same_gradient(term, 256, (ball_in_view(), weight), (ball_in_view(**CROP), weight[rows, columns]))


@pytest.mark.parametrize("term", [pytest.param("sppp", marks=thorough), "sppi"])
def test_an_off_centre_camera_has_the_gradient_of_that_region_of_a_wider_film(term: str) -> None:
    """Mitsuba's own gradient lacks the shadows that would be out of view if the principal point were in the centre."""
    offset = WIDTH // 4
    full_width = WIDTH + 2 * offset
    ramp = np.linspace(-1.0, 1.0, WIDTH, dtype=np.float32)[None, :, None]
    weight = np.broadcast_to(ramp, (HEIGHT, WIDTH, 3))
    full_weight = np.pad(weight, ((0, 0), (2 * offset, 0), (0, 0)))
    full, off_centre = ball_in_view(width=full_width), ball_in_view()
    for scene in (full, off_centre):
        scene["ball"]["to_world"] = mi.ScalarTransform4f().translate([4.0, 1.5, 0.0]).scale(1.2)
    half_width = np.tan(np.radians(off_centre["sensor"]["fov"] / 2.0)) * full_width / WIDTH
    full["sensor"]["fov"] = float(2.0 * np.degrees(np.arctan(half_width)))
    off_centre["sensor"]["principal_point_offset_x"] = offset / WIDTH
    check_same_gradient(term, 64, (full, full_weight), (off_centre, weight))


@pytest.mark.usefixtures("kernel_history")
@pytest.mark.parametrize("term", ["sppp", "sppi"])
def test_silhouette_rays_are_traced_once_per_vjp_and_per_jvp(term: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mitsuba traces them twice, and in forward mode once for each of the 25 pixels of a Gaussian filter."""
    monkeypatch.setattr(ReceivedShadowBoundary, "from_scene", lambda *_: [])  # a term with rays of its own
    scene = ball_in_view(rfilter={"type": "gaussian"})
    renderer = MitsubaRenderer(scene, MOVES, integrator=integrator("direct_projective", term))
    ray_tracing_kernels()
    renderer.vjp(START, np.ones((HEIGHT, WIDTH, 3), np.float32))
    assert len(ray_tracing_kernels()) == 1
    renderer.jvp(START, {"x": np.float32(1.0)})
    assert len(ray_tracing_kernels()) == 1


@pytest.mark.usefixtures("kernel_history")
def test_rays_of_the_interior_term_are_traced_once_per_jvp() -> None:
    scene = ball_in_view(rfilter={"type": "gaussian"})
    target = {"floor": "floor.bsdf.reflectance.value"}
    renderer = MitsubaRenderer(scene, target, integrator=integrator("direct_projective", "sppc"))
    params = renderer.parameters()
    ray_tracing_kernels()
    derivative = renderer.jvp(params, {"floor": np.ones(3, np.float32)})
    assert len(ray_tracing_kernels()) == 1
    assert np.any(derivative)


@pytest.mark.usefixtures("kernel_history")
@pytest.mark.parametrize("term", ["sppc", "sppp", "sppi"])
def test_another_sample_count_compiles_no_kernel(term: str) -> None:
    """A plan changes the counts after the first gradients, and each count used to be a kernel of its own."""
    misses = []
    renderer = MitsubaRenderer(ball_in_view(), MOVES)
    for samples in (8, 4, 2):
        resampled = renderer.with_integrator(integrator("direct_projective", term, samples))
        ray_tracing_kernels()
        resampled.vjp(START, np.ones((HEIGHT, WIDTH, 3), np.float32))
        misses.append(sum(not kernel["cache_hit"] for kernel in ray_tracing_kernels()))
    assert misses[1:] == [0, 0]


@pytest.mark.usefixtures("kernel_history")
def test_silhouettes_are_not_sampled_where_nothing_moves() -> None:
    renderer = MitsubaRenderer(ball_in_view(), {"floor": "floor.bsdf.reflectance.value"})
    params = renderer.parameters()
    ray_tracing_kernels()
    renderer.vjp(params, np.ones((HEIGHT, WIDTH, 3), np.float32))
    count = len(ray_tracing_kernels())
    interior = renderer.with_integrator(integrator("direct_projective", "sppc"))
    interior.vjp(params, np.ones((HEIGHT, WIDTH, 3), np.float32))
    assert len(ray_tracing_kernels()) == count

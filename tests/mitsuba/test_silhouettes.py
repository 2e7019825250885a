"""What Mitsuba draws of a gradient is its own, in half of the time: no rays are traced for an image of it."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import MitsubaRenderer, Translate
from loi_mitsuba.boundary.area_jacobian import clamped_area_jacobian
from loi_mitsuba.boundary.received_shadows import ReceivedShadowBoundary
from loi_mitsuba.renderer import split_seed
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene

SAMPLES = 8
CROP = {"crop_offset_x": 8, "crop_offset_y": 4, "crop_width": WIDTH - 16, "crop_height": HEIGHT - 8}
MOVES = {"x": Translate("ball", (1, 0, 0))}


def integrator(kind: str, part: str, samples: int = SAMPLES) -> dict[str, Any]:
    return {"type": kind, "guiding": "none", "sppc": 0, "sppp": 0, "sppi": 0, part: samples}


def ball_in_view(**film: Any) -> dict[str, Any]:
    scene = shadow_scene(ball={"type": "sphere", "to_world": mi.ScalarTransform4f().translate([0, 1.5, 0]).scale(0.6)})
    scene["sensor"]["film"] |= film
    return scene


def smooth(image: Host) -> Host:
    return np.cumsum(np.random.default_rng(0).standard_normal(image.shape), axis=1).astype(np.float32)


def kernels() -> list[dict[str, Any]]:
    """Those that have run since the last call and trace rays, of which each has hundreds of operations."""
    return [one for one in dr.kernel_history([dr.KernelType.JIT]) if one["operation_count"] > 500]


@pytest.mark.parametrize(
    ("part", "film"),
    [
        ("sppp", {}),
        ("sppi", {}),
        ("sppc", CROP | {"rfilter": {"type": "gaussian"}}),
        ("sppc", {"sample_border": True, "rfilter": {"type": "tent"}}),
        ("sppc", {"pixel_format": "luminance", "width": 100, "height": 75}),
    ],
)
@pytest.mark.parametrize("kind", ["direct_projective", "prb_projective"])
def test_the_gradient_is_that_of_mitsuba(kind: str, part: str, film: dict[str, Any]) -> None:
    """Of silhouettes with a box filter: of others, Mitsuba divides by the weights of the pixels that one reaches."""
    described = integrator(kind, part)
    renderer = MitsubaRenderer(ball_in_view(**film), MOVES, integrator=described)
    at = {"x": np.float32(0.0)}
    weight = smooth(renderer.render(at))
    found = float(renderer.vjp(at, weight, seed=3)["x"])

    params = mi.traverse(renderer.scene)
    x = mi.Float(0.0)
    dr.enable_grad(x)
    params["ball.to_world"] = mi.Transform4f().translate(mi.Vector3f(x, 0.0, 0.0)) @ params["ball.to_world"]
    params.update()
    own = mi.load_dict(described)
    with clamped_area_jacobian(own):
        own.render_backward(renderer.scene, params, mi.TensorXf(weight), renderer.sensor, split_seed(3)[1], 0)
    wanted = float(dr.grad(x)[0])
    assert abs(wanted) > 1.0
    assert found == pytest.approx(wanted, rel=1e-4)  # sums of some ten thousand float32


def check_same_gradient(part: str, draws: int, *views: tuple[dict[str, Any], Host]) -> None:
    """Of two scenes, each with a cotangent of its image, within the errors of means over draws."""
    drawn = []
    for scene, weight in views:
        renderer = MitsubaRenderer(scene, MOVES, integrator=integrator("direct_projective", part, 256))
        drawn.append([float(renderer.vjp({"x": np.float32(0.0)}, weight, seed=seed)["x"]) for seed in range(draws)])
    wanted, found = np.mean(drawn, axis=1)
    error = float(np.linalg.norm(np.std(drawn, axis=1, ddof=1)) / np.sqrt(draws))
    assert abs(wanted) > 8.0 * error
    assert found == pytest.approx(wanted, abs=4.0 * error)


@pytest.mark.parametrize("part", ["sppp", "sppi"])
def test_a_crop_window_has_the_gradient_of_that_part_of_the_whole_film(part: str) -> None:
    """Mitsuba's own is that of a part which is further right and down by where the window begins."""
    rows, columns = (slice(CROP[f"crop_offset_{axis}"], -CROP[f"crop_offset_{axis}"]) for axis in "yx")
    weight = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    weight[rows, columns] = np.linspace(-1.0, 1.0, WIDTH)[None, columns, None]
    check_same_gradient(part, 6, (ball_in_view(), weight), (ball_in_view(**CROP), weight[rows, columns]))


@pytest.mark.parametrize("part", ["sppp", "sppi"])
def test_a_camera_whose_principal_point_is_aside_has_the_gradient_of_that_part_of_a_wider_film(part: str) -> None:
    """Mitsuba's own has no shadows in what would be out of view if it were in the middle."""
    aside = WIDTH // 4
    wider = WIDTH + 2 * aside
    ramp = np.linspace(-1.0, 1.0, WIDTH, dtype=np.float32)[None, :, None]
    given = np.broadcast_to(ramp, (HEIGHT, WIDTH, 3))
    weight = np.pad(given, ((0, 0), (2 * aside, 0), (0, 0)))
    whole, moved = ball_in_view(width=wider), ball_in_view()
    for scene in (whole, moved):
        scene["ball"]["to_world"] = mi.ScalarTransform4f().translate([4.0, 1.5, 0.0]).scale(0.6)
    half = np.tan(np.radians(moved["sensor"]["fov"] / 2.0)) * wider / WIDTH
    whole["sensor"]["fov"] = float(2.0 * np.degrees(np.arctan(half)))
    moved["sensor"]["principal_point_offset_x"] = aside / WIDTH
    check_same_gradient(part, 16, (whole, weight), (moved, given))


@pytest.mark.usefixtures("kernel_history")
@pytest.mark.parametrize("part", ["sppp", "sppi"])
def test_rays_are_traced_once_for_a_gradient_and_once_for_the_change_of_the_image(
    part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mitsuba traces them twice, and for the change of an image once for each of 25 pixels under the filter."""
    monkeypatch.setattr(ReceivedShadowBoundary, "of", lambda *_: None)  # which traces rays of its own
    scene = ball_in_view(rfilter={"type": "gaussian"})
    renderer = MitsubaRenderer(scene, MOVES, integrator=integrator("direct_projective", part))
    at, ones = {"x": np.float32(0.0)}, np.ones((HEIGHT, WIDTH, 3), np.float32)
    kernels()
    renderer.vjp(at, ones)
    assert len(kernels()) == 1
    renderer.jvp(at, {"x": np.float32(1.0)})
    assert len(kernels()) == 1


@pytest.mark.usefixtures("kernel_history")
def test_rays_are_traced_once_for_how_shading_changes_the_image() -> None:
    scene = ball_in_view(rfilter={"type": "gaussian"})
    target = {"floor": "floor.bsdf.reflectance.value"}
    renderer = MitsubaRenderer(scene, target, integrator=integrator("direct_projective", "sppc"))
    params = renderer.parameters()
    kernels()
    pushed = renderer.jvp(params, {"floor": np.ones(3, np.float32)})
    assert len(kernels()) == 1
    assert np.any(pushed)


@pytest.mark.usefixtures("kernel_history")
@pytest.mark.parametrize("part", ["sppc", "sppp", "sppi"])
def test_another_number_of_samples_compiles_nothing(part: str) -> None:
    """A plan shares samples out as the first gradients turn out, and each count was a kernel of its own."""
    counts = []
    renderer = MitsubaRenderer(ball_in_view(), MOVES)
    for samples in (8, 4, 2):
        one = renderer.with_integrator(integrator("direct_projective", part, samples))
        kernels()
        one.vjp({"x": np.float32(0.0)}, np.ones((HEIGHT, WIDTH, 3), np.float32))
        counts.append(sum(not kernel["cache_hit"] for kernel in kernels()))
    assert counts[1:] == [0, 0]


@pytest.mark.usefixtures("kernel_history")
def test_silhouettes_are_not_drawn_where_nothing_moves() -> None:
    renderer = MitsubaRenderer(ball_in_view(), {"floor": "floor.bsdf.reflectance.value"})
    params = renderer.parameters()
    kernels()
    renderer.vjp(params, np.ones((HEIGHT, WIDTH, 3), np.float32))
    both = len(kernels())
    shading = renderer.with_integrator(integrator("direct_projective", "sppc"))
    shading.vjp(params, np.ones((HEIGHT, WIDTH, 3), np.float32))
    assert len(kernels()) == both

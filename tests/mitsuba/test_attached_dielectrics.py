"""Attached samples on clear glass have the gradients of caustics, of views through glass, and of both together."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_core import LOIObjective, fit
from loi_core.errors import OptionError
from loi_mitsuba import MitsubaRenderer, PlannedRenderer, Rotate, Scale, Translate
from loi_mitsuba.effects.attached_gradient import AttachedGradient, AttachedParameters
from mitsuba_boundaries.attached.dielectrics import DielectricSamples
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.mitsuba.test_attached_emitters import RAMP, X, Y, Z, begun, differences
from tests.strategies import thorough

CLEAR = {"type": "dielectric", "int_ior": 1.5}
BALL = {"type": "sphere", "center": [-1, 1.2, 0], "radius": 0.9, "bsdf": CLEAR}
WIDE = {  # a path tracer hits it often, so that the reference has little noise
    "type": "sphere",
    "center": [1, 7, 2],
    "radius": 1.5,
    "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [5.0, 4.0, 3.0]}},
}


def glass_scene(**changes: Any) -> dict[str, Any]:
    """Return a glass ball over a floor; its caustic is visible directly, and through the ball."""
    return shadow_scene(**{"ball": BALL, "lamp": WIDE, "integrator": {"type": "path", "max_depth": 7}, **changes})


def attached(
    scene: dict[str, Any], targets: dict[str, Any], **options: Any
) -> tuple[MitsubaRenderer, AttachedGradient]:
    """Return a renderer with the scene's own integrator, and the gradient of attached samples on glass."""
    renderer = MitsubaRenderer(scene, targets, integrator="scene", without_gradient=tuple(targets), **options)
    parameters = AttachedParameters.of(renderer.names, renderer.targets, renderer.sensor, lights=False, glass=True)
    return renderer, AttachedGradient(renderer, parameters, 128)


def in_blocks(image: Host) -> Host:
    """Return the means of blocks of 8 by 8 pixels."""
    means: Host = image.reshape(HEIGHT // 8, 8, WIDTH // 8, 8, 3).mean(axis=(1, 3))
    return means


def test_dielectric_samples_are_the_image_less_the_image_without_glass() -> None:
    renderer, _ = attached(glass_scene(), {"x": Translate("ball", X)}, spp=256)
    ball_in_view, ball_far_away = {"x": np.float32(0.0)}, {"x": np.float32(100.0)}
    background = np.mean([renderer.render(ball_far_away, seed=seed) for seed in range(2)], axis=0)
    images = [renderer.render(ball_in_view, seed=seed) - background for seed in range(2)]
    samples = DielectricSamples(renderer.scene, renderer.sensor)
    draws = [in_blocks(samples.image(50_000, seed)) for seed in range(4)]
    expected, actual = in_blocks(np.mean(images, axis=0)), np.mean(draws, axis=0)
    noise = np.std(draws, axis=0, ddof=1) / 2.0
    assert np.linalg.norm(actual - expected) < 0.1 * np.linalg.norm(expected) + np.linalg.norm(noise)


@pytest.mark.parametrize("balls", ["one ball", pytest.param("two balls", marks=thorough)])
def test_the_gradient_of_moving_glass_is_close_to_finite_differences(balls: str) -> None:
    """It omits edges seen through glass, so that the angle is only less than 15 degrees."""
    second = {"type": "sphere", "center": [1.2, 1.0, 0.3], "radius": 0.8, "bsdf": CLEAR}
    scene = glass_scene(**({} if balls == "one ball" else {"other": second}))
    targets: dict[str, Any] = {"x": Translate("ball", X), "y": Translate("ball", Y), "z": Translate("ball", Z)}
    renderer, glass = attached(scene, targets, spp=256)
    params = renderer.parameters()
    mean = np.mean([list(glass.vjp(params, RAMP, names=targets, seed=seed).values()) for seed in range(6)], axis=0)
    expected, _ = differences(renderer, params, dict.fromkeys(targets, 0.15))
    assert mean @ expected > np.cos(np.radians(15.0)) * np.linalg.norm(mean) * np.linalg.norm(expected)
    assert np.linalg.norm(mean) == pytest.approx(np.linalg.norm(expected), rel=0.25)


def test_the_gradient_of_each_glass_parameter_is_independent_of_the_others() -> None:
    targets = {"x": Translate("ball", X), "size": Scale("ball")}
    renderer, glass = attached(glass_scene(), targets, spp=4)
    params = renderer.parameters()
    gradient = glass.vjp(params, RAMP, names=targets)
    for name in targets:
        (single,) = glass.vjp(params, RAMP, names=[name]).values()
        np.testing.assert_allclose(single, gradient[name], rtol=1e-3)


@pytest.mark.parametrize(
    "film", [*(pytest.param(film, marks=thorough) for film in ("rgba", "luminance")), "luminance_alpha"]
)
def test_glass_has_a_gradient_in_films_without_colour_or_with_alpha(film: str) -> None:
    """The cotangent of luminance is the cotangent of RGB weighted by the luminance coefficients."""
    moved = {"x": Translate("ball", X)}
    rgb, glass = attached(glass_scene(), moved, spp=4)
    luminance = np.array([0.2126, 0.7152, 0.0722], np.float32)
    expected = glass.vjp(rgb.parameters(), RAMP * luminance, names=moved)["x"]
    scene = glass_scene()
    scene["sensor"]["film"]["pixel_format"] = film
    renderer, glass = attached(scene, moved, spp=4)
    image = renderer.render(renderer.parameters())
    cotangent = np.zeros_like(image)
    if film == "rgba":
        cotangent[..., :3] = RAMP * luminance
    else:
        cotangent[..., :1] = RAMP[..., :1]
    actual = glass.vjp(renderer.parameters(), cotangent, names=moved)["x"]
    np.testing.assert_allclose(actual, expected, rtol=1e-3)


@thorough
def test_a_fit_finds_a_ball_of_glass() -> None:
    """The fit ends within half a pixel, from a distance of eight pixels."""
    scene = glass_scene()
    scene["sensor"]["film"] |= {"width": 32, "height": 24}
    targets: dict[str, Any] = {"x": Translate("ball", X), "z": Translate("ball", Z)}
    planned = PlannedRenderer(scene, targets, spp=32)
    truth = {"x": np.float32(1.5), "z": np.float32(1.0)}
    target = np.mean([planned.render(truth, seed=10**6 + seed) for seed in range(4)], axis=0)
    result = fit(planned, LOIObjective(target.astype(np.float32)), steps=60)
    assert list(planned.plan.attached) == ["x", "z"]
    assert not planned.plan.blurred
    for name, value in truth.items():
        np.testing.assert_allclose(result.best_params[name], value, atol=0.11)  # a pixel is 0.22


def test_a_plan_gives_the_reason_for_attached_glass() -> None:
    (row,) = (
        line
        for line in str(PlannedRenderer(glass_scene(), {"x": Translate("ball", X)}, spp=4).plan).splitlines()
        if line.startswith("| 'x'")
    )
    assert "it moves clear glass, and attached samples have its gradient" in row


def test_glass_out_of_view_is_blurred() -> None:
    """A lid hides the glass and its caustic."""
    lid = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 3, 0]).scale([9, 0.1, 9])}
    plan = begun(glass_scene(lid=lid), {"x": Translate("ball", X)}, spp=4).plan
    assert list(plan.blurred) == ["x"]
    assert not plan.attached


def test_glass_with_a_noisy_attached_gradient_is_not_blurred() -> None:
    """The blurred gradient has ten times the noise, and would be used to the end of the fit."""
    planned = PlannedRenderer(glass_scene(), {"x": Translate("ball", X)}, spp=2)
    noise = np.random.default_rng(0).normal(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
    plan = planned.start(planned.parameters(), noise).plan
    assert list(plan.attached) == ["x"]
    assert not plan.blurred


def test_glass_that_comes_into_view_is_attached() -> None:
    """It starts far to the side, where it refracts no visible light."""
    planned = PlannedRenderer(glass_scene(), {"x": Translate("ball", X)}, spp=4)
    planned = planned.start({"x": np.float32(60.0)}, RAMP)
    assert list(planned.plan.blurred) == ["x"]
    planned = planned.revisit(1, 2, 1.0, planned.parameters(), RAMP)
    assert list(planned.plan.attached) == ["x"]
    assert not planned.plan.blurred


def test_glass_that_attached_samples_do_not_support_is_blurred() -> None:
    box = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 1, 0]).scale(0.7), "bsdf": CLEAR}
    rotation: dict[str, Any] = {"it": Rotate("ball", Z)}
    assert list(PlannedRenderer(glass_scene(ball=box), rotation, spp=4).plan.blurred) == ["it"]
    moved: dict[str, Any] = {"it": Translate("ball", X)}
    hidden = {"type": "path", "hide_emitters": True}
    assert list(PlannedRenderer(glass_scene(integrator=hidden), moved, spp=4).plan.blurred) == ["it"]
    scene = glass_scene()
    scene["sensor"] |= {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 8.0}
    assert list(PlannedRenderer(scene, moved, spp=4).plan.blurred) == ["it"]


@thorough
def test_an_environment_light_does_not_make_the_gradient_of_glass_noisy() -> None:
    """Most of its refracted light falls far out of view, where the camera's importance of the floor is large."""
    targets = {"y": Translate("ball", Y)}
    renderer, glass = attached(glass_scene(lamp={"type": "constant"}), targets, spp=4)
    draws = [float(glass.vjp(renderer.parameters(), RAMP, names=targets, seed=seed)["y"]) for seed in range(6)]
    assert np.std(draws) < np.abs(np.mean(draws))


def test_attached_glass_can_be_turned_off() -> None:
    moved: dict[str, Any] = {"it": Translate("ball", X)}
    assert list(PlannedRenderer(glass_scene(), moved, spp=4, attached_glass=False).plan.blurred) == ["it"]
    assert list(PlannedRenderer(glass_scene(), moved, spp=4, blur={"names": ["it"]}).plan.blurred) == ["it"]
    with pytest.raises(OptionError, match="`attached_glass` must be true or false, got 1"):
        PlannedRenderer(glass_scene(), moved, attached_glass=1)  # type: ignore[arg-type]  # the wrong type is refused

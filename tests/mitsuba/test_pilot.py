"""The pilot turns off negligible effects, and effects that appear later are turned on again: small real scenes."""

from __future__ import annotations

import logging
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from examples.effects.scenes import HEIGHT, SUITE, WIDTH, Case
from loi_core import Free, LOIObjective, PixelL2, ScaleSpace, fit
from loi_core.effects import Effect
from loi_core.errors import OptionError, ParameterError
from loi_core.renderers.contract import capabilities_of
from loi_core.testing import check_renderer
from loi_mitsuba import MitsubaRenderer, PlannedRenderer, Translate, plan_effects
from tests.helpers import Host
from tests.mitsuba.scenes import shadow_scene
from tests.strategies import thorough

CASES = {case.name: case for case in SUITE}
SIZE = (WIDTH // 2, HEIGHT // 2)


def begun(case: Case, **options: Any) -> tuple[PlannedRenderer, LOIObjective]:
    """Return a scene of the suite at half its size after its pilot, and the loss."""
    renderer = PlannedRenderer(case.scene(*SIZE), case.parameters, **options)
    target = renderer.render(dict(case.truth), seed=10**6)
    objective = LOIObjective(target, ScaleSpace.for_image(*target.shape[:2]))
    return start(renderer, objective, dict(case.start)), objective


def start(renderer: PlannedRenderer, objective: Any, params: dict[str, Any]) -> PlannedRenderer:
    return renderer.start(params, objective.value_and_grad(renderer.render(params))[1])


def step(
    renderer: PlannedRenderer, objective: Any, params: dict[str, Any], number: int, value: float = 1.0
) -> PlannedRenderer:
    """Return the renderer after a step of a fit at these parameters."""
    image, pullback = renderer.render_vjp(params, seed=number)
    cotangent = objective.value_and_grad(image)[1]
    pullback(cotangent)
    return renderer.revisit(number + 1, 100, value, params, cotangent, seed=number)


def test_a_shadow_alone_needs_no_shading_no_outlines_and_no_bounces() -> None:
    case = CASES["shadow of an object out of view"]
    renderer, objective = begun(case, spp=64)
    assert renderer.plan.measured
    assert Effect.INDIRECT in renderer.plan.on
    assert not renderer.plan.on & {Effect.CONTINUOUS, Effect.PRIMARY, Effect.BOUNCES}
    assert renderer.plan.settings["integrator"] == "direct_projective"
    assert renderer.plan[Effect.INDIRECT].fraction == pytest.approx(1.0, abs=1e-6)
    assert not renderer.plan.frozen
    verification = renderer.verify(objective, dict(case.start), draws=6)
    assert verification.seconds < verification.full_seconds
    assert verification.gradient.cosine > 0.99 - 2.0 * verification.gradient.cosine_error
    assert f"cosine {verification.gradient.cosine:.4f}" in str(verification)


def test_the_colour_of_a_light_needs_bounces_and_no_edges() -> None:
    renderer, objective = begun(CASES["emitter colour"])
    assert not renderer.plan.on & {Effect.PRIMARY, Effect.INDIRECT}
    assert {Effect.BOUNCES, Effect.EMITTERS} <= renderer.plan.on
    assert 2 < renderer.plan.settings["max_depth"] < 8
    assert not renderer.plan.frozen
    verification = renderer.verify(objective, dict(CASES["emitter colour"].start), draws=6)
    assert verification.gradient.cosine > 0.999
    assert verification.gradient.ratio == pytest.approx(1.0, abs=0.02)


def test_a_noisy_gradient_is_frozen_and_turns_no_effect_off() -> None:
    renderer, _ = begun(CASES["nothing that can be seen"], spp=4)
    assert list(renderer.plan.frozen) == ["place"]
    nonzero = {
        effect for effect in (Effect.CONTINUOUS, Effect.INDIRECT) if renderer.plan[effect].reason[:7] != "exactly"
    }
    assert nonzero <= renderer.plan.on  # only effects that are exactly 0 are known to be small
    assert nonzero


BALL: dict[str, Any] = {"place": Translate("ball")}
DIRECT: dict[str, Any] = {"type": "direct"}  # no bounces: fewer kernels to compile


@thorough
def test_an_object_that_comes_into_view_has_its_outline_from_the_next_step(caplog: pytest.LogCaptureFixture) -> None:
    """At first only its shadow is in view, and outlines are off; the object itself would be missed."""
    caplog.set_level(logging.INFO, "loi_mitsuba")
    renderer = PlannedRenderer(shadow_scene(integrator=DIRECT), BALL, blur=None)
    objective = PixelL2(renderer.render({"place": np.array([0.5, 0.0, 0.3])}, seed=10**6))
    renderer = start(renderer, objective, {"place": np.array([-0.3, 0.0, 0.0])})
    assert Effect.PRIMARY not in renderer.plan.on
    in_view = {"place": np.array([0.0, -3.5, 0.0])}
    renderer = step(renderer, objective, in_view, 0)
    assert Effect.PRIMARY in renderer.plan.on
    (line,) = [record.getMessage() for record in caplog.records if "comes into view" in record.getMessage()]
    assert "primary visibility on" in line
    assert "\n" not in line
    image, pullback = renderer.render_vjp(in_view, seed=1)
    cotangent = objective.value_and_grad(image)[1]
    gradient = pullback(cotangent)["place"]
    fixed = MitsubaRenderer(shadow_scene(integrator=DIRECT), BALL, integrator=renderer.plan)
    np.testing.assert_allclose(gradient, fixed.vjp(in_view, cotangent, seed=1)["place"], rtol=1e-3, atol=1e-7)


def wall_scene() -> dict[str, Any]:
    """Return a ball, a lamp to its left, and far to its right a wall that the ball may cast a shadow on."""
    transform = mi.ScalarTransform4f
    return shadow_scene(
        integrator=DIRECT,
        floor={
            "type": "rectangle",
            "to_world": transform().translate([4, 0, 0]).rotate([0, 1, 0], -90).scale(1.5),
            "bsdf": {"type": "diffuse"},
        },
        sensor={
            "type": "perspective",
            "fov": 60,
            "to_world": transform().look_at([-2, 0, 9], [1, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 48, "height": 36, "rfilter": {"type": "box"}},
        },
        ball={"type": "sphere", "to_world": transform().translate([1, 3, 0]).scale(0.4)},
        lamp={
            "type": "sphere",
            "to_world": transform().translate([-6, 0, 0]).scale(0.5),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 60.0}},
        },
    )


def test_a_shadow_that_appears_later_is_found_on_schedule(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "loi_mitsuba")
    target = {"y": Translate("ball", (0, 1, 0))}
    renderer = PlannedRenderer(wall_scene(), target)
    objective = PixelL2(renderer.render({"y": np.array(-0.4)}, seed=10**6))
    renderer = start(renderer, objective, {"y": np.array(0.0)})
    assert Effect.PRIMARY in renderer.plan.on
    assert Effect.INDIRECT not in renderer.plan.on  # there is no shadow in view
    for number in range(20):
        assert Effect.INDIRECT not in renderer.plan.on
        renderer = step(renderer, objective, {"y": np.array(-3.0)}, number, 1.0 / (1 + number))  # in front of the wall
    assert Effect.INDIRECT in renderer.plan.on
    assert renderer.plan[Effect.INDIRECT].reason == "it was exactly 0 when it was turned off, and no longer is"
    (line,) = [record.getMessage() for record in caplog.records if "on schedule" in record.getMessage()]
    assert "indirect visibility on" in line


def test_a_shadow_that_appears_later_is_found_when_the_loss_stalls() -> None:
    target = {"y": Translate("ball", (0, 1, 0))}
    renderer = PlannedRenderer(wall_scene(), target)
    objective = PixelL2(renderer.render({"y": np.array(-0.4)}, seed=10**6))
    renderer = start(renderer, objective, {"y": np.array(0.0)})
    params = {"y": np.array(-3.0)}
    cotangent = objective.value_and_grad(renderer.render(params))[1]
    for number in range(30):
        renderer = renderer.revisit(number, 100, 1.0 - 0.01 * number)  # it falls
    for number in range(19):
        renderer = renderer.revisit(30 + number, 100, 1.0)  # it does not
    assert Effect.INDIRECT not in renderer.plan.on
    renderer = renderer.revisit(49, 100, 1.0, params, cotangent)
    assert Effect.INDIRECT in renderer.plan.on


def test_a_light_behind_glass_keeps_its_paths() -> None:
    """Direct light is black there, because shadow rays do not pass glass."""
    bulb = {
        "type": "sphere",
        "to_world": mi.ScalarTransform4f().translate([0, 4, 0]).scale(1.2),
        "bsdf": {"type": "dielectric"},
    }
    lamp = {
        "type": "sphere",
        "to_world": mi.ScalarTransform4f().translate([0, 4, 0]).scale(0.8),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 10.0}},
    }
    scene = shadow_scene(bulb=bulb, lamp=lamp)
    del scene["ball"]
    target: dict[str, Any] = {"light": "lamp.emitter.radiance.value"}
    renderer = PlannedRenderer(scene, target)
    objective = PixelL2(renderer.render({"light": np.array([20.0, 15.0, 10.0])}, seed=10**6))
    renderer = start(renderer, objective, {"light": np.array([10.0, 10.0, 10.0])})
    assert {Effect.BOUNCES, Effect.SPECULAR} <= renderer.plan.on
    assert not renderer.plan.frozen
    dark = MitsubaRenderer(scene, target, integrator={"type": "prb", "max_depth": 2}).render(renderer.parameters())
    bright = renderer.render(renderer.parameters())
    assert bright.mean() > 3.0 * dark.mean()  # the rest is light that shines past the glass
    verification = renderer.verify(objective, draws=6)
    assert verification.gradient.cosine > 0.99 - 2.0 * verification.gradient.cosine_error


def test_an_object_that_only_reflects_light_into_view_keeps_its_bounces() -> None:
    """The object and its shadow are out of view: direct light does not depend on it, and the image hardly does."""
    transform = mi.ScalarTransform4f
    scene = shadow_scene(
        ball={
            "type": "sphere",
            "to_world": transform().translate([-5.0, 1.2, 0]),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.9, 0.9, 0.9]}},
        },
        lamp={
            "type": "sphere",
            "to_world": transform().translate([4, 6, 0]).scale(0.7),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 60.0}},
        },
    )
    renderer = PlannedRenderer(scene, {"x": Translate("ball", (1, 0, 0))})
    objective = PixelL2(renderer.render({"x": np.array(0.6)}, seed=10**6))
    renderer = start(renderer, objective, {"x": np.array(0.0)})
    assert Effect.BOUNCES in renderer.plan.on
    direct = {"type": "direct_projective", "guiding": "none"}
    blind = MitsubaRenderer(scene, {"x": Translate("ball", (1, 0, 0))}, integrator=direct)
    assert not np.any(blind.vjp({"x": np.array(0.0)}, np.ones((48, 64, 3)))["x"])


def test_only_optimised_parameters_are_planned_for_and_have_a_gradient() -> None:
    parameters: dict[str, Any] = {"place": Translate("ball"), "light": "lamp.emitter.radiance.value"}
    renderer = PlannedRenderer(shadow_scene(), parameters, spp=4)
    assert Effect.INDIRECT in renderer.plan.on
    params = renderer.parameters()
    image = renderer.render(params)
    started = renderer.start(params, np.ones_like(image), optimise=["light"])
    assert not started.plan.on & {Effect.INDIRECT, Effect.PRIMARY}
    assert Effect.INDIRECT in renderer.plan.on
    gradient = started.render_vjp(params)[1](np.ones_like(image))
    assert np.any(gradient["light"])
    assert not np.any(gradient["place"])
    with pytest.raises(ParameterError, match="`optimise` must name parameters of place, light, got 'floor'"):
        renderer.start(params, image, optimise=["floor"])


def test_a_plan_changes_neither_images_nor_gradients_of_a_renderer() -> None:
    """All hooks return other renderers; the plan of the first one keeps its depth."""
    renderer = PlannedRenderer(CASES["emitter colour"].scene(24, 18), CASES["emitter colour"].parameters, spp=4)
    params = renderer.parameters()
    image, pullback = renderer.render_vjp(params, seed=3)
    cotangent = np.random.default_rng(0).standard_normal(image.shape).astype(np.float32)
    gradient, plan = pullback(cotangent), renderer.plan
    later = renderer.start(params, cotangent).revisit(1, 9, 1.0, params, cotangent, seed=1)
    assert later.plan.measured
    assert later.plan.settings["max_depth"] != plan.settings["max_depth"]
    assert np.any(later.render(params, seed=3) != image)
    assert renderer.plan is plan
    np.testing.assert_array_equal(renderer.render(params, seed=3), image)
    again = renderer.render_vjp(params, seed=3)[1](cotangent)
    for name, value in gradient.items():  # threads add their samples in any order
        np.testing.assert_allclose(again[name], value, rtol=1e-3)


@thorough
def test_a_fit_plans_its_renderer() -> None:
    case = CASES["emitter colour"]
    renderer = PlannedRenderer(case.scene(24, 18), case.parameters, spp=4)
    assert capabilities_of(renderer).planner is renderer
    assert not renderer.plan.measured
    target = MitsubaRenderer(case.scene(24, 18), case.parameters, integrator=renderer.plan, spp=64).render(
        dict(case.truth), seed=10**6
    )
    optimise = {name: Free(value) for name, value in case.start.items()}
    result = fit(renderer, PixelL2(target), steps=60, learning_rate=1.0, optimise=optimise)
    assert result.plan.measured
    assert not renderer.plan.measured
    np.testing.assert_allclose(result.best_params["light"], case.truth["light"], rtol=0.1)


def test_a_planned_renderer_satisfies_the_contract() -> None:
    renderer = PlannedRenderer(CASES["emitter colour"].scene(12, 9), CASES["emitter colour"].parameters, spp=32)
    image = renderer.render(renderer.parameters())
    started = renderer.start(renderer.parameters(), np.ones_like(image))
    check_renderer(started, seeds=10)  # as many samples in all as 40 images of 8, in a fourth of the calls


def test_effect_images_show_the_change_by_each_effect() -> None:
    case = CASES["object and its shadow"]
    renderer = PlannedRenderer(case.scene(*SIZE) | {"integrator": DIRECT}, case.parameters, spp=4)
    image = renderer.render(dict(case.start))
    pictures = renderer.effect_images(dict(case.start), np.ones_like(image) * image)
    assert list(pictures) == ["continuous shading", "primary visibility", "indirect visibility"]
    assert all(picture.shape == image.shape and np.any(picture) for picture in pictures.values())
    fog = CASES["fog"]
    volume = PlannedRenderer(fog.scene(12, 9), fog.parameters, spp=1)
    assert volume.effect_images(dict(fog.start), np.ones((9, 12, 3), np.float32)) == {}


def test_the_jvp_is_the_transpose_of_the_vjp() -> None:
    """Both are one sum over the same samples, so they agree to rounding of sums of some thousand float32."""
    target: dict[str, Any] = {"light": "lamp.emitter.radiance.value", "floor": "floor.bsdf.reflectance.value"}
    renderer = MitsubaRenderer(shadow_scene(), target, spp=4)
    params = renderer.parameters()
    rng = np.random.default_rng(0)
    tangent = {name: np.float32(rng.standard_normal(value.shape)) for name, value in params.items()}
    change: Host = renderer.jvp(params, tangent, seed=3)
    cotangent = np.float32(rng.standard_normal(change.shape))
    gradient = renderer.vjp(params, cotangent, seed=3)
    scale = float(np.linalg.norm(cotangent) * np.linalg.norm(change))
    directional_derivative = sum(float(np.vdot(gradient[name], tangent[name])) for name in params)
    assert directional_derivative == pytest.approx(float(np.vdot(cotangent, change)), abs=1e-5 * scale)


@pytest.mark.parametrize(("fraction", "says"), [(1.0, "got 1.0"), (-0.1, "got -0.1"), ("much", "got 'much'")])
def test_the_fraction_of_a_plan_is_checked(fraction: Any, says: str) -> None:
    with pytest.raises(OptionError, match=f"`fraction` must be at least 0 and less than 1, {says}"):
        plan_effects(shadow_scene(), BALL, fraction=fraction)

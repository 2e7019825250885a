"""The rules turn off only effects that cannot matter, before anything is rendered."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from examples.effects.scenes import SUITE, Case
from loi_core.effects import Effect, EffectPlan
from loi_core.errors import OptionError, ParameterError
from loi_mitsuba import (
    CAPABILITIES,
    GradientWarning,
    MitsubaRenderer,
    PlannedRenderer,
    Rotate,
    Translate,
    plan_effects,
)
from mitsuba_boundaries.sensing.frustum import Frustum
from tests.mitsuba.scenes import box, shadow_scene

EDGES = {Effect.PRIMARY, Effect.INDIRECT}
CASES = {case.name: case for case in SUITE}
MOVING = ("place", "x", "z", "turn", "pan", "tilt")


@pytest.mark.parametrize("case", SUITE, ids=list(CASES))
def test_edges_are_sampled_exactly_if_a_shape_moves(case: Case) -> None:
    plan = plan_effects(case.scene(16, 12), case.parameters)
    moves = any(name in MOVING for name in case.parameters)
    single_shape = case.name == "visible object, no shadow"
    assert plan.on & EDGES == ((EDGES - ({Effect.INDIRECT} if single_shape else set())) if moves else set())
    assert Effect.CONTINUOUS in plan.on
    assert plan.understood
    assert all(choice.reason for choice in plan.choices)
    kinds = {"fog": "prbvolpath", "visible object, no shadow": "direct_projective"}
    assert plan.settings["integrator"] == kinds.get(case.name, "prb_projective" if moves else "prb")
    assert (Effect.MEDIA in plan.on) == (case.name == "fog")
    assert (Effect.EMITTERS in plan.on) == ("light" in case.parameters)
    assert (Effect.APPEARANCE in plan.on) == ("texture" in case.parameters)
    assert (Effect.SPECULAR in plan.on) == (case.name in ("object in a mirror only", "glass sphere with caustic"))


def test_every_effect_has_a_capability_and_only_cameras_cannot_be_simulated() -> None:
    assert [capability.effect for capability in CAPABILITIES] == list(Effect)
    assert [capability.effect for capability in CAPABILITIES if not capability.simulated] == [Effect.CAMERA]


@pytest.mark.parametrize(
    ("integrator", "depth"),
    [
        ({"type": "path", "max_depth": 5}, 5),
        ({"type": "path"}, 8),
        ({"type": "direct"}, 2),
        ({"type": "prb", "max_depth": 3}, 3),
        ({"type": "direct_projective"}, 2),
        ({"type": "prb_projective", "max_depth": 4}, 4),
        ({"type": "volpath", "max_depth": 6}, 6),
    ],
    ids=lambda value: value.get("type") if isinstance(value, dict) else str(value),
)
def test_the_scene_s_own_integrator_sets_the_depth(integrator: dict[str, Any], depth: int) -> None:
    scene = shadow_scene(integrator=integrator)
    plan = plan_effects(scene, {"floor": "floor.bsdf.reflectance.value"})
    assert plan.settings["max_depth"] == depth
    assert (Effect.BOUNCES in plan.on) == (depth > 2)


def test_a_plan_hides_emitters_if_the_scene_does() -> None:
    for plugin in ("path", "prb"):
        scene = shadow_scene(integrator={"type": plugin, "hide_emitters": True})
        plan = plan_effects(scene, {"floor": "floor.bsdf.reflectance.value"})
        assert plan.settings["hide_emitters"] is True
        assert MitsubaRenderer(scene, {"floor": "floor.bsdf.reflectance.value"}, integrator=plan)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"integrator": {"type": "moment", "nested": {"type": "path"}}}, "a MomentIntegrator"),
        (
            {
                "group": {"type": "shapegroup", "a": {"type": "cube"}},
                "twin": {"type": "instance", "g": {"type": "ref", "id": "group"}},
            },
            "a shape of kind Instance",
        ),
    ],
    ids=["integrator", "instance"],
)
def test_a_scene_unknown_to_the_rules_gets_all_effects_and_a_note(change: dict[str, Any], says: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GradientWarning)
        plan = plan_effects(shadow_scene(**change), {"x": Translate("ball", (1, 0, 0))})
    assert not plan.understood
    assert says in plan.notes[0]
    assert plan.on == set(Effect) - {Effect.CAMERA}
    assert plan.settings["sppc"] == 16
    if "integrator" not in change:
        assert (plan.settings["sppp"], plan.settings["sppi"]) == (16, 16)


def test_a_parameter_unknown_to_the_rules_gets_all_effects_and_a_note() -> None:
    scene = shadow_scene(spot={"type": "spot"})
    plan = plan_effects(scene, {"angle": "spot.cutoff_angle"})
    assert not plan.understood
    assert "parameter 'angle', of a SpotLight" in plan.notes[0]
    assert plan_effects(scene, {"light": "spot.intensity.value"}).understood


def test_a_film_samples_its_border_if_shapes_may_cross_it() -> None:
    scene = shadow_scene()
    scene["sensor"]["film"]["rfilter"] = {"type": "gaussian"}
    target = {"x": Translate("ball", (1, 0, 0))}
    plan = plan_effects(scene, target)
    assert plan.settings["sample_border"] is True
    assert MitsubaRenderer(scene, target, integrator=plan).sensor.film().sample_border()
    assert not scene["sensor"]["film"].get("sample_border")  # the caller's dict is as it was
    assert any("sample_border=True" in note for note in plan_effects(mi.load_dict(scene), target).notes)
    assert plan_effects(scene, {"floor": "floor.bsdf.reflectance.value"}).settings["sample_border"] is False
    assert plan_effects(shadow_scene(), target).settings["sample_border"] is False  # a box filter ends at its pixel


def test_a_plan_notes_missing_gradients() -> None:
    mirror = {"type": "rectangle", "bsdf": {"type": "conductor"}}
    plan = plan_effects(shadow_scene(mirror=mirror), {"x": Translate("ball", (1, 0, 0))}, proxy=None)
    assert any("perfect mirror" in note for note in plan.notes)
    fog = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 0.5}
    cloud = {"type": "sphere", "bsdf": {"type": "null"}, "interior": fog}
    with pytest.warns(GradientWarning, match="no gradient of moving silhouettes"):
        plan = plan_effects(shadow_scene(cloud=cloud), {"x": Translate("ball", (1, 0, 0))}, blur=None)
    assert any("where there is a medium" in note for note in plan.notes)
    assert not plan.on & EDGES
    with pytest.raises(ParameterError, match="for perspective only"):
        plan_effects(shadow_scene(sensor={"type": "orthographic"}), {"x": Translate("ball", (1, 0, 0))}, blur=None)


def test_a_plan_whose_pilot_turned_edges_off_causes_no_warning() -> None:
    """Only the pilot can find that a rotating environment map has no outline in view."""
    case = CASES["environment rotation"]
    scene = case.scene(16, 12) | {"integrator": {"type": "direct"}}
    renderer = PlannedRenderer(scene, case.parameters)
    image = renderer.render(dict(case.start))
    plan = renderer.start(dict(case.start), np.ones_like(image) * image).plan
    assert plan.settings["integrator"] == "prb"
    assert MitsubaRenderer(scene, case.parameters, integrator=plan)  # a warning is an error in tests
    with pytest.warns(GradientWarning, match="no gradient of moving silhouettes"):
        MitsubaRenderer(scene, case.parameters, integrator={"type": "prb"})


def test_a_renderer_takes_the_integrator_and_samples_of_a_plan() -> None:
    target = {"x": Translate("ball", (1, 0, 0))}
    scene = shadow_scene(integrator={"type": "direct"})
    plan = plan_effects(scene, target, spp=4)
    image, pullback = MitsubaRenderer(scene, target, integrator=plan, spp=4).render_vjp({"x": np.float32(0)})
    integrator = {"type": "direct_projective", "guiding": "none"}
    fixed_image, fixed_pullback = MitsubaRenderer(scene, target, integrator=integrator, spp=4).render_vjp(
        {"x": np.float32(0)}
    )
    np.testing.assert_array_equal(image, fixed_image)
    np.testing.assert_allclose(
        pullback(image)["x"], fixed_pullback(image)["x"], rtol=1e-3
    )  # sums by atomic adds, in any order
    with pytest.raises(OptionError, match="`spp_grad` and a plan exclude each other"):
        MitsubaRenderer(scene, target, integrator=plan, spp_grad=4)
    foreign = EffectPlan(plan.choices, {"samples": 3})
    with pytest.raises(OptionError, match="not one for Mitsuba; its settings are samples"):
        MitsubaRenderer(scene, target, integrator=foreign)
    too_many = dataclasses.replace(plan, settings={**plan.settings, "sppi": 2**31})
    with pytest.raises(OptionError, match="`sppi` must be a whole number of samples"):
        MitsubaRenderer(scene, target, integrator=too_many)


def test_a_shape_outside_the_frustum_is_in_no_image() -> None:
    """An emitting ball at random positions is compared with images of it."""
    scene = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 50,
            "to_world": mi.ScalarTransform4f().look_at([1, 2, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 32, "height": 24, "rfilter": {"type": "box"}},
        },
        "ball": {"type": "sphere", "radius": 0.4, "emitter": {"type": "area", "radiance": 1.0}},
    }
    renderer = MitsubaRenderer(scene, {"place": Translate("ball")}, spp=16)
    (ball,) = renderer.scene.shapes()
    agreed = {True: 0, False: 0}
    for position in np.random.default_rng(0).uniform(-7, 9, (60, 3)):
        visible = bool(renderer.render({"place": position}).any())
        overlaps = Frustum(renderer.sensor).overlaps(ball)
        assert overlaps or not visible
        agreed[overlaps] += overlaps == visible
    assert agreed[True] >= 5
    assert agreed[False] >= 20


def test_a_shape_around_the_camera_keeps_shadows_and_bounces() -> None:
    scene = SUITE[2].scene(16, 12)
    scene["ball"] = {"type": "sphere", "radius": 20.0, "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}}}
    plan = plan_effects(scene, {"place": Translate("ball")})
    assert plan.on >= {Effect.INDIRECT, Effect.BOUNCES}


def test_rotating_a_shape_needs_edges() -> None:
    plan = plan_effects(shadow_scene(box=box((1, 1, 0), 0.4)), {"turn": Rotate("box", (0, 1, 0))})
    assert plan.on >= EDGES


def test_a_reason_names_a_few_of_many_parameters_and_counts_the_others() -> None:
    scene = shadow_scene() | {
        f"ball_{k}": {"type": "sphere", "center": [k - 3.0, 0.5, 1.0], "radius": 0.2} for k in range(6)
    }
    plan = plan_effects(scene, {f"x_{k}": Translate(f"ball_{k}", (1, 0, 0)) for k in range(6)})
    reason = plan[Effect.PRIMARY].reason
    assert "'x_0', 'x_1', 'x_2', 'x_3' and 2 others" in reason

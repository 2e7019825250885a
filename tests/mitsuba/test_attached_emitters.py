"""Gradients of attached emitter samples are exact and hardly noisy, and are used only where they are complete."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_core import Free, LOIObjective, fit
from loi_core.errors import OptionError
from loi_mitsuba import MitsubaRenderer, PlannedRenderer, Rotate, Scale, Translate, plan_effects
from loi_mitsuba.effects.attached_gradient import AttachedGradient, AttachedParameters, attachable_emitters
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.strategies import thorough

X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
EMITS = {"type": "area", "radiance": {"type": "rgb", "value": [40.0, 36.0, 30.0]}}
GLOSSY = {"type": "roughconductor", "alpha": 0.2}
RAMP = np.linspace(-1.0, 1.0, WIDTH, dtype=np.float32)[None, :, None] * np.ones((HEIGHT, WIDTH, 3), np.float32)


def lamp(light: str) -> dict[str, Any]:
    """A light seven units above the floor."""
    above = mi.ScalarTransform4f().translate([0, 7, 0])
    return {
        "ball": {"type": "sphere", "center": [0, 7, 0], "radius": 0.5, "emitter": EMITS},
        "panel": {"type": "rectangle", "to_world": above.rotate(X, 90), "emitter": EMITS},
        "box": {"type": "cube", "to_world": above.scale(0.6), "emitter": EMITS},
        "point": {"type": "point", "position": [0, 7, 0], "intensity": 40.0},
        "spot": {
            "type": "spot",
            "to_world": mi.ScalarTransform4f().look_at([0, 7, 0], [0, 0, 0], [0, 0, 1]),
            "intensity": 40.0,
            "cutoff_angle": 30.0,
            "beam_width": 15.0,
        },
    }[light]


def lit_scene(light: str, **changes: Any) -> dict[str, Any]:
    """Two balls on a floor, one of them glossy, and their shadows."""
    return shadow_scene(
        ball={"type": "sphere", "center": [-1, 1.2, 0], "radius": 0.9},
        other={"type": "sphere", "center": [1.5, 0.8, 1], "radius": 0.8, "bsdf": GLOSSY},
        lamp=lamp(light),
        integrator={"type": "direct"},
        **changes,
    )


def attached_gradient(renderer: MitsubaRenderer, samples: int) -> AttachedGradient:
    parameters = AttachedParameters(attachable_emitters(renderer.names, renderer.targets), {})
    return AttachedGradient(renderer, parameters, samples)


def differences(renderer: MitsubaRenderer, params: dict[str, Any], steps: dict[str, float]) -> tuple[Host, Host]:
    """Return central differences of the image weighted by RAMP for each parameter, and their standard errors."""
    draws = []
    for seed in range(4):
        slopes = []
        for name, step in steps.items():
            plus, minus = (
                renderer.render({**params, name: params[name] + np.float32(offset)}, seed=seed)
                for offset in (step, -step)
            )
            slopes.append(float(np.sum((plus.astype(np.float64) - minus) * RAMP)) / (2.0 * step))
        draws.append(slopes)
    return np.mean(draws, axis=0), np.std(draws, axis=0, ddof=1) / 2.0


@pytest.mark.parametrize(
    "light",
    [
        "ball",
        "point",
        pytest.param("panel", marks=thorough),
        pytest.param("box", marks=thorough),
        pytest.param("spot", marks=thorough),
    ],
)
def test_the_gradient_of_a_moving_light_matches_finite_differences(light: str) -> None:
    """The gradient includes shading, highlights and shadows."""
    handles: dict[str, Any] = {"x": Translate("lamp", X), "y": Translate("lamp", Y), "z": Translate("lamp", Z)}
    params: dict[str, Any] = {"x": np.float32(1.5), "y": np.float32(0.0), "z": np.float32(-1.0)}
    steps = {"x": 0.1, "y": 0.1, "z": 0.1}
    if light != "point":
        handles["turn"], params["turn"], steps["turn"] = Rotate("lamp", Z), np.float32(10.0), 2.0
    if light in ("ball", "panel"):
        handles["size"], params["size"], steps["size"] = Scale("lamp"), np.float32(1.2), 0.05
    images = tuple(handles) if light in ("point", "spot") else ()
    renderer = MitsubaRenderer(lit_scene(light), handles, spp=128, without_gradient=images)
    gradient = attached_gradient(renderer, 32)
    draws = [list(gradient.vjp(params, RAMP, names=handles, seed=seed).values()) for seed in range(6)]
    mean, error = np.mean(draws, axis=0), np.std(draws, axis=0, ddof=1) / np.sqrt(6)
    expected, expected_error = differences(renderer, params, steps)
    rounding = 32.0 * np.finfo(np.float32).eps * np.max(np.abs(expected))  # the gradient of a rotating ball is 0
    bound = 0.02 * np.abs(expected) + 4.0 * np.hypot(error, expected_error) + rounding
    np.testing.assert_array_less(np.abs(mean - expected), bound)


@pytest.mark.parametrize("changes", [{"half": 400.0}, {"glow": 0.05}], ids=["wide floor", "glowing floor"])
def test_a_wide_or_emitting_floor_receives_the_light_of_an_attached_light(changes: dict[str, float]) -> None:
    scene = lit_scene("point")
    scene["floor"]["to_world"] = mi.ScalarTransform4f().rotate(X, -90).scale(changes.get("half", 8.0))
    if "glow" in changes:
        scene["floor"]["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": changes["glow"]}}
    handles: dict[str, Any] = {"x": Translate("lamp", X), "y": Translate("lamp", Y)}
    params: dict[str, Any] = {"x": np.float32(1.5), "y": np.float32(0.0)}
    renderer = MitsubaRenderer(scene, handles, spp=64, without_gradient=tuple(handles))
    gradient = attached_gradient(renderer, 32)
    draws = [list(gradient.vjp(params, RAMP, names=handles, seed=seed).values()) for seed in range(6)]
    mean, error = np.mean(draws, axis=0), np.std(draws, axis=0, ddof=1) / np.sqrt(6)
    expected, expected_error = differences(renderer, params, {"x": 0.1, "y": 0.1})
    np.testing.assert_array_less(
        np.abs(mean - expected), 0.02 * np.abs(expected) + 4.0 * np.hypot(error, expected_error)
    )


@pytest.fixture(params=[1, 2], ids=["1 thread", "2 threads"])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    """Number of threads of Dr.Jit, which selects other instructions for the sums of a gradient with several."""
    count = dr.thread_count()
    dr.set_thread_count(request.param)
    yield request.param
    dr.set_thread_count(count)


@pytest.mark.usefixtures("threads")
@pytest.mark.parametrize(
    ("light", "target"),
    [("point", "lamp.position"), ("point", Translate("lamp")), ("panel", Translate("lamp"))],
    ids=lambda value: getattr(value, "shape", value),
)
def test_the_gradient_of_an_array_contains_shading_and_shadows(light: str, target: str | Translate) -> None:
    """Elements of one array and single parameters have the same gradient for the same samples."""
    handles: dict[str, Any] = {"x": Translate("lamp", X), "y": Translate("lamp", Y), "z": Translate("lamp", Z)}
    single, array = (
        MitsubaRenderer(lit_scene(light), targets, spp=8, without_gradient=() if light == "panel" else tuple(targets))
        for targets in (handles, {"place": target})
    )
    expected = attached_gradient(single, 8).vjp(single.parameters(), RAMP, names=handles)
    place = attached_gradient(array, 8).vjp(array.parameters(), RAMP, names=["place"])["place"]
    np.testing.assert_allclose(place, list(expected.values()), rtol=1e-3)


def test_attached_emitter_samples_have_a_fiftieth_of_mitsuba_s_noise() -> None:
    targets = {"place": Translate("lamp")}
    renderer = MitsubaRenderer(lit_scene("ball"), targets, spp=16)
    gradient, params = (
        attached_gradient(renderer, 16),
        renderer.parameters(),
    )
    attached = [gradient.vjp(params, RAMP, names=targets, seed=seed)["place"] for seed in range(6)]
    mitsuba = [renderer.vjp(params, RAMP, seed=seed)["place"] for seed in range(6)]
    assert np.linalg.norm(np.std(attached, axis=0)) < 0.02 * np.linalg.norm(np.std(mitsuba, axis=0))


def test_a_moving_light_in_view_has_the_gradient_of_its_silhouette() -> None:
    visible_lamp = {"type": "sphere", "center": [0, 2.5, 0], "radius": 0.5, "emitter": EMITS}
    scene = lit_scene("ball")
    scene["lamp"] = visible_lamp
    targets = {"x": Translate("lamp", X)}
    renderer = MitsubaRenderer(scene, targets, spp=128)
    gradient, params = (
        attached_gradient(renderer, 32),
        renderer.parameters(),
    )
    draws = [float(gradient.vjp(params, RAMP, names=targets, seed=seed)["x"]) for seed in range(8)]
    expected, expected_error = differences(renderer, params, {"x": 0.1})
    error = np.hypot(np.std(draws, ddof=1) / np.sqrt(8), expected_error[0])
    assert np.mean(draws) == pytest.approx(expected[0], rel=0.03, abs=4.0 * error)


@thorough
def test_a_light_that_comes_into_view_has_the_gradient_of_its_silhouette() -> None:
    """The film samples its border, so that the scene is loaded twice; the light must be the second scene's."""
    scene = lit_scene("ball")
    scene["sensor"]["film"]["rfilter"] = {"type": "tent"}
    planned = PlannedRenderer(scene, {"x": Translate("lamp", X), "y": Translate("lamp", Y)}, spp=32)
    planned = planned.start(planned.parameters(), RAMP)
    assert list(planned.plan.attached) == ["x", "y"]
    params: dict[str, Any] = {"x": np.float32(0.0), "y": np.float32(-4.5)}
    draws = [float(planned.render_vjp(params, seed=seed)[1](RAMP)["x"]) for seed in range(8)]
    expected, expected_error = differences(planned.unabridged.with_integrator("scene", spp=128), params, {"x": 0.1})
    error = np.hypot(np.std(draws, ddof=1) / np.sqrt(8), expected_error[0])
    assert np.mean(draws) == pytest.approx(expected[0], rel=0.03, abs=4.0 * error)


@pytest.mark.parametrize("light", ["lamp.position", pytest.param(Translate("lamp"), marks=thorough)], ids=str)
@pytest.mark.parametrize("blur", [{}, pytest.param(None, marks=thorough)], ids=["blur", "no blur"])
def test_a_fit_finds_a_point_light(light: Any, blur: dict[str, Any] | None) -> None:
    """The fit ends within 0.05 of the position, from a distance of 2.7; the shadow of the ball is visible too."""
    scene = lit_scene("point")
    scene["sensor"]["film"] |= {"width": 32, "height": 24}
    planned = PlannedRenderer(scene, {"light": light}, spp=16, blur=blur)
    start = planned.parameters()["light"]
    truth = start + np.array([2.0, 1.0, -1.5], np.float32)
    result = fit(planned, LOIObjective(planned.render({"light": truth}, seed=10**6)), steps=50)
    assert list(result.plan.attached) == ["light"]
    assert not result.plan.blurred
    np.testing.assert_allclose(result.best_params["light"], truth, atol=0.05)


def begun(scene: dict[str, Any], targets: dict[str, Any], **options: Any) -> PlannedRenderer:
    """Return a planned renderer after its pilot."""
    planned = PlannedRenderer(scene, targets, **options)
    return planned.start(planned.parameters(), RAMP)


def test_a_light_without_visible_direct_light_is_not_attached() -> None:
    """A lid blocks all direct light of the lamp, whose silhouette is out of view as well, so that it is frozen."""
    lid = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 6, 0]).scale([9, 0.1, 9])}
    for light, field in (("ball", "frozen"), ("point", "blurred")):
        plan = begun(lit_scene(light, lid=lid), {"x": Translate("lamp", X)}, spp=4).plan
        assert not plan.attached
        assert list(getattr(plan, field)) == ["x"]
    targets: dict[str, Any] = {"x": Translate("lamp", X), "ball": Translate("ball", X)}
    plan = begun(
        lit_scene("point", lid=lid), targets, spp=4, blur={"names": ["ball"]}
    ).plan  # `names` excludes the light from blurring
    assert list(plan.attached) == ["x"]


def test_a_light_seen_in_a_mirror_keeps_mitsuba_s_gradient() -> None:
    """The floor is a mirror, whose reflection of the glowing ball carries nearly all of the gradient."""
    targets = mi.ScalarTransform4f
    mirror = {"type": "rectangle", "to_world": targets().translate([0, 0, -1]).scale(8), "bsdf": {"type": "conductor"}}
    glows = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    scene = shadow_scene(
        floor=mirror,
        ball={"type": "sphere", "center": [0, -4.5, 2], "radius": 0.8, "emitter": glows},
        grey={"type": "sphere", "center": [2.5, 0, 0], "radius": 0.8},
        lamp={"type": "constant", "radiance": 0.1},
        integrator={"type": "path", "max_depth": 3},
    )
    planned = begun(scene, {"x": Translate("ball", X)}, spp=16)
    assert not planned.plan.attached
    assert not planned.plan.frozen
    assert not planned.plan.blurred


@thorough
def test_a_moving_light_is_attached_and_a_moving_ball_is_not() -> None:
    """The scene has its initial values again after each gradient."""
    targets = {"lamp": Translate("lamp", X), "ball": Translate("ball", X)}
    planned = PlannedRenderer(lit_scene("ball"), targets, spp=16)
    start = planned.parameters()
    planned = planned.start(start, RAMP)
    image, pullback = planned.render_vjp(start)
    first = pullback(RAMP)
    assert list(planned.plan.attached) == ["lamp"]
    (row,) = (line for line in str(planned.plan).splitlines() if line.startswith("| 'lamp'"))
    assert "it moves the area light, and attached samples of its direct light have the gradient" in row
    assert planned.groups == (("ball",),)
    assert np.all(first["ball"])
    np.testing.assert_allclose(pullback(RAMP)["lamp"], first["lamp"], rtol=1e-4)
    np.testing.assert_array_equal(planned.render(start), image)
    alone = planned.start(start, RAMP, optimise=["ball"])
    assert not alone.plan.attached
    assert not np.any(alone.render_vjp(start)[1](RAMP)["lamp"])


def test_the_scale_of_an_emitting_mesh_is_not_attached() -> None:
    """Mitsuba's samples of a mesh do not scale with it."""
    for light, wrt in (("box", ["x"]), ("panel", ["x", "size"])):
        renderer = MitsubaRenderer(lit_scene(light), {"x": Translate("lamp", X), "size": Scale("lamp")}, spp=4)
        assert list(attachable_emitters(renderer.names, renderer.targets)) == wrt


def test_attached_lights_can_be_turned_off() -> None:
    light: dict[str, Any] = {"x": Translate("lamp", X)}
    assert list(begun(lit_scene("point"), light, spp=4, attached_lights=False).plan.blurred) == ["x"]
    assert not begun(lit_scene("ball"), light, spp=4, attached_lights=False).plan.attached
    assert not plan_effects(lit_scene("point"), light, attached_lights=False).attached
    assert list(PlannedRenderer(lit_scene("point"), light, blur={"names": ["x"]}).plan.blurred) == ["x"]
    with pytest.raises(OptionError, match="`attached_lights` must be true or false, got 1"):
        PlannedRenderer(lit_scene("point"), light, attached_lights=1)  # type: ignore[arg-type]


@thorough
def test_a_fit_finds_a_light_together_with_a_ball_and_a_colour() -> None:
    scene = lit_scene("ball")
    scene["sensor"]["film"] |= {"width": 48, "height": 36}
    targets: dict[str, Any] = {
        "lamp": Translate("lamp", X),
        "ball": Translate("ball", Z),
        "floor": "floor.bsdf.reflectance.value",
    }
    planned = PlannedRenderer(scene, targets, spp=16)
    truth: dict[str, Any] = {
        "lamp": np.float32(2.5),
        "ball": np.float32(1.2),
        "floor": np.array([0.6, 0.5, 0.3], np.float32),
    }
    target = planned.render(truth, seed=10**6)
    result = fit(
        planned,
        LOIObjective(target),
        steps=100,
        optimise={"lamp": Free(None, -5, 5), "ball": Free(None, -5, 5), "floor": Free(None, 0.0, 1.0)},
    )
    assert list(planned.plan.attached) == ["lamp"]
    for name, value in truth.items():
        np.testing.assert_allclose(result.best_params[name], value, atol=0.1)

"""Parameters without a gradient in Mitsuba are blurred, all others are not, and one fit finds both."""

from __future__ import annotations

import gc
import json
import logging
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_core import Free, LOIObjective, PixelL2, fit
from loi_core.cli import main
from loi_core.effects import Effect
from loi_core.errors import OptionError, ParameterError
from loi_core.io.images import write_png
from loi_core.pixels.encoding import encode_srgb
from loi_core.renderers import BlurredRenderer
from loi_mitsuba import MitsubaRenderer, PlannedRenderer, Rotate, Scale, Translate
from tests.mitsuba.scenes import HEIGHT, WIDTH, random_cotangent, shadow_scene
from tests.mitsuba.test_scene_file import SCENE, XML
from tests.strategies import thorough

X = (1, 0, 0)
FLOOR = "floor.bsdf.reflectance.value"
GREY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}}


def lit_scene(**changes: Any) -> dict[str, Any]:
    """A ball on a grey floor under a point light, all of it direct light."""
    floor = {"type": "rectangle", "to_world": mi.ScalarTransform4f().rotate(X, -90).scale(8), "bsdf": GREY}
    return shadow_scene(
        **{
            "floor": floor,
            "ball": {"type": "sphere", "center": [0, 0.8, 0], "radius": 0.8},
            "lamp": {"type": "point", "position": [-2, 3, 1], "intensity": 15.0},
            "integrator": {"type": "path", "max_depth": 2},
            **changes,
        }
    )


def test_one_fit_finds_parameters_with_and_without_a_gradient() -> None:
    """A colour, and the position of a point light, which is visible only by its light and by the ball's shadow."""
    scene = lit_scene()
    scene["sensor"]["film"] |= {"width": 32, "height": 24}
    planned = PlannedRenderer(scene, {"light": Translate("lamp", X), "floor": FLOOR}, spp=8, attached_lights=False)
    assert list(planned.plan.blurred) == ["light"]
    truth: dict[str, Any] = {"light": np.float32(3.0), "floor": np.array([0.7, 0.5, 0.3], np.float32)}
    target = planned.render(truth, seed=10**6)
    free = {"light": Free(None, -1.0, 5.0), "floor": Free(None, 0.0, 1.0)}
    result = fit(planned, LOIObjective(target), steps=40, optimise=free)
    assert float(result.best_params["light"]) == pytest.approx(3.0, abs=0.1)
    np.testing.assert_allclose(result.best_params["floor"], truth["floor"], atol=0.03)
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "converged"


def shining_scene() -> dict[str, Any]:
    """Return a nearly specular ball with a small highlight of a light behind the camera."""
    ball = {"type": "roughconductor", "alpha": 0.02}
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": [60.0] * 3}}
    return lit_scene(
        sensor={
            "type": "perspective",
            "fov": 36.0,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 48, "height": 36, "rfilter": {"type": "box"}},
        },
        ball={"type": "sphere", "radius": 1.6, "bsdf": ball},
        lamp={"type": "sphere", "center": [2, -1, 7], "radius": 0.25, "emitter": lamp},
        sky={"type": "constant", "radiance": {"type": "rgb", "value": [0.25] * 3}},
    )


@thorough
def test_a_parameter_with_a_noisy_gradient_is_blurred_by_the_pilot() -> None:
    lamp = {"x": Translate("lamp", X), "y": Translate("lamp", (0, 1, 0))}
    scene = shining_scene()
    del scene["floor"]
    planned = PlannedRenderer(scene, lamp, spp=16, attached_lights=False)
    without_blur = PlannedRenderer(scene, lamp, spp=16, attached_lights=False, blur=None)
    truth = {"x": np.float32(-1.5), "y": np.float32(2.0)}
    objective = LOIObjective(planned.unabridged.render(truth, seed=10**6))
    free = {name: Free(None, -5.0, 5.0) for name in lamp}
    assert not planned.plan.blurred
    result = fit(planned, objective, steps=60, optimise=free)
    assert not result.plan.frozen
    assert list(result.plan.blurred) == ["x", "y"]
    assert "cannot be distinguished from noise in 8 draws; the blurred gradient is significant" in str(result.plan)
    for name, value in truth.items():
        assert float(result.best_params[name]) == pytest.approx(float(value), abs=0.7)  # a pixel and a half
    start = without_blur.parameters()
    cotangent = objective.value_and_grad(without_blur.render(start))[1]
    plan = without_blur.start(start, cotangent).plan
    assert list(plan.frozen) == ["x", "y"]
    assert not plan.blurred


def test_a_shape_that_comes_into_view_is_no_longer_blurred(caplog: pytest.LogCaptureFixture) -> None:
    """At first only a faint shadow of the ball is in view."""
    caplog.set_level(logging.INFO, "loi_mitsuba")
    planned = PlannedRenderer(shadow_scene(integrator={"type": "direct"}), {"place": Translate("ball")})
    objective = PixelL2(planned.render({"place": np.array([0.5, 0.0, 0.3])}, seed=10**6))

    def gradient(params: dict[str, Any]) -> tuple[dict[str, Any], Any]:
        return params, objective.value_and_grad(planned.render(params))[1]

    planned = planned.start(*gradient({"place": np.array([-0.3, 0.0, 0.0])}))
    assert list(planned.plan.blurred) == ["place"]
    planned = planned.revisit(1, 9, 1.0, *gradient({"place": np.array([0.0, -3.5, 0.0])}), seed=1)
    assert not planned.plan.blurred
    assert planned.plan.measured
    assert Effect.PRIMARY in planned.plan.on
    messages = [record.getMessage() for record in caplog.records]
    assert any(
        line.startswith("effects, by the pilot: ") and "'place' blurred (its gradient" in line for line in messages
    )
    assert any("as it comes into view" in line and "'place' no longer blurred" in line for line in messages)


def test_a_blurred_parameter_is_released_when_its_gradient_becomes_significant() -> None:
    """The first loss hardly depends on the shadow of a ball out of view, the second one strongly."""
    scene = shadow_scene(integrator={"type": "direct"})
    planned = PlannedRenderer(scene, {"x": Translate("ball", X)}, spp=4)
    params = planned.parameters()
    planned = planned.start(params, random_cotangent())
    assert list(planned.plan.blurred) == ["x"]
    ramp = np.linspace(-1.0, 1.0, WIDTH, dtype=np.float32)[None, :, None] * np.ones((HEIGHT, WIDTH, 3), np.float32)
    pulled = []
    for step in range(1, 22):
        pulled.append(planned.render_vjp(params, seed=step)[1](ramp)["x"])
        planned = planned.revisit(step, 22, 1.0 / step, params, ramp, seed=step)
    assert not planned.plan.blurred
    assert not planned.plan.frozen
    assert pulled[-1] == pytest.approx(np.mean(pulled[:-1]), rel=0.5)


def test_a_plan_with_all_gradients_blurs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr(BlurredRenderer, "__init__", refuse)
    planned = PlannedRenderer(lit_scene(), {"floor": FLOOR}, spp=4)
    image = planned.render(planned.parameters())
    planned = planned.start(planned.parameters(), np.ones_like(image))
    assert np.any(planned.render_vjp(planned.parameters())[1](np.ones_like(image))["floor"])
    assert not planned.plan.blurred
    assert "blurred" not in str(planned.plan)


def test_many_noisy_parameters_are_frozen_and_not_blurred(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sixteen blurred draws would be significant for none of them, and would cost hundreds of renders."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr(BlurredRenderer, "__init__", refuse)
    shapes = {f"far_{k}": {"type": "sphere", "center": [4.0 * k, 9, 90], "radius": 1} for k in range(6)}
    planned = PlannedRenderer(shadow_scene(**shapes), {name: Translate(name) for name in shapes}, spp=4)
    params = planned.parameters()
    plan = planned.start(params, np.ones_like(planned.render(params))).plan
    assert list(plan.frozen) == list(shapes)
    assert not plan.blurred


GLASS: dict[str, Any] = {
    "ball": {"type": "sphere", "center": [0, 1.2, 0], "radius": 0.8, "bsdf": {"type": "dielectric"}},
    "integrator": {"type": "path", "max_depth": 5},
}
LAMP_OUT_OF_VIEW = {"lamp": {"type": "point", "position": [0.5, 12, 0], "intensity": 150.0}}  # out of view
PARALLEL: dict[str, Any] = {
    "type": "orthographic",
    "to_world": ("look_at", [0, 6, 6], [0, 0, 0], [0, 1, 0]),
    "film": {"type": "hdrfilm", "width": 64, "height": 48, "rfilter": {"type": "box"}},
}
FOG = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 0.5}


@pytest.mark.parametrize(
    ("changes", "target", "says"),
    [
        ({}, "lamp.position", "gradient for moving a PointLight is missing or wrong"),
        ({}, Translate("lamp"), "it moves a PointLight"),
        ({}, Rotate("sensor", (0, 1, 0)), "it moves a camera"),
        ({}, "sensor.x_fov", "no gradient for sensors"),
        (GLASS, Translate("ball", X), "it moves clear glass"),
        (GLASS, Scale("ball"), "it moves clear glass"),
        (GLASS, "ball.bsdf.eta", "Mitsuba gives no gradient for it"),
        (
            {"cloud": {"type": "sphere", "bsdf": {"type": "null"}, "interior": FOG}},
            Translate("ball", X),
            "it moves a shape in a scene with a medium",
        ),
        (
            {"sensor": PARALLEL},
            Translate("ball", X),
            "no gradient of outlines for a camera of type OrthographicCamera",
        ),
        (
            {
                "group": {"type": "shapegroup", "inner": {"type": "sphere"}},
                "one": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}},
            },
            Translate("group.inner", X),
            "it moves a shape of a shapegroup",
        ),
        (
            {"integrator": {"type": "aov", "aovs": "far:depth"}},
            Translate("ball", X),
            "type AOVIntegrator has no gradient",
        ),
        ({"integrator": {"type": "depth"}}, Translate("ball", X), "type DepthIntegrator has no gradient of outlines"),
    ],
    ids=[
        *("position", "light", "camera", "lens", "glass", "size of glass", "index", "medium", "parallel", "instance"),
        *("values", "depths"),
    ],
)
def test_a_plan_lists_the_blurred_parameters_with_reasons(changes: dict[str, Any], target: Any, says: str) -> None:
    if "sensor" in changes:
        pose = mi.ScalarTransform4f().look_at(*PARALLEL["to_world"][1:]).scale(3)
        changes = {"sensor": {**PARALLEL, "to_world": pose}}
    planned = PlannedRenderer(lit_scene(**changes), {"it": target}, spp=4, attached_lights=False, attached_glass=False)
    assert says in planned.plan.blurred["it"]
    (row,) = (line for line in str(planned.plan).splitlines() if line.startswith("| 'it'"))
    assert "| blurred |" in row
    start = planned.parameters()
    image = planned.render(start)
    moved = {"it": start["it"] + np.float32(0.1)}
    assert not np.array_equal(planned.render(moved), image)
    np.testing.assert_array_equal(planned.render(start), image)


def test_a_shape_that_moves_under_a_directional_area_is_blurred() -> None:
    pose = mi.ScalarTransform4f().translate([0, 5, 0]).rotate(X, 90)
    beam = {"type": "rectangle", "to_world": pose, "emitter": {"type": "directionalarea"}}
    scene = lit_scene(lamp=beam, sky={"type": "constant"})
    reason = PlannedRenderer(scene, {"it": Translate("ball", X)}, spp=4).plan.blurred["it"]
    gc.collect()  # Mitsuba queries the lights of all scenes that still exist, and this one lacks a method
    assert "under a DirectionalArea" in reason


def test_a_colour_has_no_gradient_in_an_image_of_depths() -> None:
    scene = lit_scene(integrator={"type": "depth"})
    for renderer in (
        MitsubaRenderer(scene, {"floor": FLOOR}, integrator="scene"),
        PlannedRenderer(scene, {"floor": FLOOR}),
    ):
        image, pullback = renderer.render_vjp(renderer.parameters())
        assert np.all(image > 0.0)
        assert not np.any(pullback(np.ones_like(image))["floor"])


def test_without_a_blur_parameters_are_refused_or_have_mitsuba_s_gradient() -> None:
    with pytest.raises(ParameterError, match=r"is missing or wrong; .* or use PlannedRenderer"):
        PlannedRenderer(lit_scene(), {"light": "lamp.position"}, blur=None, attached_lights=False)
    with pytest.raises(ParameterError, match=r"'sensor' cannot be moved: .*; or use PlannedRenderer"):
        PlannedRenderer(lit_scene(), {"pose": Translate("sensor")}, blur=None)
    moved = {"x": Translate("ball", X)}
    plan = PlannedRenderer(lit_scene(**GLASS, **LAMP_OUT_OF_VIEW), moved, blur=None, attached_glass=False).plan
    assert not plan.blurred
    assert "dielectric 'bsdf'" in plan.substitutions
    with pytest.raises(ParameterError, match=r"has no parameter 'lamp\.place'"):
        PlannedRenderer(lit_scene(), {"light": "lamp.place"})


def test_an_environment_light_cannot_be_moved() -> None:
    scene = shadow_scene(sky={"type": "constant"})
    for renderer in (MitsubaRenderer, PlannedRenderer):
        with pytest.raises(
            ParameterError, match=r"'sky' cannot be moved: a ConstantBackgroundEmitter has no position$"
        ):
            renderer(scene, {"turn": Rotate("sky", (0, 1, 0))})


def test_a_matrix_is_fitted_with_a_handle_and_not_by_its_elements() -> None:
    with pytest.raises(
        ParameterError,
        match=r"'sensor.to_world' cannot be fitted: .*a Translate or Rotate of 'sensor', whose gradient it estimates",
    ):
        PlannedRenderer(lit_scene(), {"pose": "sensor.to_world"})


def test_moving_the_camera_equals_moving_the_scene_the_opposite_way() -> None:
    scene = shadow_scene(ball={"type": "sphere", "radius": 0.7}, lamp={"type": "constant"}, floor={"type": "null"})
    del scene["floor"]
    camera = PlannedRenderer(scene, {"it": Translate("sensor", X)}, spp=4)
    ball = PlannedRenderer(scene, {"it": Translate("ball", X)}, spp=4)
    camera_image, expected = camera.render({"it": np.float32(0.5)}), ball.render({"it": np.float32(-0.5)})
    assert np.mean(np.abs(camera_image - expected)) < 0.01 * np.mean(
        np.abs(expected - ball.render({"it": np.float32(0.0)}))
    )


def test_the_blurred_gradient_of_a_light_matches_finite_differences() -> None:
    blur = {"sigma": 0.2, "pairs": 4}
    planned = PlannedRenderer(lit_scene(), {"light": Translate("lamp", X)}, spp=32, blur=blur, attached_lights=False)
    image, pullback = planned.render_vjp(planned.parameters())
    ramp = np.linspace(-1.0, 1.0, 64, dtype=np.float32)[None, :, None] * np.ones_like(image)
    draws = [float(planned.render_vjp(planned.parameters(), seed=seed)[1](ramp)["light"]) for seed in range(8)]
    plus, minus = (planned.render({"light": np.float32(by)}, seed=1) for by in (0.2, -0.2))
    slope = float(np.sum((plus - minus) * ramp)) / 0.4
    assert np.mean(draws) == pytest.approx(slope, rel=0.05, abs=3.0 * np.std(draws) / np.sqrt(8))
    assert float(pullback(ramp)["light"]) == pytest.approx(slope, rel=0.3)


@pytest.mark.parametrize(
    "light",
    ["lamp.position", *(pytest.param(Translate("lamp", *axis), marks=thorough) for axis in ((), (X,)))],
    ids=str,
)
def test_a_proxy_light_moves_with_its_delta_light(light: Any) -> None:
    ball = {"x": Translate("ball", X)}
    planned = PlannedRenderer(lit_scene(**LAMP_OUT_OF_VIEW), {**ball, "light": light}, spp=16, attached_lights=False)
    assert list(planned.plan.substitutions) == ["point light 'lamp'"]
    assert list(planned.plan.blurred) == ["light"]
    params = planned.parameters()
    params["light"] = params["light"] + np.float32(1.0)
    ramp = np.linspace(-1.0, 1.0, 64, dtype=np.float32)[None, :, None] * np.ones((48, 64, 3), np.float32)
    pulled = planned.unabridged.vjp(params, ramp)
    assert np.any(pulled["x"])
    assert not np.any(pulled["light"])
    proxy_pose = mi.traverse(planned.unabridged.proxy_scene)["lamp.to_world"]  # type: ignore[attr-defined]
    moved = [1.5, 12, 0] if isinstance(light, Translate) and light.axis is not None else [1.5, 13, 1]
    np.testing.assert_allclose(np.array(proxy_pose.matrix).reshape(4, 4)[:3, 3], moved, atol=1e-5)


def test_only_the_parameters_in_names_are_blurred() -> None:
    targets: dict[str, Any] = {"x": Translate("ball", X), "floor": FLOOR}
    planned = PlannedRenderer(shadow_scene(floor=lit_scene()["floor"]), targets, blur={"names": ["x"]}, spp=4)
    assert planned.plan.blurred == {"x": "`blur` names it"}
    assert planned.groups == (("floor",),)
    with pytest.raises(ParameterError, match=r"'lamp\.position' cannot be fitted"):
        PlannedRenderer(
            lit_scene(), {"light": "lamp.position", "floor": FLOOR}, blur={"names": ["floor"]}, attached_lights=False
        )


@pytest.mark.parametrize(
    ("blur", "error", "says"),
    [
        (
            {"width": 1},
            OptionError,
            "`blur` must be None, or a table of sigma, final_sigma, names, pairs, together, compare, got",
        ),
        (0.3, OptionError, r"`blur` must be None, or a table of .*, got 0\.3"),
        ({"sigma": 0}, OptionError, "`sigma` of 'light' must be a finite number, more than 0"),
        ({"sigma": {"floor": 1.0}}, OptionError, "`sigma` must have 'light', got 'floor'"),
        ({"names": ["place"]}, ParameterError, "`names` must be of light, got 'place'"),
    ],
)
def test_options_of_the_blur_are_checked(blur: Any, error: type[Exception], says: str) -> None:
    with pytest.raises(error, match=says):
        PlannedRenderer(lit_scene(), {"light": "lamp.position"}, blur=blur)


def test_a_plan_with_only_blurred_parameters_has_nothing_to_verify() -> None:
    lamp = {"light": Translate("lamp", X)}
    planned = PlannedRenderer(lit_scene(), lamp, spp=4, blur={"sigma": 0.3}, attached_lights=False)
    image = planned.render(planned.parameters())
    objective = PixelL2(planned.render({"light": np.float32(1.0)}, seed=9))
    planned = planned.start(planned.parameters(), objective.value_and_grad(image)[1])
    assert not planned.plan.frozen
    assert np.any(planned.render_vjp(planned.parameters())[1](np.ones_like(image))["light"])
    assert planned.effect_images(planned.parameters(), np.ones_like(image)) == {}
    with pytest.raises(OptionError, match="nothing to verify: 'light'"):
        planned.verify(objective)


def test_a_parameter_that_is_not_optimised_is_not_blurred() -> None:
    lights: dict[str, Any] = {"light": Translate("lamp", X), "floor": FLOOR}
    planned = PlannedRenderer(lit_scene(), lights, spp=4, blur={"sigma": {"light": 0.3}})
    image = planned.render(planned.parameters())
    planned = planned.start(planned.parameters(), np.ones_like(image), optimise=["floor"])
    pulled = planned.render_vjp(planned.parameters())[1](np.ones_like(image))
    assert not np.any(pulled["light"])
    assert np.any(pulled["floor"])
    assert not planned.plan.blurred


def test_a_mitsuba_renderer_can_be_wrapped_in_a_blurred_renderer() -> None:
    plain = MitsubaRenderer(lit_scene(), {"light": "lamp.position", "floor": FLOOR}, spp=4, without_gradient=["light"])
    image, pullback = plain.render_vjp(plain.parameters())
    assert not np.any(pullback(np.ones_like(image))["light"])
    blurred = BlurredRenderer(plain, 0.3, names=["light"])
    pulled = blurred.render_vjp(plain.parameters())[1](np.ones_like(image))
    assert np.any(pulled["light"])
    assert np.any(pulled["floor"])


def test_a_scene_file_sets_the_options_of_the_blur(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    light = '<emitter type="point" id="lamp"><point name="position" x="0" y="9" z="0"/></emitter></scene>'
    (tmp_path / "scene.xml").write_text(XML.replace("</scene>", light))
    text = SCENE.replace('"mitsuba"', '"mitsuba-planned"')
    text = text.replace("[renderer.parameters]", '[renderer.parameters]\nlight = "lamp.position"')
    renderer = MitsubaRenderer(tmp_path / "scene.xml", {"light": "lamp.position"}, spp=4, without_gradient=["light"])
    write_png(tmp_path / "target.png", encode_srgb(renderer.render(renderer.parameters())))
    scene = tmp_path / "scene.toml"
    scene.write_text(f"{text}\n[renderer.blur]\nsigma = 0.5\n")
    assert main(["fit", str(scene), "--explain", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["blurred"] == {}  # the light is not optimised
    scene.write_text(f"{text}\n[renderer.blur]\nsigma = 0.5\n[optimise.light]\n")
    assert main(["fit", str(scene), "--explain", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["attached"]) == ["light"]
    text = text.replace('"mitsuba-planned"', '"mitsuba-planned"\nattached_lights = false')
    scene.write_text(f"{text}\n[renderer.blur]\nsigma = 0.5\n[optimise.light]\n")
    assert main(["fit", str(scene), "--explain", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["blurred"]) == ["light"]
    scene.write_text(f"{text}\n[renderer.blur]\nsigma = 0\n")
    assert main(["fit", str(scene), "--explain"]) == 2
    assert "`sigma` of 'light' must be a finite number, more than 0" in capsys.readouterr().err
    scene.write_text(f"{text}\n[renderer.blur]\nsigm = 1\n")
    assert main(["fit", str(scene), "--explain"]) == 2
    assert "[renderer.blur] unknown key `sigm`; did you mean `sigma`?" in capsys.readouterr().err


def test_a_moving_instance_has_a_blurred_gradient() -> None:
    transform = mi.ScalarTransform4f
    group = {"type": "shapegroup", "within": {"type": "sphere", "radius": 0.7, "center": [0.0, 1.0, 0.0]}}
    instance = {
        "type": "instance",
        "to_world": transform().translate([0.3, 0.0, 0.0]),
        "of": {"type": "ref", "id": "group"},
    }
    scene = shadow_scene(group=group, copy=instance)
    moves: dict[str, Any] = {"x": Translate("copy", (1, 0, 0))}
    with pytest.raises(ParameterError, match="'copy' cannot be moved: it moves an instance of a shapegroup"):
        MitsubaRenderer(scene, moves)
    planned = PlannedRenderer(scene, moves, spp=16, blur={"sigma": 0.2})
    assert "instance" in planned.plan.blurred["x"]
    weight = np.linspace(-1.0, 1.0, WIDTH, dtype=np.float32)[None, :, None] * np.ones((HEIGHT, WIDTH, 3), np.float32)
    draws = []
    for seed in range(4):
        _, pullback = planned.render_vjp(planned.parameters(), seed=seed)
        draws.append(float(pullback(weight)["x"]))

    def weighted_sum(x: float) -> float:
        return float(np.sum(planned.render({"x": np.float32(x)}, seed=9) * weight))

    expected = (weighted_sum(0.2) - weighted_sum(-0.2)) / 0.4
    assert np.mean(draws) == pytest.approx(expected, rel=0.3)

"""The gradient by lights that move: exact, with little noise, and left to others where their light is not seen."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_core import Free, LOIObjective, fit
from loi_core.errors import OptionError
from loi_mitsuba import MitsubaRenderer, PlannedRenderer, Rotate, Scale, Translate, plan_effects
from loi_mitsuba.attached.emitters import AttachedEmitters, attachable_emitters
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.strategies import thorough

X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
EMITS = {"type": "area", "radiance": {"type": "rgb", "value": [40.0, 36.0, 30.0]}}
GLOSSY = {"type": "roughconductor", "alpha": 0.2}
RAMP = np.linspace(-1.0, 1.0, WIDTH, dtype=np.float32)[None, :, None] * np.ones((HEIGHT, WIDTH, 3), np.float32)


def lamp(kind: str) -> dict[str, Any]:
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
    }[kind]


def lit_scene(kind: str, **changes: Any) -> dict[str, Any]:
    """Two balls on a floor, one of them shining, and their shadows."""
    return shadow_scene(
        ball={"type": "sphere", "center": [-1, 1.2, 0], "radius": 0.9},
        other={"type": "sphere", "center": [1.5, 0.8, 1], "radius": 0.8, "bsdf": GLOSSY},
        lamp=lamp(kind),
        integrator={"type": "direct"},
        **changes,
    )


def differences(renderer: MitsubaRenderer, at: dict[str, Any], steps: dict[str, float]) -> tuple[Host, Host]:
    """Central differences of what RAMP makes of the image, by parameter, and their standard errors."""
    drawn = []
    for seed in range(4):
        slopes = []
        for name, step in steps.items():
            ahead, behind = (
                renderer.render({**at, name: at[name] + np.float32(by)}, seed=seed) for by in (step, -step)
            )
            slopes.append(float(np.sum((ahead.astype(np.float64) - behind) * RAMP)) / (2.0 * step))
        drawn.append(slopes)
    return np.mean(drawn, axis=0), np.std(drawn, axis=0, ddof=1) / 2.0


@pytest.mark.filterwarnings("ignore:mesh 'lamp' stores the vertices:loi_mitsuba.GradientWarning")
@pytest.mark.parametrize(
    "kind",
    [
        "ball",
        "point",
        pytest.param("panel", marks=thorough),
        pytest.param("box", marks=thorough),
        pytest.param("spot", marks=thorough),
    ],
)
def test_it_is_that_of_finite_differences(kind: str) -> None:
    """Brightness, highlights and shadows alike."""
    handles: dict[str, Any] = {"x": Translate("lamp", X), "y": Translate("lamp", Y), "z": Translate("lamp", Z)}
    at: dict[str, Any] = {"x": np.float32(1.5), "y": np.float32(0.0), "z": np.float32(-1.0)}
    steps = {"x": 0.1, "y": 0.1, "z": 0.1}
    if kind != "point":
        handles["turn"], at["turn"], steps["turn"] = Rotate("lamp", Z), np.float32(10.0), 2.0
    if kind in ("ball", "panel"):
        handles["size"], at["size"], steps["size"] = Scale("lamp"), np.float32(1.2), 0.05
    images = tuple(handles) if kind in ("point", "spot") else ()
    renderer = MitsubaRenderer(lit_scene(kind), handles, spp=128, without_gradient=images)
    lamps = AttachedEmitters(renderer, attachable_emitters(renderer.names, renderer.targets), 32)
    drawn = [list(lamps.vjp(at, RAMP, names=handles, seed=seed).values()) for seed in range(6)]
    mean, error = np.mean(drawn, axis=0), np.std(drawn, axis=0, ddof=1) / np.sqrt(6)
    wanted, unsure = differences(renderer, at, steps)
    rounding = 32.0 * np.finfo(np.float32).eps * np.max(np.abs(wanted))  # all that is there where a ball turns
    bound = 0.02 * np.abs(wanted) + 4.0 * np.hypot(error, unsure) + rounding
    np.testing.assert_array_less(np.abs(mean - wanted), bound)


@pytest.mark.parametrize("changes", [{"half": 400.0}, {"glow": 0.05}], ids=["wide floor", "glowing floor"])
def test_the_floor_may_be_wide_and_may_shine_itself(changes: dict[str, float]) -> None:
    scene = lit_scene("point")
    scene["floor"]["to_world"] = mi.ScalarTransform4f().rotate(X, -90).scale(changes.get("half", 8.0))
    if "glow" in changes:
        scene["floor"]["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": changes["glow"]}}
    handles: dict[str, Any] = {"x": Translate("lamp", X), "y": Translate("lamp", Y)}
    at: dict[str, Any] = {"x": np.float32(1.5), "y": np.float32(0.0)}
    renderer = MitsubaRenderer(scene, handles, spp=64, without_gradient=tuple(handles))
    lamps = AttachedEmitters(renderer, attachable_emitters(renderer.names, renderer.targets), 32)
    drawn = [list(lamps.vjp(at, RAMP, names=handles, seed=seed).values()) for seed in range(6)]
    mean, error = np.mean(drawn, axis=0), np.std(drawn, axis=0, ddof=1) / np.sqrt(6)
    wanted, unsure = differences(renderer, at, {"x": 0.1, "y": 0.1})
    np.testing.assert_array_less(np.abs(mean - wanted), 0.02 * np.abs(wanted) + 4.0 * np.hypot(error, unsure))


def test_its_noise_is_less_than_a_fiftieth_of_mitsubas_own() -> None:
    place = {"place": Translate("lamp")}
    renderer = MitsubaRenderer(lit_scene("ball"), place, spp=16)
    lamps, at = (
        AttachedEmitters(renderer, attachable_emitters(renderer.names, renderer.targets), 16),
        renderer.parameters(),
    )
    ours = [lamps.vjp(at, RAMP, names=place, seed=seed)["place"] for seed in range(6)]
    own = [renderer.vjp(at, RAMP, seed=seed)["place"] for seed in range(6)]
    assert np.linalg.norm(np.std(ours, axis=0)) < 0.02 * np.linalg.norm(np.std(own, axis=0))


def test_a_lamp_in_view_has_its_outline_too() -> None:
    low = {"type": "sphere", "center": [0, 2.5, 0], "radius": 0.5, "emitter": EMITS}
    scene = lit_scene("ball")
    scene["lamp"] = low
    place = {"x": Translate("lamp", X)}
    renderer = MitsubaRenderer(scene, place, spp=128)
    lamps, at = (
        AttachedEmitters(renderer, attachable_emitters(renderer.names, renderer.targets), 32),
        renderer.parameters(),
    )
    drawn = [float(lamps.vjp(at, RAMP, names=place, seed=seed)["x"]) for seed in range(8)]
    wanted, unsure = differences(renderer, at, {"x": 0.1})
    error = np.hypot(np.std(drawn, ddof=1) / np.sqrt(8), unsure[0])
    assert np.mean(drawn) == pytest.approx(wanted[0], rel=0.03, abs=4.0 * error)


@thorough
def test_a_lamp_that_comes_into_view_has_its_outline_there() -> None:
    """The film samples beyond its border, for which the scene is loaded twice: the lamp is that of the scene in use."""
    scene = lit_scene("ball")
    scene["sensor"]["film"]["rfilter"] = {"type": "tent"}
    planned = PlannedRenderer(scene, {"x": Translate("lamp", X), "y": Translate("lamp", Y)}, spp=32)
    planned.begin(planned.parameters(), RAMP, optimise=["x", "y"])
    assert list(planned.plan.followed) == ["x", "y"]
    at: dict[str, Any] = {"x": np.float32(0.0), "y": np.float32(-4.5)}
    drawn = [float(planned.render_vjp(at, seed=seed)[1](RAMP)["x"]) for seed in range(8)]
    wanted, unsure = differences(planned.unabridged.with_integrator("scene", spp=128), at, {"x": 0.1})
    error = np.hypot(np.std(drawn, ddof=1) / np.sqrt(8), unsure[0])
    assert np.mean(drawn) == pytest.approx(wanted[0], rel=0.03, abs=4.0 * error)


@pytest.mark.parametrize("light", ["lamp.position", pytest.param(Translate("lamp"), marks=thorough)], ids=str)
@pytest.mark.parametrize("blur", [{}, pytest.param(None, marks=thorough)], ids=["blur", "no blur"])
def test_a_fit_finds_a_point_light(light: Any, blur: dict[str, Any] | None) -> None:
    """Within 0.05 of a way of 2.7; what the ball hides tells of it as well."""
    scene = lit_scene("point")
    scene["sensor"]["film"] |= {"width": 32, "height": 24}
    planned = PlannedRenderer(scene, {"light": light}, spp=16, blur=blur)
    start = planned.parameters()["light"]
    truth = start + np.array([2.0, 1.0, -1.5], np.float32)
    found = fit(planned, LOIObjective(planned.render({"light": truth}, seed=10**6)), steps=80)
    assert list(planned.plan.followed) == ["light"]
    assert not planned.plan.blurred
    np.testing.assert_allclose(found.best_params["light"], truth, atol=0.05)


def begun(scene: dict[str, Any], targets: dict[str, Any], **options: Any) -> PlannedRenderer:
    """A renderer that has looked at a gradient."""
    planned = PlannedRenderer(scene, targets, **options)
    planned.begin(planned.parameters(), RAMP, optimise=targets)
    return planned


def test_a_light_that_shines_where_nobody_looks_is_left_to_others() -> None:
    """A lid hides all of the lamp's direct light: its own outline tells nothing either, and it is held."""
    lid = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 6, 0]).scale([9, 0.1, 9])}
    for kind, otherwise in (("ball", "held"), ("point", "blurred")):
        plan = begun(lit_scene(kind, lid=lid), {"x": Translate("lamp", X)}, spp=4).plan
        assert not plan.followed
        assert list(getattr(plan, otherwise)) == ["x"]
    both: dict[str, Any] = {"x": Translate("lamp", X), "ball": Translate("ball", X)}
    plan = begun(lit_scene("point", lid=lid), both, spp=4, blur={"names": ["ball"]}).plan  # there are no others
    assert list(plan.followed) == ["x"]


def test_a_lamp_that_a_mirror_shows_keeps_the_gradient_of_all_its_light() -> None:
    """The floor is a mirror, and its reflection carries nearly all that is known of the glowing ball above it."""
    place = mi.ScalarTransform4f
    mirror = {"type": "rectangle", "to_world": place().translate([0, 0, -1]).scale(8), "bsdf": {"type": "conductor"}}
    glows = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    scene = shadow_scene(
        floor=mirror,
        ball={"type": "sphere", "center": [0, -4.5, 2], "radius": 0.8, "emitter": glows},
        grey={"type": "sphere", "center": [2.5, 0, 0], "radius": 0.8},
        lamp={"type": "constant", "radiance": 0.1},
        integrator={"type": "path", "max_depth": 3},
    )
    planned = begun(scene, {"x": Translate("ball", X)}, spp=16)
    assert not planned.plan.followed
    assert not planned.plan.held
    assert not planned.plan.blurred


@thorough
def test_each_parameter_has_the_gradient_that_is_best_for_it() -> None:
    """A ball that moves has Mitsuba's, the lamp above it that of its light; and the scene is left as it was."""
    both = {"lamp": Translate("lamp", X), "ball": Translate("ball", X)}
    planned = PlannedRenderer(lit_scene("ball"), both, spp=16)
    start = planned.parameters()
    image, pullback = planned.render_vjp(start)
    first = pullback(RAMP)
    assert list(planned.plan.followed) == ["lamp"]
    (row,) = (line for line in str(planned.plan).splitlines() if line.startswith("| 'lamp'"))
    assert "it moves a lamp, and samples of its direct light move with it" in row
    assert planned.groups == (("ball",),)
    assert np.all(first["ball"])
    np.testing.assert_allclose(pullback(RAMP)["lamp"], first["lamp"], rtol=1e-4)
    np.testing.assert_array_equal(planned.render(start), image)
    alone = planned.begin(start, RAMP, optimise=["ball"])
    assert not alone.followed
    assert not np.any(planned.render_vjp(start)[1](RAMP)["lamp"])


@pytest.mark.filterwarnings("ignore:mesh 'lamp' stores the vertices:loi_mitsuba.GradientWarning")
def test_what_scales_a_mesh_is_left_to_mitsuba() -> None:
    """Whose samples are as many to the area as before."""
    for kind, wrt in (("box", ["x"]), ("panel", ["x", "size"])):
        renderer = MitsubaRenderer(lit_scene(kind), {"x": Translate("lamp", X), "size": Scale("lamp")}, spp=4)
        assert list(attachable_emitters(renderer.names, renderer.targets)) == wrt


def test_it_can_be_turned_off() -> None:
    light: dict[str, Any] = {"x": Translate("lamp", X)}
    assert list(begun(lit_scene("point"), light, spp=4, attached_lights=False).plan.blurred) == ["x"]
    assert not begun(lit_scene("ball"), light, spp=4, attached_lights=False).plan.followed
    assert not plan_effects(lit_scene("point"), light, attached_lights=False).followed
    assert list(PlannedRenderer(lit_scene("point"), light, blur={"names": ["x"]}).plan.blurred) == ["x"]
    with pytest.raises(OptionError, match="`attached_lights` must be true or false, got 1"):
        PlannedRenderer(lit_scene("point"), light, attached_lights=1)  # type: ignore[arg-type]


@thorough
def test_a_fit_ends_where_the_light_is_among_other_unknowns() -> None:
    """The floor's colour, the place of a ball, and of the lamp above both."""
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
    found = fit(
        planned,
        LOIObjective(target),
        steps=100,
        optimise={"lamp": Free(None, -5, 5), "ball": Free(None, -5, 5), "floor": Free(None, 0.0, 1.0)},
    )
    assert list(planned.plan.followed) == ["lamp"]
    for name, value in truth.items():
        np.testing.assert_allclose(found.best_params[name], value, atol=0.1)

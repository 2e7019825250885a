"""Gradients that Mitsuba does not have are taken from a neighbouring scene; images never are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_core import PixelL2
from loi_core.errors import OptionError, ParameterError
from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, ProxySettings, Translate, list_parameters
from loi_mitsuba.proxy.light_size import LightContext
from loi_mitsuba.proxy.scene import build_proxy_scene
from tests.mitsuba.scenes import shadow_scene
from tests.strategies import thorough

AXES: dict[str, Any] = {"x": Translate("ball", (1, 0, 0)), "z": Translate("ball", (0, 0, 1))}
HERE = {"x": np.float32(0.0), "z": np.float32(0.0)}
RAMP = np.linspace(-1.0, 1.0, 64, dtype=np.float32)[None, :, None] * np.ones((48, 64, 3), np.float32)
LIGHTS: dict[str, dict[str, Any]] = {
    "point": {"type": "point", "position": [0.5, 12.0, 0.0], "intensity": 150.0},
    "point placed": {"type": "point", "intensity": {"type": "rgb", "value": [150.0, 120.0, 90.0]}},
    "spot": {"type": "spot", "cutoff_angle": 10.0, "beam_width": 3.0, "intensity": 150.0},
    "directional": {"type": "directional", "direction": [0.1, -1.0, 0.0], "irradiance": 2.0},
    "directional placed": {"type": "directional", "irradiance": {"type": "rgb", "value": [2.0, 1.0, 0.5]}},
}


def lit_scene(kind: str = "point", **changes: Any) -> dict[str, Any]:
    """The scene of a shadow, under a light without a size."""
    light = dict(LIGHTS[kind])
    if kind in ("point placed", "spot", "directional placed"):
        light["to_world"] = mi.ScalarTransform4f().look_at([0.5, 12.0, 0.0], [0.0, 5.0, 0.0], [0, 0, 1])
    return shadow_scene(**{"lamp": light, "integrator": {"type": "path", "max_depth": 2}, **changes})


def xml_of(folder: Path) -> Path:
    """The same as a file, in which nothing has a name but the ball."""
    path = folder / "scene.xml"
    path.write_text("""<scene version="3.0.0">
        <integrator type="path"><integer name="max_depth" value="2"/></integrator>
        <sensor type="perspective">
            <float name="fov" value="45"/>
            <transform name="to_world"><lookat origin="0,6,6" target="0,0,0" up="0,1,0"/></transform>
            <film type="hdrfilm">
                <integer name="width" value="64"/><integer name="height" value="48"/><rfilter type="box"/>
            </film>
        </sensor>
        <shape type="rectangle">
            <transform name="to_world"><scale value="8"/><rotate x="1" angle="-90"/></transform>
        </shape>
        <shape type="sphere" id="ball">
            <point name="center" x="0" y="5" z="0"/><float name="radius" value="0.4"/>
        </shape>
        <emitter type="point">
            <point name="position" x="0.5" y="12" z="0"/><rgb name="intensity" value="150"/>
        </emitter>
    </scene>""")
    return path


def ball_of(scene: Any) -> Any:
    (ball,) = (one for one in scene.shapes() if one.id() == "ball")
    return ball


@pytest.mark.parametrize("kind", LIGHTS)
def test_what_stands_for_a_light_is_as_bright(kind: str) -> None:
    scene = lit_scene(kind)
    loaded = mi.load_dict(scene)
    around = LightContext.of(loaded, [ball_of(loaded)])
    found = build_proxy_scene(scene, ProxySettings(lights=0.02), around, lambda _: False)
    assert found is not None
    assert [one.what for one in found.exchanges] == [f"{kind.split()[0]} light 'lamp'"]
    own, near = (mi.render(one, spp=256, seed=1).numpy() for one in (loaded, found.loaded.scene))
    of_own, of_near = (one.reshape(6, 8, 8, 8, -1).mean(axis=(1, 3)) for one in (own, near))
    # Of a directional light, a disk's rays are not quite parallel; and the shadow is a little soft.
    np.testing.assert_allclose(near.mean(axis=(0, 1)), own.mean(axis=(0, 1)), rtol=0.02)
    np.testing.assert_allclose(of_near, of_own, rtol=0.02, atol=0.02 * float(own.max()))


def test_a_lamp_stays_within_a_shade_and_not_below_a_ceiling() -> None:
    """What is outside of the light's cone is in the dark, and a lamp that pokes through the shade would light it."""
    light, black = [2.5, 4.9, 0.5], {"type": "twosided", "nested": {"type": "diffuse"}}
    above = mi.ScalarTransform4f().translate([0, 4.95, 0]).rotate([1, 0, 0], 90).scale(9)
    shade = {"type": "cylinder", "p0": [2.5, 4.5, 0.5], "p1": [2.5, 5.0, 0.5], "radius": 0.1, "bsdf": black}
    ceiling = {"type": "rectangle", "to_world": above, "bsdf": black}
    reasons = []
    for around in (shade, ceiling):
        lamp = {"type": "point", "position": light, "intensity": 20.0}
        ball = {"type": "sphere", "center": [0, 1.2, 0], "radius": 0.7}
        planned = PlannedRenderer(
            shadow_scene(ball=ball, around=around, lamp=lamp), {"x": Translate("ball", (1, 0, 0))}
        )
        (reason,) = planned.plan.exchanged.values()
        reasons.append("less to stay within what is around it" in reason)
    assert reasons == [True, False]


@pytest.mark.parametrize("kind", ["point", "spot", pytest.param("directional", marks=thorough)])
def test_shadows_of_lights_without_a_size_have_the_gradient_of_finite_differences(kind: str) -> None:
    scene = lit_scene(kind)
    planned = PlannedRenderer(scene, AXES, spp=64)
    exact = planned.unabridged.with_integrator("scene", spp=512)
    drawn = [planned.unabridged.vjp(HERE, RAMP, seed=seed) for seed in range(8)]
    slopes, errors, found = np.zeros(2), np.zeros(2), np.zeros(2)
    for k, name in enumerate(AXES):
        ahead, behind = (exact.render({**HERE, name: np.float32(by)}, seed=1) for by in (0.1, -0.1))
        slopes[k] = float(np.sum((ahead - behind) * RAMP)) / 0.2
        values = np.array([float(one[name]) for one in drawn])
        found[k], errors[k] = values.mean(), values.std(ddof=1) / np.sqrt(len(values))
    size, error = float(np.linalg.norm(slopes)), float(np.linalg.norm(errors))
    assert np.linalg.norm(found - slopes) < 0.1 * size + 3.0 * error
    assert error < 0.1 * size


@pytest.mark.filterwarnings("ignore::loi_mitsuba.GradientWarning")
@pytest.mark.parametrize("kind", ["point", "directional"])
def test_all_but_shadows_is_the_scene_s_own_under_lights_without_a_size(kind: str) -> None:
    scene = lit_scene(kind, ball={"type": "sphere", "center": [0, 1, 0], "radius": 0.6})
    without_shadows = {"type": "direct_projective", "guiding": "none", "sppc": 8, "sppp": 8, "sppi": 0}
    planned = PlannedRenderer(scene, AXES).unabridged.with_integrator(without_shadows)
    own = MitsubaRenderer(scene, AXES, integrator=without_shadows)
    found, wanted = (one.vjp(HERE, RAMP, seed=2) for one in (planned, own))
    assert all(wanted.values())
    for name, value in wanted.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-4)


def test_the_shadow_of_something_small_has_a_gradient_that_pixels_see() -> None:
    """A lamp much larger than what casts the shadow would leave no umbra, and of the gradient of pixels a twentieth."""
    planned = PlannedRenderer(lit_scene(ball={"type": "sphere", "center": [0, 5, 0], "radius": 0.12}), AXES, spp=64)
    (reason,) = planned.plan.exchanged.values()
    assert "a sphere of radius 0.24, 2 times that of what moves" in reason
    exact = planned.unabridged.with_integrator("scene", spp=512)
    objective = PixelL2(exact.render(HERE, seed=10**6))
    beside = {**HERE, "x": HERE["x"] + np.float32(0.1)}
    drawn = []
    for seed in range(8):
        cotangent = objective.value_and_grad(planned.render(beside, seed=seed))[1]
        drawn.append(float(planned.unabridged.vjp(beside, cotangent, seed=seed)["x"]))
    ahead, behind = (
        float(objective.value(exact.render({**HERE, "x": HERE["x"] + np.float32(by)}, seed=1))) for by in (0.15, 0.05)
    )
    assert np.mean(drawn) > 0.5 * (ahead - behind) / 0.1 > 0.0


def test_the_image_is_that_of_the_scene_as_it_is() -> None:
    planned = PlannedRenderer(lit_scene(), AXES, spp=16)
    with pytest.warns(GradientWarning, match="moves under a PointLight"):
        alone = PlannedRenderer(lit_scene(), AXES, spp=16, proxy=None)
    image, pullback = planned.render_vjp(HERE, seed=3)
    np.testing.assert_allclose(image, alone.render(HERE, seed=3), rtol=1e-5, atol=1e-6)
    pullback(np.ones_like(image))
    np.testing.assert_allclose(planned.render(HERE, seed=3), image, rtol=1e-2, atol=1e-2)


def test_the_plan_says_what_was_exchanged_and_what_for() -> None:
    plan = PlannedRenderer(lit_scene(), AXES).plan
    (reason,) = plan.exchanged.values()
    assert list(plan.exchanged) == ["point light 'lamp'"]
    assert "a sphere of radius 0.66, 0.1 of its distance from what moves" in reason
    assert "| point light 'lamp'" in str(plan)
    assert "exchanged" in str(plan)


def test_nothing_is_exchanged_that_no_parameter_calls_for() -> None:
    light = {"brightness": "lamp.intensity.value"}
    assert not PlannedRenderer(lit_scene(), light).plan.exchanged
    assert not PlannedRenderer(shadow_scene(), AXES).plan.exchanged
    with pytest.warns(GradientWarning, match="moves under a PointLight"):
        assert not PlannedRenderer(lit_scene(), AXES, proxy={"lights": 0.0}).plan.exchanged
    with pytest.warns(GradientWarning, match="moves under a PointLight"):
        alone = PlannedRenderer(lit_scene(), AXES, proxy=None)
    gradient = alone.unabridged.vjp(HERE, np.ones((48, 64, 3), np.float32))
    assert not np.any(gradient["x"])


@pytest.mark.parametrize(
    "light",
    [
        {"type": "point", "position": [0, 9, 0], "intensity": {"type": "blackbody", "temperature": 5000.0}},
        {"type": "point", "position": [0, 1, 0], "intensity": 20.0},  # in view, where a lamp would be seen
        {"type": "spot", "to_world": ("look_at", [5, 9, 0], [9, 9, 0], [0, 0, 1]), "cutoff_angle": 10.0},  # looks away
        {"type": "projector"},
    ],
    ids=["a spectrum that cannot be scaled", "in view", "looks away", "of another kind"],
)
def test_a_light_that_nothing_can_stand_for_stays_and_is_told_of(light: dict[str, Any]) -> None:
    if isinstance(light.get("to_world"), tuple):
        light = {**light, "to_world": mi.ScalarTransform4f().look_at(*light["to_world"][1:])}
    if light["type"] == "projector":
        light = {**light, "irradiance": {"type": "bitmap", "data": mi.TensorXf(np.ones((4, 4, 3))), "raw": True}}
    with pytest.warns(GradientWarning, match="moves under"):
        plan = PlannedRenderer(lit_scene(other=light), AXES).plan
    assert list(plan.exchanged) == ["point light 'lamp'"]


def test_lights_that_share_a_spectrum_keep_it() -> None:
    shared = mi.load_dict({"type": "uniform", "value": 100.0})
    lamps = {
        name: {"type": "point", "position": [x, 12.0, 0.0], "intensity": shared}
        for name, x in (("lamp", 1.0), ("other", -1.0))
    }
    scene = shadow_scene(**lamps, integrator={"type": "path", "max_depth": 2})
    wanted = np.mean(mi.render(mi.load_dict(scene), spp=64).numpy())
    planned = PlannedRenderer(scene, AXES, spp=64)
    assert list(planned.plan.exchanged) == ["point light 'lamp'", "point light 'other'"]
    assert np.mean(planned.render(HERE)) == pytest.approx(wanted, rel=1e-3)
    near = mi.render(planned.unabridged.proxy_scene, spp=64).numpy()  # type: ignore[attr-defined]
    assert np.mean(near) == pytest.approx(wanted, rel=0.02)


def test_parameters_of_lights_mean_the_same_ones_in_the_neighbour(tmp_path: Path) -> None:
    """The second of three lights without names looks away, and so stays what it is."""
    path = xml_of(tmp_path)
    text = path.read_text()
    away = '<transform name="to_world"><lookat origin="5,9,0" target="9,9,0" up="0,0,1"/></transform>'
    spots = f'<emitter type="spot">{away}<rgb name="intensity" value="7"/></emitter>'
    spots += '<emitter type="point"><point name="position" x="2" y="12" z="0"/></emitter></scene>'
    path.write_text(text.replace("</scene>", spots))
    powers = {f"{kind}_{k}": f"{kind}_{k}.intensity.value" for kind, k in (("point_light", 0), ("point_light", 1))}
    powers["spot"] = "spot_light_0.intensity.value"
    for scene in (path, mi.load_file(str(path))):
        with pytest.warns(GradientWarning, match="moves under a SpotLight"):
            planned = PlannedRenderer(scene, {**AXES, **powers}, spp=16)
        assert list(planned.plan.exchanged) == ["point light (1)", "point light (2)"]
        planned.unabridged.vjp({**planned.parameters(), "spot": np.full(3, 9.0, np.float32)}, RAMP)
        near = mi.traverse(planned.unabridged.proxy_scene)  # type: ignore[attr-defined]
        (spot,) = (key for key in near.properties if key.endswith(".intensity.value"))
        np.testing.assert_allclose(np.array(near[spot]).reshape(-1), 9.0)
        bright = [np.array(near[f"loi_lamp_{k}.emitter.radiance.value"]).reshape(-1)[0] for k in (0, 2)]
        assert bright[0] > 100.0 * bright[1]


def test_what_its_stand_in_has_no_entry_for_is_not_exchanged() -> None:
    spot = lit_scene("spot")
    with pytest.warns(GradientWarning, match="moves under a SpotLight"):
        plan = PlannedRenderer(spot, {**AXES, "cone": "lamp.texture.value"}).plan
    assert not plan.exchanged
    mirror = {"type": "rectangle", "bsdf": {"type": "conductor"}}
    planned = PlannedRenderer(lit_scene(mirror=mirror), {**AXES, "gloss": "mirror.bsdf.specular_reflectance.value"})
    assert list(planned.plan.exchanged) == ["point light 'lamp'"]
    assert any("perfect mirror" in note for note in planned.plan.notes)


def test_scenes_of_instances_do_without_a_neighbour_once_they_are_loaded() -> None:
    group = {"type": "shapegroup", "inner": {"type": "sphere", "radius": 0.2}}
    scene = lit_scene(group=group, one={"type": "instance", "shapegroup": {"type": "ref", "id": "group"}})
    assert PlannedRenderer(scene, AXES).plan.exchanged
    with pytest.warns(GradientWarning, match="moves under a PointLight"):
        assert not PlannedRenderer(mi.load_dict(scene), AXES).plan.exchanged


def test_files_and_loaded_scenes_have_neighbours_too(tmp_path: Path) -> None:
    path = xml_of(tmp_path)
    loaded = mi.load_file(str(path))
    before = [one.id() for one in loaded.shapes()]
    names = list(list_parameters(loaded))
    gradients = []
    for scene in (path, loaded, lit_scene()):
        planned = PlannedRenderer(scene, AXES, spp=128)
        assert len(planned.plan.exchanged) == 1
        gradients.append(np.mean([planned.unabridged.vjp(HERE, RAMP, seed=k)["x"] for k in range(3)]))
    assert gradients[0] == pytest.approx(gradients[1], rel=0.15)
    assert np.sign(gradients[0]) == np.sign(gradients[2])
    assert [one.id() for one in loaded.shapes()] == before
    assert list(list_parameters(loaded)) == names


def test_what_does_not_move_has_the_gradient_of_the_scene_itself() -> None:
    both = {**AXES, "brightness": "lamp.intensity.value"}
    planned = PlannedRenderer(lit_scene("point placed"), both, spp=64)
    params: dict[str, Any] = {**HERE, "brightness": np.array([300.0, 120.0, 90.0], np.float32)}
    cotangent = np.ones((48, 64, 3), np.float32)
    pulled = planned.unabridged.vjp(params, cotangent)
    image = planned.unabridged.with_integrator("scene", spp=64).render(params)
    # The image is proportional to the light.
    np.testing.assert_allclose(pulled["brightness"] * params["brightness"], image.sum(axis=(0, 1)), rtol=0.05)
    lamps = mi.traverse(planned.unabridged.proxy_scene)  # type: ignore[attr-defined]
    radius = 0.1 * float(np.linalg.norm([0.1, 6.6, 0.0]))  # to the box around the ball
    radiance = np.array(lamps["loi_lamp_0.emitter.radiance.value"], dtype=np.float64).reshape(-1)
    np.testing.assert_allclose(radiance * np.pi * radius**2, params["brightness"], rtol=1e-3)


def test_a_light_of_a_spectrum_stays_as_it_is_and_a_warning_tells(recwarn: pytest.WarningsRecorder) -> None:
    mi.set_variant("llvm_ad_spectral")
    planned = PlannedRenderer(lit_scene("point placed"), AXES)
    assert any("a shape moves under a PointLight" in str(one.message) for one in recwarn)
    assert not planned.plan.exchanged
    image, pullback = planned.render_vjp(planned.parameters())
    assert np.all(np.isfinite(pullback(np.ones_like(image))["x"]))


def test_edges_in_perfect_mirrors_have_the_gradient_of_finite_differences() -> None:
    place = mi.ScalarTransform4f
    mirror = {"type": "rectangle", "to_world": place().translate([0, 0, -1]).scale(8), "bsdf": {"type": "conductor"}}
    glow = {"type": "area", "radiance": 1.0}
    ball = {"type": "sphere", "center": [0, -4.5, 2], "radius": 0.8, "emitter": glow}
    sky = {"type": "constant", "radiance": 0.1}
    scene = shadow_scene(floor=mirror, ball=ball, lamp=sky, integrator={"type": "path", "max_depth": 3})
    planned = PlannedRenderer(scene, AXES, spp=64)
    assert list(planned.plan.exchanged) == ["conductor 'bsdf'"]
    assert not any("perfect mirror" in note for note in planned.plan.notes)
    exact = planned.unabridged.with_integrator("scene", spp=256)
    ahead, behind = (exact.render({**HERE, "x": np.float32(by)}, seed=1) for by in (0.1, -0.1))
    slope = float(np.sum((ahead - behind) * RAMP)) / 0.2
    found = np.array([float(planned.unabridged.vjp(HERE, RAMP, seed=seed)["x"]) for seed in range(6)])
    assert found.mean() == pytest.approx(slope, rel=0.1, abs=3.0 * found.std(ddof=1) / np.sqrt(len(found)))


def test_textures_of_8_bits_are_read_as_floats_where_they_are_fitted(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    mi.util.write_bitmap(str(tmp_path / "floor.png"), mi.Bitmap(picture), write_async=False)
    scene = lit_scene()
    scene["floor"]["bsdf"]["reflectance"] = {"type": "bitmap", "filename": str(tmp_path / "floor.png")}
    colours = {"picture": "floor.bsdf.reflectance.data"}
    without = MitsubaRenderer(scene, {"brightness": "lamp.intensity.value"}, spp=64)
    for renderer in (MitsubaRenderer(scene, colours, spp=64), PlannedRenderer(scene, {**AXES, **colours}, spp=64)):
        start = renderer.parameters()
        assert start["picture"].shape == (6, 8, 3)
        image, pullback = renderer.render_vjp(start)
        np.testing.assert_allclose(np.mean(image), np.mean(without.render(without.parameters())), rtol=2e-3)
        assert np.any(pullback(np.ones_like(image))["picture"])
    with pytest.raises(ParameterError, match=r"an 8-bit texture, .*load the bitmap with format='variant'"):
        MitsubaRenderer(mi.load_dict(scene), colours)


def test_a_scene_s_dict_can_be_loaded_again_with_its_tensors() -> None:
    picture = mi.TensorXf(np.full((4, 4, 3), 0.5, np.float32))
    scene = lit_scene()
    scene["floor"]["bsdf"]["reflectance"] = {"type": "bitmap", "data": picture, "raw": True}
    for _ in range(2):
        assert PlannedRenderer(scene, AXES).plan.exchanged
        MitsubaRenderer(scene, {"colour": "floor.bsdf.reflectance.data"})


@pytest.mark.parametrize(
    ("proxy", "says"),
    [
        ({"lights": 0.6}, r"`proxy\.lights` must be 0 to 0\.5, got 0\.6"),
        ({"mirrors": float("nan")}, r"`proxy\.mirrors` must be 0 to 0\.5, got nan"),
        ({"mirrors": "rough"}, r"`proxy\.mirrors` must be 0 to 0\.5, got 'rough'"),
        ({"lamps": 0.1}, r"`proxy` must be a ProxySettings, None, or a table of lights, mirrors, seams, textures, got"),
        (0.1, r"`proxy` must be a ProxySettings, None, or a table of lights, mirrors, seams, textures, got 0\.1"),
    ],
)
def test_settings_of_a_neighbour_are_checked(proxy: Any, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        PlannedRenderer(lit_scene(), AXES, proxy=proxy)

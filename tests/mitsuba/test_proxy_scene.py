"""Gradients that Mitsuba lacks come from a proxy scene; images never do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_core import PixelL2
from loi_core.errors import OptionError, ParameterError
from loi_mitsuba import MitsubaRenderer, PlannedRenderer, ProxySettings, Translate, list_parameters
from mitsuba_boundaries import differentiable_scene
from tests.mitsuba.scenes import shadow_scene
from tests.strategies import thorough

AXES: dict[str, Any] = {"x": Translate("ball", (1, 0, 0)), "z": Translate("ball", (0, 0, 1))}
ORIGIN = {"x": np.float32(0.0), "z": np.float32(0.0)}
RAMP = np.linspace(-1.0, 1.0, 64, dtype=np.float32)[None, :, None] * np.ones((48, 64, 3), np.float32)
LIGHTS: dict[str, dict[str, Any]] = {
    "point": {"type": "point", "position": [0.5, 12.0, 0.0], "intensity": 150.0},
    "point placed": {"type": "point", "intensity": {"type": "rgb", "value": [150.0, 120.0, 90.0]}},
    "spot": {"type": "spot", "cutoff_angle": 10.0, "beam_width": 3.0, "intensity": 150.0},
    "directional": {"type": "directional", "direction": [0.1, -1.0, 0.0], "irradiance": 2.0},
    "directional placed": {"type": "directional", "irradiance": {"type": "rgb", "value": [2.0, 1.0, 0.5]}},
}


def lit_scene(light: str = "point", **changes: Any) -> dict[str, Any]:
    """Return the scene of a shadow under a delta light."""
    description = dict(LIGHTS[light])
    if light in ("point placed", "spot", "directional placed"):
        description["to_world"] = mi.ScalarTransform4f().look_at([0.5, 12.0, 0.0], [0.0, 5.0, 0.0], [0, 0, 1])
    return shadow_scene(**{"lamp": description, "integrator": {"type": "path", "max_depth": 2}, **changes})


def xml_of(folder: Path) -> Path:
    """Write the same scene as a file where only the ball has an id."""
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
    (ball,) = (shape for shape in scene.shapes() if shape.id() == "ball")
    return ball


@pytest.mark.parametrize("light", LIGHTS)
def test_a_proxy_light_is_as_bright_as_its_delta_light(light: str) -> None:
    scene = lit_scene(light)
    loaded = mi.load_dict(scene)
    proxy, substitutions = differentiable_scene(scene, ["ball"], settings=ProxySettings(lights=0.02))
    assert [substitution.original for substitution in substitutions] == [f"{light.split()[0]} light 'lamp'"]
    image, proxy_image = (mi.render(rendered, spp=256, seed=1).numpy() for rendered in (loaded, proxy))
    blocks, proxy_blocks = (pixels.reshape(6, 8, 8, 8, -1).mean(axis=(1, 3)) for pixels in (image, proxy_image))
    # The rays of the disk in place of a directional light are not quite parallel, and shadows are slightly soft.
    np.testing.assert_allclose(proxy_image.mean(axis=(0, 1)), image.mean(axis=(0, 1)), rtol=0.02)
    np.testing.assert_allclose(proxy_blocks, blocks, rtol=0.02, atol=0.02 * float(image.max()))


def test_a_proxy_light_is_made_smaller_in_a_shade_and_not_below_a_ceiling() -> None:
    """A proxy light that reaches through the shade would light the dark side of it."""
    light, black = [2.5, 4.9, 0.5], {"type": "twosided", "nested": {"type": "diffuse"}}
    above = mi.ScalarTransform4f().translate([0, 4.95, 0]).rotate([1, 0, 0], 90).scale(9)
    shade = {"type": "cylinder", "p0": [2.5, 4.5, 0.5], "p1": [2.5, 5.0, 0.5], "radius": 0.1, "bsdf": black}
    ceiling = {"type": "rectangle", "to_world": above, "bsdf": black}
    reasons = []
    for occluder in (shade, ceiling):
        lamp = {"type": "point", "position": light, "intensity": 20.0}
        ball = {"type": "sphere", "center": [0, 1.2, 0], "radius": 0.7}
        planned = PlannedRenderer(
            shadow_scene(ball=ball, occluder=occluder, lamp=lamp), {"x": Translate("ball", (1, 0, 0))}
        )
        (reason,) = planned.plan.substitutions.values()
        reasons.append("reduced until it fits between the shapes around it" in reason)
    assert reasons == [True, False]


@pytest.mark.parametrize(
    "light", ["point", *(pytest.param(light, marks=thorough) for light in ("spot", "directional"))]
)
def test_the_gradient_of_a_delta_light_s_shadow_matches_finite_differences(light: str) -> None:
    scene = lit_scene(light)
    planned = PlannedRenderer(scene, AXES, spp=64)
    exact = planned.unabridged.with_integrator("scene", spp=512)
    draws = [planned.unabridged.vjp(ORIGIN, RAMP, seed=seed) for seed in range(8)]
    slopes, errors, means = np.zeros(2), np.zeros(2), np.zeros(2)
    for k, name in enumerate(AXES):
        plus, minus = (exact.render({**ORIGIN, name: np.float32(by)}, seed=1) for by in (0.1, -0.1))
        slopes[k] = float(np.sum((plus - minus) * RAMP)) / 0.2
        values = np.array([float(gradient[name]) for gradient in draws])
        means[k], errors[k] = values.mean(), values.std(ddof=1) / np.sqrt(len(values))
    size, error = float(np.linalg.norm(slopes)), float(np.linalg.norm(errors))
    assert np.linalg.norm(means - slopes) < 0.1 * size + 3.0 * error
    assert error < 0.1 * size


@pytest.mark.filterwarnings("ignore::loi_mitsuba.GradientWarning")
@pytest.mark.parametrize("light", ["point", "spot", "directional"])
def test_only_the_gradient_of_shadows_comes_from_the_proxy_of_a_delta_light(light: str) -> None:
    scene = lit_scene(light, ball={"type": "sphere", "center": [0, 1, 0], "radius": 0.6})
    without_shadows = {"type": "direct_projective", "guiding": "none", "sppc": 8, "sppp": 8, "sppi": 0}
    planned = PlannedRenderer(scene, AXES).unabridged.with_integrator(without_shadows)
    plain = MitsubaRenderer(scene, AXES, integrator=without_shadows)
    actual, expected = (renderer.vjp(ORIGIN, RAMP, seed=2) for renderer in (planned, plain))
    assert all(expected.values())
    for name, value in expected.items():
        np.testing.assert_allclose(actual[name], value, rtol=1e-4)


def test_a_proxy_light_is_not_larger_than_a_small_moving_shape() -> None:
    """A light much larger than the occluder would leave no umbra, and a twentieth of the gradient of a pixel loss."""
    planned = PlannedRenderer(lit_scene(ball={"type": "sphere", "center": [0, 5, 0], "radius": 0.12}), AXES, spp=64)
    (reason,) = planned.plan.substitutions.values()
    assert "a sphere of radius 0.24, the size of the smallest moving shape" in reason
    exact = planned.unabridged.with_integrator("scene", spp=512)
    objective = PixelL2(exact.render(ORIGIN, seed=10**6))
    displaced = {**ORIGIN, "x": ORIGIN["x"] + np.float32(0.1)}
    draws = []
    for seed in range(8):
        cotangent = objective.value_and_grad(planned.render(displaced, seed=seed))[1]
        draws.append(float(planned.unabridged.vjp(displaced, cotangent, seed=seed)["x"]))
    plus, minus = (
        float(objective.value(exact.render({**ORIGIN, "x": ORIGIN["x"] + np.float32(by)}, seed=1)))
        for by in (0.15, 0.05)
    )
    assert np.mean(draws) > 0.5 * (plus - minus) / 0.1 > 0.0


def test_the_image_comes_from_the_scene_and_not_from_the_proxy() -> None:
    planned = PlannedRenderer(lit_scene(), AXES, spp=16)
    without_proxy = PlannedRenderer(lit_scene(), AXES, spp=16, proxy=None)
    image, pullback = planned.render_vjp(ORIGIN, seed=3)
    np.testing.assert_allclose(image, without_proxy.render(ORIGIN, seed=3), rtol=1e-5, atol=1e-6)
    pullback(np.ones_like(image))
    np.testing.assert_array_equal(planned.render(ORIGIN, seed=3), image)


def test_a_plan_lists_the_substitutions_and_their_reasons() -> None:
    plan = PlannedRenderer(lit_scene(), AXES).plan
    (reason,) = plan.substitutions.values()
    assert list(plan.substitutions) == ["point light 'lamp'"]
    assert "a sphere of radius 0.66, 0.1 of its distance from the moving shapes" in reason
    assert "| point light 'lamp'" in str(plan)
    assert "| replaced" in str(plan)


def test_nothing_is_replaced_that_no_parameter_needs() -> None:
    light = {"brightness": "lamp.intensity.value"}
    assert not PlannedRenderer(lit_scene(), light).plan.substitutions
    assert not PlannedRenderer(shadow_scene(), AXES).plan.substitutions
    assert not PlannedRenderer(lit_scene(), AXES, proxy={"lights": 0.0}).plan.substitutions
    assert not PlannedRenderer(lit_scene(), AXES, proxy=None).plan.substitutions


@pytest.mark.parametrize(
    "light",
    [
        {"type": "point", "position": [0, 9, 0], "intensity": {"type": "blackbody", "temperature": 5000.0}},
        {"type": "point", "position": [0, 1, 0], "intensity": 20.0},  # in view, where its proxy would be visible
        {"type": "spot", "to_world": ("look_at", [5, 9, 0], [9, 9, 0], [0, 0, 1]), "cutoff_angle": 10.0},  # looks away
        {"type": "projector"},
    ],
    ids=["a spectrum that cannot be scaled", "in view", "looks away", "of another kind"],
)
def test_a_light_that_has_no_proxy_stays(light: dict[str, Any]) -> None:
    if isinstance(light.get("to_world"), tuple):
        light = {**light, "to_world": mi.ScalarTransform4f().look_at(*light["to_world"][1:])}
    if light["type"] == "projector":
        light = {**light, "irradiance": {"type": "bitmap", "data": mi.TensorXf(np.ones((4, 4, 3))), "raw": True}}
    plan = PlannedRenderer(lit_scene(other=light), AXES).plan
    assert list(plan.substitutions) == ["point light 'lamp'"]


def test_lights_that_share_a_spectrum_keep_their_intensities() -> None:
    shared = mi.load_dict({"type": "uniform", "value": 100.0})
    lamps = {
        name: {"type": "point", "position": [x, 12.0, 0.0], "intensity": shared}
        for name, x in (("lamp", 1.0), ("other", -1.0))
    }
    scene = shadow_scene(**lamps, integrator={"type": "path", "max_depth": 2})
    expected = np.mean(mi.render(mi.load_dict(scene), spp=64).numpy())
    planned = PlannedRenderer(scene, AXES, spp=64)
    assert list(planned.plan.substitutions) == ["point light 'lamp'", "point light 'other'"]
    assert np.mean(planned.render(ORIGIN)) == pytest.approx(expected, rel=1e-3)
    proxy_image = mi.render(planned.unabridged.proxy_scene, spp=64).numpy()  # type: ignore[attr-defined]
    assert np.mean(proxy_image) == pytest.approx(expected, rel=0.02)


def test_a_light_s_parameter_sets_the_same_light_in_the_proxy(tmp_path: Path) -> None:
    """The second of three lights without ids is a spot that lights no moving shape, and is not replaced."""
    path = xml_of(tmp_path)
    text = path.read_text()
    facing_away = '<transform name="to_world"><lookat origin="5,9,0" target="9,9,0" up="0,0,1"/></transform>'
    spots = f'<emitter type="spot">{facing_away}<rgb name="intensity" value="7"/></emitter>'
    spots += '<emitter type="point"><point name="position" x="2" y="12" z="0"/></emitter></scene>'
    path.write_text(text.replace("</scene>", spots))
    powers = {
        f"{light_name}_{k}": f"{light_name}_{k}.intensity.value"
        for light_name, k in (("point_light", 0), ("point_light", 1))
    }
    powers["spot"] = "spot_light_0.intensity.value"
    for scene in (path, mi.load_file(str(path))):
        planned = PlannedRenderer(scene, {**AXES, **powers}, spp=16)
        assert list(planned.plan.substitutions) == ["point light (1)", "point light (2)"]
        planned.unabridged.vjp({**planned.parameters(), "spot": np.full(3, 9.0, np.float32)}, RAMP)
        proxy_params = mi.traverse(planned.unabridged.proxy_scene)  # type: ignore[attr-defined]
        (spot,) = (key for key in proxy_params.properties if key.endswith(".intensity.value"))
        np.testing.assert_allclose(np.array(proxy_params[spot]).reshape(-1), 9.0)
        bright = [np.array(proxy_params[f"delta_light_{k}.emitter.radiance.value"]).reshape(-1)[0] for k in (0, 2)]
        assert bright[0] > 100.0 * bright[1]


def test_an_object_is_not_replaced_if_its_proxy_lacks_a_fitted_entry() -> None:
    spot = lit_scene("spot")
    plan = PlannedRenderer(spot, {**AXES, "cone": "lamp.texture.value"}).plan
    assert not plan.substitutions
    mirror = {"type": "rectangle", "bsdf": {"type": "conductor"}}
    planned = PlannedRenderer(lit_scene(mirror=mirror), {**AXES, "gloss": "mirror.bsdf.specular_reflectance.value"})
    assert list(planned.plan.substitutions) == ["point light 'lamp'"]
    assert any("perfect mirror" in note for note in planned.plan.notes)


def test_a_loaded_scene_with_instances_has_no_proxy() -> None:
    group = {"type": "shapegroup", "inner": {"type": "sphere", "radius": 0.2}}
    scene = lit_scene(group=group, one={"type": "instance", "shapegroup": {"type": "ref", "id": "group"}})
    assert PlannedRenderer(scene, AXES).plan.substitutions
    assert not PlannedRenderer(mi.load_dict(scene), AXES).plan.substitutions


def test_files_and_loaded_scenes_have_proxies_too(tmp_path: Path) -> None:
    path = xml_of(tmp_path)
    loaded = mi.load_file(str(path))
    ids = [shape.id() for shape in loaded.shapes()]
    names = list(list_parameters(loaded))
    gradients = []
    for scene in (path, loaded, lit_scene()):
        planned = PlannedRenderer(scene, AXES, spp=128)
        assert len(planned.plan.substitutions) == 1
        gradients.append(np.mean([planned.unabridged.vjp(ORIGIN, RAMP, seed=k)["x"] for k in range(3)]))
    assert gradients[0] == pytest.approx(gradients[1], rel=0.15)
    assert np.sign(gradients[0]) == np.sign(gradients[2])
    assert [shape.id() for shape in loaded.shapes()] == ids
    assert list(list_parameters(loaded)) == names


def test_the_gradient_of_an_intensity_comes_from_the_scene_itself() -> None:
    targets = {**AXES, "brightness": "lamp.intensity.value"}
    planned = PlannedRenderer(lit_scene("point placed"), targets, spp=64)
    params: dict[str, Any] = {**ORIGIN, "brightness": np.array([300.0, 120.0, 90.0], np.float32)}
    cotangent = np.ones((48, 64, 3), np.float32)
    pulled = planned.unabridged.vjp(params, cotangent)
    image = planned.unabridged.with_integrator("scene", spp=64).render(params)
    # The image is proportional to the light.
    np.testing.assert_allclose(pulled["brightness"] * params["brightness"], image.sum(axis=(0, 1)), rtol=0.05)
    proxy_params = mi.traverse(planned.unabridged.proxy_scene)  # type: ignore[attr-defined]
    radius = 0.1 * float(np.linalg.norm([0.1, 6.6, 0.0]))  # from the light to the bounding box of the ball
    radiance = np.array(proxy_params["lamp.emitter.radiance.value"], dtype=np.float64).reshape(-1)
    np.testing.assert_allclose(radiance * np.pi * radius**2, params["brightness"], rtol=1e-3)


def test_a_spectral_light_is_not_replaced_and_causes_a_warning(recwarn: pytest.WarningsRecorder) -> None:
    mi.set_variant("llvm_ad_spectral")
    planned = PlannedRenderer(lit_scene("point placed"), AXES)
    assert any("a shape moves under a PointLight" in str(warning.message) for warning in recwarn)
    assert not planned.plan.substitutions
    image, pullback = planned.render_vjp(planned.parameters())
    assert np.all(np.isfinite(pullback(np.ones_like(image))["x"]))


def test_the_gradient_of_edges_in_a_mirror_matches_finite_differences() -> None:
    transform = mi.ScalarTransform4f
    mirror = {
        "type": "rectangle",
        "to_world": transform().translate([0, 0, -1]).scale(8),
        "bsdf": {"type": "conductor"},
    }
    glow = {"type": "area", "radiance": 1.0}
    ball = {"type": "sphere", "center": [0, -4.5, 2], "radius": 0.8, "emitter": glow}
    sky = {"type": "constant", "radiance": 0.1}
    scene = shadow_scene(floor=mirror, ball=ball, lamp=sky, integrator={"type": "path", "max_depth": 3})
    planned = PlannedRenderer(scene, AXES, spp=64)
    assert list(planned.plan.substitutions) == ["conductor 'bsdf'"]
    assert not any("perfect mirror" in note for note in planned.plan.notes)
    exact = planned.unabridged.with_integrator("scene", spp=256)
    plus, minus = (exact.render({**ORIGIN, "x": np.float32(by)}, seed=1) for by in (0.1, -0.1))
    slope = float(np.sum((plus - minus) * RAMP)) / 0.2
    draws = np.array([float(planned.unabridged.vjp(ORIGIN, RAMP, seed=seed)["x"]) for seed in range(6)])
    assert draws.mean() == pytest.approx(slope, rel=0.1, abs=3.0 * draws.std(ddof=1) / np.sqrt(len(draws)))


def test_a_fitted_8_bit_texture_is_loaded_as_floats(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    mi.util.write_bitmap(str(tmp_path / "floor.png"), mi.Bitmap(picture), write_async=False)
    scene = lit_scene()
    scene["floor"]["bsdf"]["reflectance"] = {"type": "bitmap", "filename": str(tmp_path / "floor.png")}
    colours = {"picture": "floor.bsdf.reflectance.data"}
    reference = MitsubaRenderer(scene, {"brightness": "lamp.intensity.value"}, spp=64)
    for renderer in (MitsubaRenderer(scene, colours, spp=64), PlannedRenderer(scene, {**AXES, **colours}, spp=64)):
        start = renderer.parameters()
        assert start["picture"].shape == (6, 8, 3)
        image, pullback = renderer.render_vjp(start)
        np.testing.assert_allclose(np.mean(image), np.mean(reference.render(reference.parameters())), rtol=2e-3)
        assert np.any(pullback(np.ones_like(image))["picture"])
    with pytest.raises(ParameterError, match=r"an 8-bit texture, .*load the bitmap with format='variant'"):
        MitsubaRenderer(mi.load_dict(scene), colours)


def test_a_scene_s_dict_with_tensors_can_be_loaded_twice() -> None:
    picture = mi.TensorXf(np.full((4, 4, 3), 0.5, np.float32))
    scene = lit_scene()
    scene["floor"]["bsdf"]["reflectance"] = {"type": "bitmap", "data": picture, "raw": True}
    for _ in range(2):
        assert PlannedRenderer(scene, AXES).plan.substitutions
        MitsubaRenderer(scene, {"colour": "floor.bsdf.reflectance.data"})


@pytest.mark.parametrize(
    ("proxy", "says"),
    [
        ({"lights": 0.6}, r"`proxy`: `lights` must be 0 to 0\.5, got 0\.6"),
        ({"mirrors": float("nan")}, r"`proxy`: `mirrors` must be 0 to 0\.5, got nan"),
        ({"mirrors": "rough"}, r"`proxy`: `mirrors` must be 0 to 0\.5, got 'rough'"),
        (
            {"lamps": 0.1},
            r"`proxy`: must be a ProxySettings, None, or a table of lights, mirrors, seams, textures, got",
        ),
        (0.1, r"`proxy`: must be a ProxySettings, None, or a table of lights, mirrors, seams, textures, got 0\.1"),
    ],
)
def test_proxy_settings_are_checked(proxy: Any, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        PlannedRenderer(lit_scene(), AXES, proxy=proxy)

"""Mitsuba scenes keep the renderer contract, and name the parameters that have no gradient."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_core import Free, LOIObjective, Renderer, fit
from loi_core.errors import OptionError, ParameterError
from loi_mitsuba import (
    MitsubaRenderer,
    PlannedRenderer,
    Rotate,
    Scale,
    SceneLoadError,
    Translate,
    list_parameters,
)
from tests.helpers import Host, relative_error
from tests.mitsuba.scenes import HEIGHT, PARAMETERS, WIDTH, box, random_cotangent, shadow_scene
from tests.strategies import thorough

AXES = {"x": (1, 0, 0), "z": (0, 0, 1)}
XML = """<scene version="3.0.0">
<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="8"/>
    <integer name="height" value="6"/></film></sensor>
<shape type="sphere"><transform name="to_world"><translate z="5"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.5,0.2,0.1"/></bsdf></shape>
<shape type="sphere" id="lamp"><transform name="to_world"><translate y="5" z="5"/></transform>
    <emitter type="area"><rgb name="radiance" value="9"/></emitter></shape>
<shape type="sphere"><transform name="to_world"><translate x="2" z="5"/></transform></shape>
<emitter type="constant"/>
</scene>"""


@pytest.fixture(scope="module")
def renderer() -> MitsubaRenderer:
    return MitsubaRenderer(shadow_scene(box=box((1.0, 0.6, 0.0), 0.4)), PARAMETERS, spp=8)


def perturbed(params: dict[str, Host], seed: int) -> dict[str, Host]:
    rng = np.random.default_rng(seed)
    return {name: (value + 0.2 * rng.uniform(0, 1, value.shape)).astype(np.float32) for name, value in params.items()}


def test_a_mitsuba_renderer_keeps_the_renderer_contract(renderer: MitsubaRenderer) -> None:
    assert isinstance(renderer, Renderer)
    params = renderer.parameters()
    shapes = {"place": (3,), "size": (), "turn": (), "floor": (3,), "light": (3,)}
    assert {name: value.shape for name, value in params.items()} == shapes
    np.testing.assert_allclose(params["floor"], [0.5, 0.4, 0.3], rtol=1e-6)
    originals = {name: value.copy() for name, value in params.items()}
    image, pullback = renderer.render_vjp(params, seed=3)
    gradient = pullback(np.ones_like(image))
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert {name: value.shape for name, value in gradient.items()} == shapes
    assert {array.dtype for array in (image, *params.values(), *gradient.values())} == {np.dtype("float32")}
    assert all(np.array_equal(params[name], original) for name, original in originals.items())
    params["floor"][:] = 0.0
    np.testing.assert_array_equal(renderer.parameters()["floor"], originals["floor"])


def test_an_image_depends_on_nothing_but_parameters_and_seed(renderer: MitsubaRenderer) -> None:
    params = renderer.parameters()
    image, pullback = renderer.render_vjp(params, seed=5)
    gradient = pullback(random_cotangent())
    changed = perturbed(params, 1)
    renderer.render_vjp(changed, seed=6)[1](random_cotangent(1))
    np.testing.assert_array_equal(renderer.render(params, seed=5), image)
    repeated = pullback(random_cotangent())  # after other renders
    for name, value in gradient.items():
        np.testing.assert_allclose(repeated[name], value, rtol=1e-4, atol=1e-4)  # atomic sums in varying order
    assert not np.array_equal(renderer.render(params, seed=6), image)
    assert not np.array_equal(renderer.render(changed, seed=5), image)
    fresh = MitsubaRenderer(shadow_scene(box=box((1.0, 0.6, 0.0), 0.4)), PARAMETERS, spp=8)
    np.testing.assert_array_equal(fresh.render(params, seed=5), image)


def test_many_parameters_share_their_kernels() -> None:
    balls = {f"ball_{k}": {"type": "sphere", "center": [k - 4.0, 1.0, 0.0], "radius": 0.3} for k in range(8)}
    boxes = {f"box_{k}": box((k - 4.0, 0.5, 2.0), 0.3) for k in range(8)}
    targets = {f"{name}_{letter}": Translate(name, axis) for name in balls | boxes for letter, axis in AXES.items()}
    renderer = MitsubaRenderer(shadow_scene(**balls, **boxes), targets, spp=2)
    params = renderer.parameters()
    for seed in range(3):  # parameters in NumPy's memory and in Mitsuba's, and the kernel cache
        params = perturbed(params, seed)
        renderer.render(params, seed=seed)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for seed in range(3, 7):
            params = perturbed(params, seed)
            renderer.render(params, seed=seed)
        kernels = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    assert kernels
    assert all(kernel["cache_hit"] for kernel in kernels)


def test_no_gradient_stays_enabled_in_the_scene(renderer: MitsubaRenderer) -> None:
    image, pullback = renderer.render_vjp(renderer.parameters())
    pullback(image)
    assert not attached(renderer.scene)


def test_no_gradient_stays_enabled_where_mitsuba_fails(
    renderer: MitsubaRenderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, pullback = renderer.render_vjp(renderer.parameters(), seed=2)
    expected, put = pullback(image), mi.ImageBlock.put

    def failing(*_: Any, **__: Any) -> None:
        with dr.resume_grad():  # as Mitsuba does while it samples
            assert attached(renderer.scene)
        msg = "out of memory"
        raise RuntimeError(msg)

    with monkeypatch.context() as patch:
        patch.setattr(type(renderer._integrator), "sample", failing)
        with pytest.raises(RuntimeError, match="out of memory"):
            pullback(image)
    assert not attached(renderer.scene)
    assert mi.ImageBlock.put is put
    for name, value in pullback(image).items():
        np.testing.assert_allclose(value, expected[name], rtol=1e-4, atol=1e-4)  # atomic sums in varying order


def test_the_pullback_works_inside_suspend_grad(renderer: MitsubaRenderer) -> None:
    _, pullback = renderer.render_vjp(renderer.parameters(), seed=4)
    expected = pullback(random_cotangent())
    with dr.suspend_grad():
        gradient = pullback(random_cotangent())
    assert np.any(expected["place"])
    for name, value in gradient.items():
        np.testing.assert_allclose(value, expected[name], rtol=1e-4, atol=1e-4)  # atomic sums in varying order


def attached(scene: Any) -> bool:
    params = mi.traverse(scene)
    return any(dr.grad_enabled(params[key]) for key in params.properties)


def test_the_pullback_of_mitsuba_is_linear(renderer: MitsubaRenderer) -> None:
    _, pullback = renderer.render_vjp(renderer.parameters(), seed=7)
    cotangents = random_cotangent(1), random_cotangent(2)
    first, second = map(pullback, cotangents)
    combined = pullback(2.0 * cotangents[0] - 3.0 * cotangents[1])
    for name, value in combined.items():
        scale = np.abs(first[name]).max() + np.abs(second[name]).max()
        np.testing.assert_allclose(value, 2.0 * first[name] - 3.0 * second[name], atol=1e-4 * (1.0 + scale))


@pytest.mark.parametrize("integrator", [None, {"type": "prb", "max_depth": 3}])
def test_gradients_of_colours_agree_with_finite_differences(integrator: Any) -> None:
    """For one seed, the image is a smooth function of a colour. Image and gradient have independent noise."""
    names = {"floor": PARAMETERS["floor"], "light": PARAMETERS["light"]}
    renderer = MitsubaRenderer(shadow_scene(), names, spp=256, integrator=integrator)
    params = renderer.parameters()
    cotangent = np.linspace(0.0, 1.0, HEIGHT * WIDTH * 3, dtype=np.float32).reshape(HEIGHT, WIDTH, 3)
    gradient = renderer.render_vjp(params)[1](cotangent)
    for name, value in params.items():
        direction = np.ones_like(value)
        step = 0.05 * float(np.mean(value))

        def loss(size: float, name: str = name, value: Host = value, direction: Host = direction) -> float:
            image = renderer.render({**params, name: value + np.float32(size) * direction})
            return float(np.sum(cotangent * image, dtype=np.float64))

        difference = (loss(step) - loss(-step)) / (2.0 * step)
        # With 256 samples in each of 3000 pixels, the noise of the sum is far below 1 %.
        assert float(np.sum(gradient[name])) == pytest.approx(difference, rel=1e-2)


@pytest.mark.parametrize(
    ("target", "step"),
    [
        (Translate("ball", (1, 0, 0)), 0.1),
        pytest.param(Translate("box", (2, 0, 0)), 0.1, marks=thorough),
        pytest.param(Rotate("box", (0, 1, 0), (-2, 5, 0)), 4.0, marks=thorough),
    ],
    ids=["ball", "box", "turn"],
)
def test_gradients_of_moving_shadows_agree_with_finite_differences(target: Any, step: float) -> None:
    """A test at 4 standard errors, with fixed seeds; correct code fails for one in 16,000 sets of seeds."""
    boxes = {} if target.shape == "ball" else {"box": box((0.3, 4.8, 0.2), 0.4)}
    scene = shadow_scene(**boxes)
    if boxes:
        del scene["ball"]
    renderer = MitsubaRenderer(scene, {"pose": target}, spp=32)
    image = renderer.render(renderer.parameters())
    assert image.min() < 0.5 * image.max()  # a shadow is in view
    x, y = np.meshgrid(np.linspace(-1, 1, WIDTH), np.linspace(-1, 1, HEIGHT))
    cotangent = np.repeat((x * (1.0 + y))[..., None], 3, axis=-1).astype(np.float32)
    start = renderer.parameters()["pose"]

    def loss(offset: float, seed: int) -> float:
        return float(np.sum(cotangent * renderer.render({"pose": start + np.float32(offset)}, seed=seed)))

    gradients = [float(renderer.render_vjp({"pose": start}, seed=k)[1](cotangent)["pose"]) for k in range(16)]
    differences = [(loss(step, k) - loss(-step, k)) / (2.0 * step) for k in range(100, 116)]
    error = np.hypot(np.std(gradients, ddof=1), np.std(differences, ddof=1)) / 4.0
    assert abs(np.mean(gradients) - np.mean(differences)) < 4.0 * error
    assert abs(np.mean(differences)) > 6.0 * error  # a wrong sign, zero or a factor of two would fail


def test_a_fit_moves_a_shadow_to_a_target_without_overlap() -> None:
    handles = {"x": Translate("ball", (1, 0, 0)), "z": Translate("ball", (0, 0, 1))}
    goal = {"x": np.float32(0.8), "z": np.float32(-0.5)}
    target = MitsubaRenderer(shadow_scene(), handles, spp=256).render(goal, seed=10**6)
    renderer = MitsubaRenderer(shadow_scene(), handles, spp=16)
    start = {"x": Free(np.float32(-1.1)), "z": Free(np.float32(0.5))}
    image = renderer.render({name: free.initial for name, free in start.items()})
    shadow, target_shadow = (array[..., 0] < 0.5 * array[..., 0].max() for array in (image, target))
    assert shadow.any()
    assert target_shadow.any()
    assert not np.any(shadow & target_shadow)
    result = fit(renderer, LOIObjective(target), steps=100, learning_rate=0.08, optimise=start)
    for name, value in goal.items():
        assert float(result.params[name]) == pytest.approx(float(value), abs=0.05)  # half a pixel on the floor


def test_handles_of_one_shape_scale_then_rotate_then_translate() -> None:
    names: dict[str, Any] = {"move": Translate("box"), "turn": Rotate("box", (0, 0, 2)), "size": Scale("box")}
    renderer = MitsubaRenderer(shadow_scene(box=box((1.0, 0.6, 0.0), 0.4)), names, spp=1)
    values = {"move": np.array([0.0, 1.0, 0.0]), "turn": np.array(90.0), "size": np.array(2.0)}
    offsets = np.array(mi.traverse(renderer.scene)["box.vertex_positions"]).reshape(-1, 3) - [1.0, 0.6, 0.0]
    renderer.render(values)
    vertices = np.array(mi.traverse(renderer.scene)["box.vertex_positions"]).reshape(-1, 3)
    expected = 2.0 * offsets @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [1.0, 1.6, 0.0]
    np.testing.assert_allclose(vertices, expected, atol=1e-5)


def test_an_explicit_pivot_stays_fixed() -> None:
    renderer = MitsubaRenderer(shadow_scene(), {"size": Scale("ball", pivot=(0, 0, 0))}, spp=1)
    renderer.render({"size": 0.5})
    to_world = np.array(mi.traverse(renderer.scene)["ball.to_world"].matrix).reshape(4, 4)
    expected = np.diag([0.2, 0.2, 0.2, 1.0])
    expected[1, 3] = 2.5
    np.testing.assert_allclose(to_world, expected, atol=1e-6)


def test_entries_of_every_type_can_be_fitted() -> None:
    picture = np.random.default_rng(0).uniform(0, 1, (4, 5, 3)).astype(np.float32)
    floor = shadow_scene()["floor"]
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(picture), "raw": True}
    scene = shadow_scene(floor={**floor, "bsdf": {"type": "diffuse", "reflectance": texture}}, box=box((1, 1, 0), 0.4))
    names = {
        "texture": "floor.bsdf.reflectance.data",
        "pose": "ball.to_world",
        "grey": "ball.bsdf.reflectance.value",
        "corners": "box.vertex_positions",
    }
    renderer = MitsubaRenderer(scene, names, spp=4)
    params = renderer.parameters()
    np.testing.assert_array_equal(params["texture"], picture)
    assert {name: value.shape for name, value in params.items()} == {
        "texture": (4, 5, 3),
        "pose": (4, 4),
        "grey": (),
        "corners": (24,),
    }
    new = {**params, "texture": params["texture"] * np.float32(0.5)}
    image, pullback = renderer.render_vjp(new)
    np.testing.assert_array_equal(mi.traverse(renderer.scene)["floor.bsdf.reflectance.data"].numpy(), picture * 0.5)
    np.testing.assert_allclose(np.array(mi.traverse(renderer.scene)["ball.to_world"].matrix)[..., 0], params["pose"])
    gradient = pullback(np.ones_like(image))
    assert np.any(gradient["texture"])
    assert np.any(gradient["pose"])
    # The floor's radiance is linear in its texture, so the gradient follows from two images.
    doubled = renderer.render({**new, "texture": params["texture"]})
    expected = float(np.sum(doubled - image, dtype=np.float64))
    assert float(np.sum(gradient["texture"] * new["texture"])) == pytest.approx(expected, rel=2e-2)


def test_parameter_names_are_the_same_in_every_process(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(XML)
    names: dict[str, Any] = {
        "move": Translate("sphere_1"),
        "colour": "sphere_0.bsdf.reflectance.value",
        "sky": Translate("lamp"),
    }
    renderer = MitsubaRenderer(path, names)
    np.testing.assert_allclose(renderer.parameters()["colour"], [0.5, 0.2, 0.1], rtol=1e-6)
    assert renderer.render(renderer.parameters()).shape == (6, 8, 3)
    listed = list_parameters(renderer.scene)
    assert listed["sphere_0.to_world"].shape == (4, 4)
    assert "object_" in listed["sphere_0.to_world"].key
    assert "move the scene instead" in listed["perspective_camera_0.to_world"].problem
    by_key = MitsubaRenderer(renderer.scene, {"colour": listed["sphere_0.bsdf.reflectance.value"].key})
    assert by_key.parameters()["colour"].shape == (3,)
    code = "import loi_mitsuba as lm, mitsuba as mi, sys; mi.set_variant('llvm_ad_rgb')\n"
    code += "print(*lm.list_parameters(mi.load_file(sys.argv[1], optimize=False)))"
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == list(listed), done.stderr


def test_equal_objects_of_a_scene_are_not_merged() -> None:
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.4, 0.3]}}
    scene = shadow_scene()
    scene["ball"]["bsdf"] = bsdf
    assert "ball.bsdf.reflectance.value" in list_parameters(MitsubaRenderer(scene, {"size": Scale("ball")}).scene)


def test_sample_counts_of_the_integrator_take_precedence() -> None:
    projective = {"type": "direct_projective", "guiding": "none"}

    def samples(integrator: Any, **options: Any) -> int:
        renderer = MitsubaRenderer(shadow_scene(), {"size": Scale("ball")}, integrator=integrator, spp=8, **options)
        return renderer._spp_grad

    assert samples(None) == samples(projective) == samples({**projective, "sppp": 0}) == 8
    assert samples({**projective, "sppi": 64}) == 0  # in Mitsuba, 0 keeps the integrator's counts
    assert samples({**projective, "sppi": 64}, spp_grad=4) == 4


def test_the_integrator_of_the_scene_can_be_used() -> None:
    scene = shadow_scene(integrator={"type": "prb", "max_depth": 3})
    deep = MitsubaRenderer(scene, {"light": PARAMETERS["light"]}, integrator="scene", spp=64)
    default = MitsubaRenderer(scene, {"light": PARAMETERS["light"]}, spp=64)
    image, direct = (renderer.render(renderer.parameters()) for renderer in (deep, default))
    assert image.mean() > direct.mean()
    assert relative_error(image, direct) < 0.5


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "`parameters` must be a dict of names and their targets, at least one"),
        ({"a": 3}, r"`parameters\['a'\]` must be an entry's name, Translate, Rotate or Scale, got 3"),
        ({"a": "floor.reflectance.value"}, "no parameter 'floor.reflectance.value'; similar: floor.bsdf.reflectance"),
        (
            {"a": "sensor.to_world"},
            "'sensor.to_world' cannot be fitted: .*move the scene instead; or give PlannedRenderer a Translate",
        ),
        ({"a": "sensor.x_fov"}, "move the scene instead"),
        ({"a": Translate("sensor")}, "'sensor' cannot be moved: .*move the scene"),
        (
            {"a": "spot.to_world"},
            "a SpotLight is missing or wrong; use a small sphere .*; or give PlannedRenderer a Translate",
        ),
        ({"a": Translate("point")}, "'point' cannot be moved: .*use a small sphere with an area emitter"),
        ({"a": Translate("nobody")}, "no shape 'nobody' that can be moved; it has: floor, ball, lamp"),
        ({"a": "ball.silhouette_sampling_weight"}, "cannot be fitted: Mitsuba gives no gradient for it"),
        ({"a": "ball.to_world", "b": Scale("ball")}, "must not set one entry twice, got 'a', 'b'"),
        ({"a": PARAMETERS["floor"], "b": PARAMETERS["floor"]}, "must not set one entry twice, got 'a', 'b'"),
    ],
)
def test_targets_without_a_gradient_raise_an_error(parameters: Any, message: str, tmp_path: Path) -> None:
    mi.Bitmap(np.zeros((4, 4, 3), np.uint8)).write(str(tmp_path / "picture.png"))
    texture = {"type": "bitmap", "filename": str(tmp_path / "picture.png")}
    scene = shadow_scene(
        spot={"type": "spot"},
        point={"type": "point", "position": [0, 1, 0]},
        picture={"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": texture}},
    )
    with pytest.raises(ParameterError, match=message):
        MitsubaRenderer(scene, parameters)


def test_visible_silhouettes_need_a_perspective_camera() -> None:
    scene = shadow_scene(sensor={"type": "orthographic"})
    with pytest.raises(ParameterError, match=r"is a OrthographicCamera, .*for perspective only"):
        MitsubaRenderer(scene, {"place": Translate("ball")})
    MitsubaRenderer(scene, {"floor": PARAMETERS["floor"]})
    shadows = {"type": "direct_projective", "guiding": "none", "sppp": 0}
    MitsubaRenderer(scene, {"place": Translate("ball")}, integrator=shadows)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"place": "left"}, r"`place` must be numbers of shape \(3,\), got 'left'"),
        ({"place": [[1.0], [1.0, 2.0]]}, r"`place` must be numbers of shape \(3,\)"),
        ({"size": 1e300}, "`size` must be finite, got 1 values that are not"),  # in float32
        ({"place": np.zeros(2)}, r"`place` must have shape \(3,\), got \(2,\)"),
        ({"floor": np.array([0, np.nan, 1])}, "`floor` must be finite, got 1 values that are not"),
        ({"size": np.array(0.0)}, "`size` scales a shape and must be more than 0, got 0"),
        ({"other": np.array(0.0)}, "`params` must have exactly the names"),
    ],
)
def test_wrong_parameter_values_raise_an_error_that_names_them(
    renderer: MitsubaRenderer, change: Any, message: str
) -> None:
    with pytest.raises(ParameterError, match=message):
        renderer.render({**renderer.parameters(), **change})


def test_wrong_options_of_the_renderer_raise_errors_that_name_them(renderer: MitsubaRenderer, tmp_path: Path) -> None:
    names = {"light": PARAMETERS["light"]}
    for options, message in (
        ({"spp": 0}, "`spp` must be a whole number of samples from 1 to 1398101 for this film, got 0"),
        ({"spp": 1398102}, "for this film, got 1398102"),  # 2**32 samples in 64 x 48 pixels
        ({"spp_grad": 2**33}, "`spp_grad` must be a whole number of samples from 1 to 1398101"),
        ({"spp_grad": 1.5}, "`spp_grad` must be a whole number"),
        ({"sensor": 1}, "one of the scene's 1 sensors, from 0, got 1"),
        ({"integrator": {"type": "nothing"}}, '`integrator` cannot be loaded: .*"nothing" not found'),
        (
            {"integrator": {"type": "direct_projective", "guiding": "x"}},
            '`integrator` cannot be loaded: [^\n]*Exception: "guiding" must be set to "none", "grid", or "octree"$',
        ),
        ({"integrator": "path"}, "`integrator` must be a dict, an mi.Integrator or 'scene', got 'path'"),
    ):
        with pytest.raises(OptionError, match=message):
            MitsubaRenderer(shadow_scene(), names, **options)
    with pytest.raises(
        OptionError, match=r"`scene` must be a dict, the path of an XML file, or an mi.Scene, got a int"
    ):
        MitsubaRenderer(3, names)
    with pytest.raises(OptionError, match="`scene` has no sensor"):
        MitsubaRenderer({"type": "scene"}, names)
    with pytest.raises(SceneLoadError, match=r"`scene` cannot be loaded: .*no_such_shape"):
        MitsubaRenderer({"type": "scene", "a": {"type": "no_such_shape"}}, names)
    with pytest.raises(SceneLoadError, match=r"nothing.xml"):
        MitsubaRenderer(tmp_path / "nothing.xml", names)
    with pytest.raises(OptionError, match="`seed` must be a whole number, 0 or more, got -1"):
        renderer.render(renderer.parameters(), seed=-1)
    with pytest.raises(ParameterError, match=r"`cotangent` must have shape \(48, 64, 3\), got \(3,\)"):
        renderer.render_vjp(renderer.parameters())[1](np.zeros(3))
    with pytest.raises(ParameterError, match="`axis` must be a direction"):
        Rotate("ball", (0, 0, 0))
    with pytest.raises(ParameterError, match="`pivot` must be three finite numbers"):
        Scale("ball", (0, 0))


def test_a_variant_without_gradients_raises_an_error() -> None:
    mi.set_variant("scalar_rgb")
    with pytest.raises(OptionError, match=r"'scalar_rgb' has no gradients; call mi.set_variant"):
        MitsubaRenderer({}, {"a": "b"})


def test_a_changed_variant_raises_an_error_that_names_both(renderer: MitsubaRenderer) -> None:
    mi.set_variant("llvm_ad_spectral")
    with pytest.raises(OptionError, match="variant is 'llvm_ad_spectral', the scene's is 'llvm_ad_rgb'"):
        renderer.render(renderer.parameters())


def test_the_loss_works_with_mi_render_without_a_renderer() -> None:
    """The six lines of a typical Mitsuba loop."""
    from loi_mitsuba import loi_loss

    scene = mi.load_dict(shadow_scene(integrator={"type": "prb"}))
    params = mi.traverse(scene)
    photograph = mi.render(scene, spp=64, seed=1)
    key = "lamp.emitter.radiance.value"
    params[key] = mi.Color3f(60.0)
    dr.enable_grad(params[key])
    params.update()
    dr.backward(loi_loss(mi.render(scene, params, spp=64, seed=2), photograph))
    assert np.all(np.array(dr.grad(params[key])) < 0.0)  # more light decreases the loss


@pytest.mark.parametrize(
    "rfilter", [*(pytest.param(rfilter, marks=thorough) for rfilter in ("box", "tent")), "gaussian"]
)
@pytest.mark.parametrize("height", [0.0, -3.6], ids=["shadow", "silhouette"])
def test_edges_have_the_gradient_of_finite_differences_with_a_sampled_border(rfilter: str, height: float) -> None:
    """The image is so small that its border has up to a third of the pixels."""
    scene = shadow_scene(integrator={"type": "direct"})
    scene["sensor"]["film"] |= {"width": 32, "height": 24, "rfilter": {"type": rfilter}, "sample_border": True}
    renderer = MitsubaRenderer(scene, {"place": Translate("ball")}, spp=256)
    params = {"place": np.array([0.3, height, 0.2], np.float32)}
    ramp = np.linspace(-1.0, 1.0, 32, dtype=np.float32)[None, :, None] * np.ones((24, 32, 3), np.float32)
    gradients = [float(renderer.vjp(params, ramp, seed=seed)["place"][0]) for seed in range(6)]
    differences = []
    for seed in range(4):
        forward, backward = (
            renderer.render({"place": params["place"] + np.array([x, 0, 0], np.float32)}, seed=seed).astype(np.float64)
            for x in (0.1, -0.1)
        )
        differences.append(float(np.sum((forward - backward) * ramp)) / 0.2)
    error = np.hypot(np.std(gradients, ddof=1) / np.sqrt(6), np.std(differences, ddof=1) / 2.0)
    assert np.mean(gradients) == pytest.approx(np.mean(differences), rel=0.02, abs=4.0 * error)


@pytest.mark.parametrize("renderer_class", [MitsubaRenderer, PlannedRenderer])
def test_a_wrong_cotangent_raises_an_error(renderer_class: Any) -> None:
    renderer = renderer_class(shadow_scene(), {"x": Translate("ball", (1, 0, 0))}, spp=4)
    image, pullback = renderer.render_vjp(renderer.parameters())
    transposed = np.zeros((image.shape[1], image.shape[0], 3), np.float32)
    with pytest.raises(ParameterError, match=r"`cotangent` must have shape .*, got"):
        pullback(transposed)
    non_finite = np.zeros_like(image)
    non_finite[3, 4] = np.nan
    with pytest.raises(ParameterError, match=r"`cotangent` must be finite, got 3 values that are not"):
        pullback(non_finite)


def test_a_rotated_mesh_keeps_the_normals_of_its_file(tmp_path: Path) -> None:
    """Mitsuba recomputes normals when vertices are set, which changes the shading of the mesh."""
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"vn {0.6 * x} 0 0.8" for x, _, _ in corners]
    (tmp_path / "card.obj").write_text("\n".join([*lines, "f 1//1 2//2 3//3", "f 1//1 3//3 4//4"]))
    transform = mi.ScalarTransform4f

    def scene(pose: Any) -> dict[str, Any]:
        card = {"type": "obj", "filename": str(tmp_path / "card.obj"), "to_world": pose}
        lamp = {"type": "directional", "direction": [-1, -1, -1], "irradiance": 3.0}
        return shadow_scene(card=card | {"bsdf": {"type": "twosided", "nested": {"type": "diffuse"}}}, lamp=lamp)

    pose = transform().translate([0, 1.5, 0]).rotate([1, 0, 0], -60)
    rotation = transform().rotate([0, 1, 0], 30)
    rotated = transform().translate([0, 1.5, 0]) @ rotation @ transform().rotate([1, 0, 0], -60)
    renderer = MitsubaRenderer(scene(pose), {"turn": Rotate("card", (0, 1, 0))}, spp=16)
    for angle, expected in ((0.0, pose), (30.0, rotated)):
        image = renderer.render({"turn": np.float32(angle)}, seed=1)
        static = MitsubaRenderer(scene(expected), {"light": "lamp.irradiance.value"}, spp=16)
        np.testing.assert_allclose(image, static.render(static.parameters(), seed=1), atol=2e-3)

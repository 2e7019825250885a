"""Any Mitsuba scene keeps the renderer contract, and says plainly what it cannot give a gradient for."""

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
    GradientWarning,
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


def moved(params: dict[str, Host], seed: int) -> dict[str, Host]:
    rng = np.random.default_rng(seed)
    return {name: (value + 0.2 * rng.uniform(0, 1, value.shape)).astype(np.float32) for name, value in params.items()}


def test_it_keeps_the_contract(renderer: MitsubaRenderer) -> None:
    assert isinstance(renderer, Renderer)
    params = renderer.parameters()
    shapes = {"place": (3,), "size": (), "turn": (), "floor": (3,), "light": (3,)}
    assert {name: value.shape for name, value in params.items()} == shapes
    np.testing.assert_allclose(params["floor"], [0.5, 0.4, 0.3], rtol=1e-6)
    kept = {name: value.copy() for name, value in params.items()}
    image, pullback = renderer.render_vjp(params, seed=3)
    gradient = pullback(np.ones_like(image))
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert {name: value.shape for name, value in gradient.items()} == shapes
    assert {array.dtype for array in (image, *params.values(), *gradient.values())} == {np.dtype("float32")}
    assert all(np.array_equal(params[name], kept[name]) for name in kept)
    params["floor"][:] = 0.0
    np.testing.assert_array_equal(renderer.parameters()["floor"], kept["floor"])


def test_an_image_depends_on_parameters_and_seed_alone(renderer: MitsubaRenderer) -> None:
    params = renderer.parameters()
    image, pullback = renderer.render_vjp(params, seed=5)
    gradient = pullback(random_cotangent())
    other = moved(params, 1)
    renderer.render_vjp(other, seed=6)[1](random_cotangent(1))
    np.testing.assert_array_equal(renderer.render(params, seed=5), image)
    again = pullback(random_cotangent())  # after other renders, and a second time
    for name, value in gradient.items():
        np.testing.assert_allclose(again[name], value, rtol=1e-4, atol=1e-4)  # sums by atomic adds, in any order
    assert not np.array_equal(renderer.render(params, seed=6), image)
    assert not np.array_equal(renderer.render(other, seed=5), image)
    fresh = MitsubaRenderer(shadow_scene(box=box((1.0, 0.6, 0.0), 0.4)), PARAMETERS, spp=8)
    np.testing.assert_array_equal(fresh.render(params, seed=5), image)


def test_many_parameters_are_compiled_once() -> None:
    balls = {f"ball_{k}": {"type": "sphere", "center": [k - 4.0, 1.0, 0.0], "radius": 0.3} for k in range(8)}
    boxes = {f"box_{k}": box((k - 4.0, 0.5, 2.0), 0.3) for k in range(8)}
    targets = {f"{name}_{letter}": Translate(name, axis) for name in balls | boxes for letter, axis in AXES.items()}
    renderer = MitsubaRenderer(shadow_scene(**balls, **boxes), targets, spp=2)
    params = renderer.parameters()
    for seed in range(3):  # what is read from NumPy's memory, what is from Mitsuba's own, and their kernels kept
        params = moved(params, seed)
        renderer.render(params, seed=seed)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for seed in range(3, 7):
            params = moved(params, seed)
            renderer.render(params, seed=seed)
        kernels = [one for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT]
    assert kernels
    assert all(one["cache_hit"] for one in kernels)


def test_nothing_attached_is_left_in_the_scene(renderer: MitsubaRenderer) -> None:
    image, pullback = renderer.render_vjp(renderer.parameters())
    pullback(image)
    assert not attached(renderer.scene)


def test_nothing_attached_is_left_where_mitsuba_fails(
    renderer: MitsubaRenderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, pullback = renderer.render_vjp(renderer.parameters(), seed=2)
    wanted, put = pullback(image), mi.ImageBlock.put

    def failing(*_: Any, **__: Any) -> None:
        with dr.resume_grad():  # what is sampled decides by itself what has one
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
        np.testing.assert_allclose(value, wanted[name], rtol=1e-4, atol=1e-4)  # sums by atomic adds, in any order


def test_a_caller_that_has_suspended_gradients_gets_them_all_the_same(renderer: MitsubaRenderer) -> None:
    _, pullback = renderer.render_vjp(renderer.parameters(), seed=4)
    wanted = pullback(random_cotangent())
    with dr.suspend_grad():
        gradient = pullback(random_cotangent())
    assert np.any(wanted["place"])
    for name, value in gradient.items():
        np.testing.assert_allclose(value, wanted[name], rtol=1e-4, atol=1e-4)  # sums by atomic adds, in any order


def attached(scene: Any) -> bool:
    params = mi.traverse(scene)
    return any(dr.grad_enabled(params[key]) for key in params.properties)


def test_the_pullback_is_linear(renderer: MitsubaRenderer) -> None:
    _, pullback = renderer.render_vjp(renderer.parameters(), seed=7)
    one, other = random_cotangent(1), random_cotangent(2)
    first, second, both = pullback(one), pullback(other), pullback(2.0 * one - 3.0 * other)
    for name, value in both.items():
        scale = np.abs(first[name]).max() + np.abs(second[name]).max()
        np.testing.assert_allclose(value, 2.0 * first[name] - 3.0 * second[name], atol=1e-4 * (1.0 + scale))


@pytest.mark.parametrize("integrator", [None, {"type": "prb", "max_depth": 3}])
def test_colours_agree_with_finite_differences(integrator: Any) -> None:
    """In a colour the image of one seed is smooth; image and gradient differ only in their seeds, so by noise."""
    names = {"floor": PARAMETERS["floor"], "light": PARAMETERS["light"]}
    renderer = MitsubaRenderer(shadow_scene(), names, spp=256, integrator=integrator)
    params = renderer.parameters()
    cotangent = np.linspace(0.0, 1.0, HEIGHT * WIDTH * 3, dtype=np.float32).reshape(HEIGHT, WIDTH, 3)
    gradient = renderer.render_vjp(params)[1](cotangent)
    for name, value in params.items():
        direction = np.ones_like(value)
        step = 0.05 * float(np.mean(value))

        def along(size: float, name: str = name, value: Host = value, direction: Host = direction) -> float:
            image = renderer.render({**params, name: value + np.float32(size) * direction})
            return float(np.sum(cotangent * image, dtype=np.float64))

        measured = (along(step) - along(-step)) / (2.0 * step)
        # 256 samples in each of 3000 pixels leave far less than 1 % of the sum to chance.
        assert float(np.sum(gradient[name])) == pytest.approx(measured, rel=1e-2)


@pytest.mark.parametrize(
    ("target", "step"),
    [
        (Translate("ball", (1, 0, 0)), 0.1),
        pytest.param(Translate("box", (2, 0, 0)), 0.1, marks=thorough),
        pytest.param(Rotate("box", (0, 1, 0), (-2, 5, 0)), 4.0, marks=thorough),
    ],
    ids=["ball", "box", "turn"],
)
def test_moving_shadows_agree_with_finite_differences(target: Any, step: float) -> None:
    """A test at 4 standard errors: right, it fails once in 16000 draws of seeds, and these seeds are fixed."""
    extra = {} if target.shape == "ball" else {"box": box((0.3, 4.8, 0.2), 0.4)}
    scene = shadow_scene(**extra)
    if extra:
        del scene["ball"]
    renderer = MitsubaRenderer(scene, {"pose": target}, spp=32)
    image = renderer.render(renderer.parameters())
    assert image.min() < 0.5 * image.max()  # there is a shadow in view
    x, y = np.meshgrid(np.linspace(-1, 1, WIDTH), np.linspace(-1, 1, HEIGHT))
    cotangent = np.repeat((x * (1.0 + y))[..., None], 3, axis=-1).astype(np.float32)
    start = renderer.parameters()["pose"]

    def along(size: float, seed: int) -> float:
        return float(np.sum(cotangent * renderer.render({"pose": start + np.float32(size)}, seed=seed)))

    drawn = np.array([float(renderer.render_vjp({"pose": start}, seed=k)[1](cotangent)["pose"]) for k in range(16)])
    measured = np.array([(along(step, k) - along(-step, k)) / (2.0 * step) for k in range(100, 116)])
    error = np.hypot(drawn.std(ddof=1), measured.std(ddof=1)) / 4.0
    assert abs(drawn.mean() - measured.mean()) < 4.0 * error
    assert abs(measured.mean()) > 6.0 * error  # so that a wrong sign, a zero or a factor of two would fail


def test_a_fit_moves_a_shadow_that_does_not_overlap() -> None:
    handles = {"x": Translate("ball", (1, 0, 0)), "z": Translate("ball", (0, 0, 1))}
    goal = {"x": np.float32(0.8), "z": np.float32(-0.5)}
    target = MitsubaRenderer(shadow_scene(), handles, spp=256).render(goal, seed=10**6)
    renderer = MitsubaRenderer(shadow_scene(), handles, spp=16)
    start = {"x": Free(np.float32(-1.1)), "z": Free(np.float32(0.5))}
    image = renderer.render({name: free.initial for name, free in start.items()})
    dark = [one[..., 0] < 0.5 * one[..., 0].max() for one in (image, target)]
    assert all(one.any() for one in dark)
    assert not np.any(dark[0] & dark[1])
    result = fit(renderer, LOIObjective(target), steps=100, learning_rate=0.08, optimise=start)
    for name, value in goal.items():
        assert float(result.params[name]) == pytest.approx(float(value), abs=0.05)  # half a pixel on the floor


def test_handles_on_one_shape_are_scale_then_turn_then_move() -> None:
    names: dict[str, Any] = {"move": Translate("box"), "turn": Rotate("box", (0, 0, 2)), "size": Scale("box")}
    renderer = MitsubaRenderer(shadow_scene(box=box((1.0, 0.6, 0.0), 0.4)), names, spp=1)
    values = {"move": np.array([0.0, 1.0, 0.0]), "turn": np.array(90.0), "size": np.array(2.0)}
    before = np.array(mi.traverse(renderer.scene)["box.vertex_positions"]).reshape(-1, 3) - [1.0, 0.6, 0.0]
    renderer.render(values)
    after = np.array(mi.traverse(renderer.scene)["box.vertex_positions"]).reshape(-1, 3)
    wanted = 2.0 * before @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [1.0, 1.6, 0.0]
    np.testing.assert_allclose(after, wanted, atol=1e-5)


def test_a_pivot_of_one_s_own_stays() -> None:
    renderer = MitsubaRenderer(shadow_scene(), {"size": Scale("ball", pivot=(0, 0, 0))}, spp=1)
    renderer.render({"size": 0.5})
    placed = np.array(mi.traverse(renderer.scene)["ball.to_world"].matrix).reshape(4, 4)
    wanted = np.diag([0.2, 0.2, 0.2, 1.0])
    wanted[1, 3] = 2.5
    np.testing.assert_allclose(placed, wanted, atol=1e-6)


def test_entries_of_every_type_can_be_set() -> None:
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
    # All light that the floor sends out is its texture times what arrives: the gradient is known from the image.
    doubled = renderer.render({**new, "texture": params["texture"]})
    wanted = float(np.sum(doubled - image, dtype=np.float64))
    assert float(np.sum(gradient["texture"] * new["texture"])) == pytest.approx(wanted, rel=2e-2)


def test_names_are_the_same_in_every_process(tmp_path: Path) -> None:
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


def test_equal_objects_stay_apart() -> None:
    same = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.4, 0.3]}}
    scene = shadow_scene()
    scene["ball"]["bsdf"] = same
    assert "ball.bsdf.reflectance.value" in list_parameters(MitsubaRenderer(scene, {"size": Scale("ball")}).scene)


def test_samples_are_the_integrator_s_own_where_it_has_them() -> None:
    projective = {"type": "direct_projective", "guiding": "none"}

    def samples(integrator: Any, **options: Any) -> int:
        renderer = MitsubaRenderer(shadow_scene(), {"size": Scale("ball")}, integrator=integrator, spp=8, **options)
        return renderer._spp_grad

    assert samples(None) == samples(projective) == samples({**projective, "sppp": 0}) == 8
    assert samples({**projective, "sppi": 64}) == 0  # Mitsuba's word for: as the integrator says
    assert samples({**projective, "sppi": 64}, spp_grad=4) == 4


def test_the_scene_s_own_integrator_can_be_asked_for() -> None:
    scene = shadow_scene(integrator={"type": "prb", "max_depth": 3})
    own = MitsubaRenderer(scene, {"light": PARAMETERS["light"]}, integrator="scene", spp=64)
    default = MitsubaRenderer(scene, {"light": PARAMETERS["light"]}, spp=64)
    lit, direct = (one.render(one.parameters()) for one in (own, default))
    assert lit.mean() > direct.mean()
    assert relative_error(lit, direct) < 0.5


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({}, "`parameters` must be a dict of names and what they stand for, at least one"),
        ({"a": 3}, r"`parameters\['a'\]` must be an entry's name, Translate, Rotate or Scale, got 3"),
        ({"a": "floor.reflectance.value"}, "no entry 'floor.reflectance.value'; near: floor.bsdf.reflectance"),
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
def test_what_cannot_be_fitted_is_refused(parameters: Any, says: str, tmp_path: Path) -> None:
    mi.Bitmap(np.zeros((4, 4, 3), np.uint8)).write(str(tmp_path / "picture.png"))
    texture = {"type": "bitmap", "filename": str(tmp_path / "picture.png")}
    scene = shadow_scene(
        spot={"type": "spot"},
        point={"type": "point", "position": [0, 1, 0]},
        picture={"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": texture}},
    )
    with pytest.raises(ParameterError, match=says):
        MitsubaRenderer(scene, parameters)


def test_a_silhouette_in_view_needs_perspective() -> None:
    scene = shadow_scene(sensor={"type": "orthographic"})
    with pytest.raises(ParameterError, match=r"is a OrthographicCamera, .*for perspective only"):
        MitsubaRenderer(scene, {"place": Translate("ball")})
    MitsubaRenderer(scene, {"floor": PARAMETERS["floor"]})
    shadows = {"type": "direct_projective", "guiding": "none", "sppp": 0}
    MitsubaRenderer(scene, {"place": Translate("ball")}, integrator=shadows)


@pytest.mark.parametrize(
    ("change", "says"),
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
def test_wrong_values_are_named(renderer: MitsubaRenderer, change: Any, says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        renderer.render({**renderer.parameters(), **change})


def test_wrong_options_are_named(renderer: MitsubaRenderer, tmp_path: Path) -> None:
    names = {"light": PARAMETERS["light"]}
    for options, says in (
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
        with pytest.raises(OptionError, match=says):
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


def test_a_variant_without_gradients_is_refused() -> None:
    mi.set_variant("scalar_rgb")
    with pytest.raises(OptionError, match=r"'scalar_rgb' has no gradients; call mi.set_variant"):
        MitsubaRenderer({}, {"a": "b"})


def test_another_variant_than_the_scene_s_is_named(renderer: MitsubaRenderer) -> None:
    mi.set_variant("llvm_ad_spectral")
    with pytest.raises(OptionError, match="variant is 'llvm_ad_spectral', the scene's is 'llvm_ad_rgb'"):
        renderer.render(renderer.parameters())


def test_the_loss_and_mi_render_need_no_renderer() -> None:
    """The six lines that a Mitsuba user writes."""
    from loi_mitsuba import LOILoss

    scene = mi.load_dict(shadow_scene(integrator={"type": "prb"}))
    params = mi.traverse(scene)
    loss = LOILoss(mi.render(scene, spp=64, seed=1))
    key = "lamp.emitter.radiance.value"
    params[key] = mi.Color3f(60.0)
    dr.enable_grad(params[key])
    params.update()
    dr.backward(loss(mi.render(scene, params, spp=64, seed=2)))
    assert np.all(np.array(dr.grad(params[key])) < 0.0)  # more light brings it nearer


@pytest.mark.parametrize("rfilter", [*(pytest.param(one, marks=thorough) for one in ("box", "tent")), "gaussian"])
@pytest.mark.parametrize("height", [0.0, -3.6], ids=["a shadow", "an outline"])
def test_edges_count_alike_whether_or_not_the_film_samples_its_border(rfilter: str, height: float) -> None:
    """A ball over a floor; the image is small, so that its border has up to a third of its pixels."""
    scene = shadow_scene(integrator={"type": "direct"})
    scene["sensor"]["film"] |= {"width": 32, "height": 24, "rfilter": {"type": rfilter}, "sample_border": True}
    renderer = MitsubaRenderer(scene, {"place": Translate("ball")}, spp=256)
    at = {"place": np.array([0.3, height, 0.2], np.float32)}
    ramp = np.linspace(-1.0, 1.0, 32, dtype=np.float32)[None, :, None] * np.ones((24, 32, 3), np.float32)
    drawn = [float(renderer.vjp(at, ramp, seed=seed)["place"][0]) for seed in range(6)]
    slopes = []
    for seed in range(4):
        ahead, behind = (
            renderer.render({"place": at["place"] + np.array([by, 0, 0], np.float32)}, seed=seed).astype(np.float64)
            for by in (0.1, -0.1)
        )
        slopes.append(float(np.sum((ahead - behind) * ramp)) / 0.2)
    error = np.hypot(np.std(drawn, ddof=1) / np.sqrt(6), np.std(slopes, ddof=1) / 2.0)
    assert np.mean(drawn) == pytest.approx(np.mean(slopes), rel=0.02, abs=4.0 * error)


@pytest.mark.parametrize("kind", [MitsubaRenderer, PlannedRenderer])
def test_a_cotangent_that_is_none_is_refused(kind: Any) -> None:
    renderer = kind(shadow_scene(), {"x": Translate("ball", (1, 0, 0))}, spp=4)
    image, pullback = renderer.render_vjp(renderer.parameters())
    turned = np.zeros((image.shape[1], image.shape[0], 3), np.float32)
    with pytest.raises(ParameterError, match=r"`cotangent` must have shape .*, got"):
        pullback(turned)
    hole = np.zeros_like(image)
    hole[3, 4] = np.nan
    with pytest.raises(ParameterError, match=r"`cotangent` must be finite, got 3 values that are not"):
        pullback(hole)


def test_a_mesh_with_normals_of_its_own_keeps_them_wherever_it_is(tmp_path: Path) -> None:
    """Mitsuba computes normals anew when vertices are set, which shades a mesh otherwise than its file says."""
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"vn {0.6 * x} 0 0.8" for x, _, _ in corners]
    (tmp_path / "card.obj").write_text("\n".join([*lines, "f 1//1 2//2 3//3", "f 1//1 3//3 4//4"]))
    place = mi.ScalarTransform4f

    def scene(pose: Any) -> dict[str, Any]:
        card = {"type": "obj", "filename": str(tmp_path / "card.obj"), "to_world": pose}
        lamp = {"type": "directional", "direction": [-1, -1, -1], "irradiance": 3.0}
        return shadow_scene(card=card | {"bsdf": {"type": "twosided", "nested": {"type": "diffuse"}}}, lamp=lamp)

    pose = place().translate([0, 1.5, 0]).rotate([1, 0, 0], -60)
    turned = place().translate([0, 1.5, 0]) @ place().rotate([0, 1, 0], 30) @ place().rotate([1, 0, 0], -60)
    with pytest.warns(GradientWarning, match="moves under a DirectionalEmitter"):
        renderer = MitsubaRenderer(scene(pose), {"turn": Rotate("card", (0, 1, 0))}, spp=16)
    for angle, wanted in ((0.0, pose), (30.0, turned)):
        image = renderer.render({"turn": np.float32(angle)}, seed=1)
        still = MitsubaRenderer(scene(wanted), {"light": "lamp.irradiance.value"}, spp=16)
        np.testing.assert_allclose(image, still.render(still.parameters(), seed=1), atol=2e-3)

"""A loop with ``mi.render`` gets gradients that its scene lacks from the scene of ``differentiable_scene``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mitsuba_boundaries import ProxySettings, differentiable_scene
from tests.helpers import Host

WIDTH, HEIGHT = 48, 36
STEP = 0.05  # of central differences
RAMP: Host = np.stack(
    np.broadcast_arrays(*np.meshgrid(np.linspace(-1.0, 1.0, WIDTH), np.linspace(-1.0, 1.0, HEIGHT)), 1.0), axis=-1
).astype(np.float32)


def textured_floor(**texture: Any) -> dict[str, Any]:
    lying = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(6)
    return {"type": "rectangle", "to_world": lying, "bsdf": {"type": "diffuse", "reflectance": texture}}


def seen_from_above(**objects: Any) -> dict[str, Any]:
    view = mi.ScalarTransform4f().look_at([0, 6, 6], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "sample_border": True}
    return {"type": "scene", "camera": {"type": "perspective", "fov": 45, "to_world": view, "film": film}, **objects}


def occluded_light() -> dict[str, Any]:
    picture = np.random.default_rng(0).uniform(0.2, 0.9, (16, 16, 3)).astype(np.float32)
    return seen_from_above(
        floor=textured_floor(type="bitmap", raw=True, data=mi.TensorXf(picture)),
        ball={"type": "sphere", "center": [0.5, 1.2, -0.3], "radius": 0.8},
        lamp={"type": "point", "position": [2, 6, 1], "intensity": 40.0},
    )


def mirrored_ball() -> dict[str, Any]:
    upright = mi.ScalarTransform4f().translate([0, 1, -2]).scale([4, 2, 1])
    return seen_from_above(
        floor=textured_floor(type="checkerboard", to_uv=mi.ScalarTransform4f().scale(6)),
        mirror={"type": "rectangle", "to_world": upright, "bsdf": {"type": "conductor"}},
        ball={"type": "sphere", "center": [0.5, 1.0, 0.5], "radius": 0.6, "emitter": {"type": "area", "radiance": 2.0}},
        sky={"type": "constant", "radiance": 0.2},
    )


def gradients(scene: Any, integrator: dict[str, Any], key: str, *, draws: int, spp: int) -> tuple[Host, Host]:
    """Return the mean gradient with respect to a displacement of an object, and its standard error, shape (3,) each."""
    loaded, params = mi.load_dict(integrator), mi.traverse(scene)
    start = mi.Transform4f(params[key])
    drawn = []
    for seed in range(draws):
        offset = mi.Vector3f(0.0, 0.0, 0.0)
        dr.enable_grad(offset)
        params[key] = mi.Transform4f().translate(offset) @ start
        params.update()
        image = mi.render(scene, params, integrator=loaded, spp=spp, seed=seed)
        dr.backward(dr.sum(image * mi.TensorXf(RAMP), axis=None))
        drawn.append(np.array(dr.grad(offset), dtype=np.float64).reshape(3))
    return np.mean(drawn, axis=0), np.std(drawn, axis=0, ddof=1) / np.sqrt(draws)


def central_differences(description: dict[str, Any], depth: int, move: Callable[[Any, list[float]], None]) -> Host:
    """Return the central differences of the scene itself along the axes, shape (3,)."""
    scene = mi.load_dict(description)
    integrator = mi.load_dict({"type": "path", "max_depth": depth})
    slopes = []
    for axis in np.eye(3):
        images = []
        for step in (STEP, -STEP):
            move(scene, (step * axis).tolist())
            images.append(mi.render(scene, spp=1024, seed=1, integrator=integrator).numpy().astype(np.float64))
        move(scene, [0.0, 0.0, 0.0])
        slopes.append(float(np.sum((images[0] - images[1]) * RAMP)) / (2.0 * STEP))
    return np.array(slopes)


def check_gradient(mean: Host, error: Host, expected: Host) -> None:
    size, noise = float(np.linalg.norm(expected)), float(np.linalg.norm(error))
    assert noise < 0.15 * size
    assert np.linalg.norm(mean - expected) < 0.1 * size + 3.0 * noise


def test_the_gradient_of_a_point_light_s_position_matches_central_differences() -> None:
    scene, substitutions = differentiable_scene(occluded_light(), ["ball"])
    assert [substitution.light for substitution in substitutions] == ["lamp"]

    def move(scene: Any, offset: list[float]) -> None:
        params = mi.traverse(scene)
        params["lamp.position"] = mi.Point3f(2.0 + offset[0], 6.0 + offset[1], 1.0 + offset[2])
        params.update()

    integrator = {"type": "direct_boundaries", "guiding": "none"}
    mean, error = gradients(scene, integrator, "lamp.to_world", draws=8, spp=256)
    check_gradient(mean, error, central_differences(occluded_light(), 2, move))


def test_the_gradient_of_a_reflection_matches_central_differences() -> None:
    scene, substitutions = differentiable_scene(mirrored_ball(), ["ball"], settings=ProxySettings(mirrors=0.03))
    assert [substitution.original for substitution in substitutions] == ["conductor 'bsdf'"]

    def move(scene: Any, offset: list[float]) -> None:
        params = mi.traverse(scene)
        centre = mi.Transform4f().translate(mi.Vector3f(0.5, 1.0, 0.5) + mi.Vector3f(*offset))
        params["ball.to_world"] = centre @ mi.Transform4f().scale(0.6)
        params.update()

    integrator = {"type": "prb_boundaries", "max_depth": 3, "guiding": "none"}
    mean, error = gradients(scene, integrator, "ball.to_world", draws=6, spp=128)
    check_gradient(mean, error, central_differences(mirrored_ball(), 3, move))


def test_lights_and_shapes_that_are_kept_stay_as_they_are() -> None:
    scene, substitutions = differentiable_scene(occluded_light(), ["ball"], keep=["lamp"])
    assert substitutions == ()
    assert [emitter.class_name() for emitter in scene.emitters()] == ["PointLight"]


def test_all_shapes_may_move_by_default() -> None:
    scene, (substitution,) = differentiable_scene(occluded_light())
    intensity, radiance = 40.0, np.array(mi.traverse(scene)["lamp.emitter.radiance.value"]).reshape(-1)
    np.testing.assert_allclose(radiance, substitution.factor * intensity, rtol=1e-5)
    assert str(substitution).startswith("point light 'lamp': a sphere of radius ")


def test_a_loaded_scene_is_returned_itself_or_shares_its_shapes() -> None:
    loaded = mi.load_dict(mirrored_ball())
    assert differentiable_scene(loaded) == (loaded, ())
    lit = mi.load_dict(occluded_light())
    scene, substitutions = differentiable_scene(lit, ["ball"])
    assert len(substitutions) == 1
    assert set(lit.shapes()) < set(scene.shapes())


@pytest.mark.parametrize("argument", ["moving", "keep"])
def test_an_unknown_id_is_refused_with_the_known_ones(argument: str) -> None:
    options: Any = {argument: ["bell"]}
    with pytest.raises(ValueError, match=rf"`{argument}` must have ids of .*'?ball'?, .*got 'bell'"):
        differentiable_scene(occluded_light(), **options)

"""Smooth surfaces that move: what stands for them has little noise, and shows no light that they do not."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import PlannedRenderer, Translate
from loi_mitsuba.plugins.proxy_bsdf import register_proxy_bsdf
from loi_mitsuba.plugins.proxy_emitter import hittable_proxy_emitters, register_proxy_emitter
from tests.helpers import Host
from tests.mitsuba.scenes import shadow_scene
from tests.strategies import thorough

AXES: dict[str, Any] = {axis: Translate("ball", tuple(np.eye(3)[k])) for k, axis in enumerate("xyz")}
SHINY: dict[str, dict[str, Any]] = {
    "mirror": {"type": "conductor"},
    "plastic": {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.7, 0.2, 0.1]}},
}
SUN: dict[str, Any] = {"type": "directional", "direction": [-0.5, -1.0, -0.3], "irradiance": 2.0}


def shiny_scene(kind: str) -> dict[str, Any]:
    """A ball in view over a floor, under a sun and a sky."""
    ball = {"type": "sphere", "center": [0.0, 1.2, 0.0], "radius": 1.2, "bsdf": SHINY[kind]}
    sky = {"type": "constant", "radiance": 0.3}
    return shadow_scene(ball=ball, lamp=SUN, sky=sky, integrator={"type": "path", "max_depth": 4})


def blocks() -> Host:
    """Weights of 8 x 8 pixels each."""
    return np.kron(np.random.default_rng(1).uniform(-1.0, 1.0, (6, 8, 3)), np.ones((8, 8, 1))).astype(np.float32)


@pytest.mark.parametrize("kind", ["mirror", pytest.param("plastic", marks=thorough)])
def test_the_gradient_of_a_shiny_ball_under_a_sun_goes_where_finite_differences_do(kind: str) -> None:
    planned = PlannedRenderer(shiny_scene(kind), AXES, spp=64)
    assert not planned.plan.blurred
    renderer, here, step = planned.unabridged, planned.parameters(), 0.04
    drawn = [renderer.vjp(here, blocks(), seed=seed) for seed in range(16)]
    found = np.array([[float(one[name]) for name in AXES] for one in drawn])
    slopes = []
    for name in AXES:
        sides = [{**here, name: here[name] + np.float32(by)} for by in (step, -step)]
        images = [sum(renderer.render(side, seed=seed) for seed in range(16)) / 16 for side in sides]
        slopes.append(float(np.sum((images[0] - images[1]) * blocks())) / (2.0 * step))
    size, mean = float(np.linalg.norm(slopes)), found.mean(axis=0)
    assert float(np.linalg.norm(found.std(axis=0, ddof=1))) < size  # of one draw; it had been 32 times as large
    assert float(mean @ slopes) / size / float(np.linalg.norm(mean)) > 0.85  # it had been negative


@pytest.mark.parametrize("kind", SHINY)
def test_a_neighbour_shows_no_light_that_the_scene_does_not(kind: str) -> None:
    planned = PlannedRenderer(shiny_scene(kind), AXES, proxy={"mirrors": 0.01})
    scene: Any = planned.unabridged
    own, near = (mi.render(one, spp=256, seed=1).numpy() for one in (scene.scene, scene.proxy_scene))
    np.testing.assert_allclose(near.max(), own.max(), rtol=0.1)  # a highlight would be 60 times as bright as the sky
    of_own, of_near = (one.reshape(6, 8, 8, 8, -1).mean(axis=(1, 3)) for one in (own, near))
    np.testing.assert_allclose(of_near, of_own, rtol=0.05, atol=0.01)


@pytest.mark.parametrize("kind", ["roughconductor", "roughplastic", "roughdielectric"])
def test_what_stands_for_a_mirror_reflects_as_much_as_what_it_is_made_of(kind: str) -> None:
    rough = mi.load_dict({"type": kind, "alpha": 0.2})
    mirror = mi.load_dict({"type": register_proxy_bsdf(), "rough": rough})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 1 << 18)
    si = dr.zeros(mi.SurfaceInteraction3f, 1 << 18)
    si.wi = dr.normalize(mi.Vector3f(0.5, 0.2, 0.6))
    drawn, weights = zip(
        *(one.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), True) for one in (mirror, rough)),
        strict=True,
    )
    of_mirror, of_rough = (np.array(one).mean() for one in weights)
    assert of_mirror == pytest.approx(of_rough, rel=0.01)
    glossy = int(mi.BSDFFlags.Glossy)
    assert not np.any(np.array(drawn[0].sampled_type) & glossy)
    assert np.any(np.array(drawn[1].sampled_type) & glossy)
    assert np.any(np.array(drawn[0].sampled_type) & int(mi.BSDFFlags.Delta))
    value, _ = mirror.eval_pdf(mi.BSDFContext(), si, drawn[1].wo, True)
    assert np.any(np.array(value)) == (kind == "roughplastic")  # whose other lobe lamps are sampled for


def test_only_a_shadow_s_rays_find_the_light_of_a_lamp_that_they_hit() -> None:
    lamp = {"type": "sphere", "emitter": {"type": register_proxy_emitter(), "radiance": {"type": "rgb", "value": 3.0}}}
    scene = mi.load_dict({"type": "scene", "lamp": lamp})
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.0, 0.0, 5.0), mi.Vector3f(0.0, 0.0, -1.0)))
    assert not np.any(np.array(si.emitter(scene).eval(si)))
    with hittable_proxy_emitters():
        np.testing.assert_allclose(np.array(si.emitter(scene).eval(si)), 3.0)
    assert not np.any(np.array(si.emitter(scene).eval(si)))

"""The plugins of proxy scenes: surfaces with little noise in the gradient and without highlights of delta lights."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import MitsubaRenderer, PlannedRenderer, Translate
from mitsuba_boundaries.plugins.proxy_bsdf import register_proxy_bsdf
from mitsuba_boundaries.plugins.proxy_emitter import hittable_proxy_emitters, register_proxy_emitter
from tests.helpers import Host
from tests.mitsuba.scenes import shadow_scene
from tests.strategies import thorough

AXES: dict[str, Any] = {axis: Translate("ball", tuple(np.eye(3)[k])) for k, axis in enumerate("xyz")}
SHINY: dict[str, dict[str, Any]] = {
    "mirror": {"type": "conductor"},
    "plastic": {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.7, 0.2, 0.1]}},
}
SUN: dict[str, Any] = {"type": "directional", "direction": [-0.5, -1.0, -0.3], "irradiance": 2.0}


def shiny_scene(surface: str) -> dict[str, Any]:
    """A ball in view over a floor, under a sun and a sky."""
    ball = {"type": "sphere", "center": [0.0, 1.2, 0.0], "radius": 1.2, "bsdf": SHINY[surface]}
    sky = {"type": "constant", "radiance": 0.3}
    return shadow_scene(ball=ball, lamp=SUN, sky=sky, integrator={"type": "path", "max_depth": 4})


def blocks() -> Host:
    """Return random weights that are constant in blocks of 8 x 8 pixels."""
    return np.kron(np.random.default_rng(1).uniform(-1.0, 1.0, (6, 8, 3)), np.ones((8, 8, 1))).astype(np.float32)


@pytest.mark.parametrize("surface", ["mirror", pytest.param("plastic", marks=thorough)])
def test_the_gradient_of_a_shiny_ball_under_a_sun_agrees_with_finite_differences(surface: str) -> None:
    planned = PlannedRenderer(shiny_scene(surface), AXES, spp=64)
    assert not planned.plan.blurred
    renderer, params, step = planned.unabridged, planned.parameters(), 0.04
    gradients = [renderer.vjp(params, blocks(), seed=seed) for seed in range(8)]
    draws = np.array([[float(gradient[name]) for name in AXES] for gradient in gradients])
    reference = MitsubaRenderer(shiny_scene(surface), AXES, integrator="scene", spp=256, without_gradient=tuple(AXES))
    slopes = []
    for name in AXES:
        images = [reference.render({**params, name: params[name] + np.float32(offset)}) for offset in (step, -step)]
        slopes.append(float(np.sum((images[0] - images[1]) * blocks())) / (2.0 * step))
    size, mean = float(np.linalg.norm(slopes)), draws.mean(axis=0)
    assert float(np.linalg.norm(draws.std(axis=0, ddof=1))) < size  # of one draw; 32 times as large with highlights
    assert float(mean @ slopes) / size / float(np.linalg.norm(mean)) > 0.85  # negative with highlights


@pytest.mark.parametrize("surface", SHINY)
def test_a_proxy_scene_shows_no_highlights_of_delta_lights(surface: str) -> None:
    planned = PlannedRenderer(shiny_scene(surface), AXES, proxy={"mirrors": 0.01})
    scene: Any = planned.unabridged
    image, proxy_image = (mi.render(rendered, spp=256, seed=1).numpy() for rendered in (scene.scene, scene.proxy_scene))
    np.testing.assert_allclose(
        proxy_image.max(), image.max(), rtol=0.1
    )  # a highlight would be 60 times as bright as the sky
    means, proxy_means = (pixels.reshape(6, 8, 8, 8, -1).mean(axis=(1, 3)) for pixels in (image, proxy_image))
    np.testing.assert_allclose(proxy_means, means, rtol=0.05, atol=0.01)


@pytest.mark.parametrize("surface", ["roughconductor", "roughplastic", "roughdielectric"])
def test_a_proxy_bsdf_reflects_as_much_as_the_rough_bsdf_within(surface: str) -> None:
    rough = mi.load_dict({"type": surface, "alpha": 0.2})
    mirror = mi.load_dict({"type": register_proxy_bsdf(), "rough": rough})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 1 << 18)
    si = dr.zeros(mi.SurfaceInteraction3f, 1 << 18)
    si.wi = dr.normalize(mi.Vector3f(0.5, 0.2, 0.6))
    samples, weights = zip(
        *(bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), True) for bsdf in (mirror, rough)),
        strict=True,
    )
    mirror_albedo, rough_albedo = (np.array(weight).mean() for weight in weights)
    assert mirror_albedo == pytest.approx(rough_albedo, rel=0.01)
    glossy = int(mi.BSDFFlags.Glossy)
    assert not np.any(np.array(samples[0].sampled_type) & glossy)
    assert np.any(np.array(samples[1].sampled_type) & glossy)
    assert np.any(np.array(samples[0].sampled_type) & int(mi.BSDFFlags.Delta))
    value, _ = mirror.eval_pdf(mi.BSDFContext(), si, samples[1].wo, True)
    assert np.any(np.array(value)) == (surface == "roughplastic")  # its diffuse lobe is open to emitter sampling


def test_rays_see_a_proxy_emitter_only_while_it_is_hittable() -> None:
    lamp = {"type": "sphere", "emitter": {"type": register_proxy_emitter(), "radiance": {"type": "rgb", "value": 3.0}}}
    scene = mi.load_dict({"type": "scene", "lamp": lamp})
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.0, 0.0, 5.0), mi.Vector3f(0.0, 0.0, -1.0)))
    assert not np.any(np.array(si.emitter(scene).eval(si)))
    with hittable_proxy_emitters():
        np.testing.assert_allclose(np.array(si.emitter(scene).eval(si)), 3.0)
    assert not np.any(np.array(si.emitter(scene).eval(si)))
    with pytest.raises(ZeroDivisionError), hittable_proxy_emitters():
        raise ZeroDivisionError
    assert not np.any(np.array(si.emitter(scene).eval(si)))

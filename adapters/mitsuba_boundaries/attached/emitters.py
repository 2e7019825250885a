"""Attached emitter sampling: the gradient of direct light with respect to lights that move.

Mitsuba has the gradient of an area light from its silhouette alone, where two large contributions nearly cancel, and no
gradient of a point light. Here each emitter sample is a fixed point of the light and moves with it, so that unoccluded
direct light has a smooth gradient. The visibility of a sample is a step function; its slope is a central difference
over the same samples with the light displaced to both sides.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.attached.binding import Binding
from mitsuba_boundaries.drjit.arrays import Float32Array, Float64Array, gather
from mitsuba_boundaries.geometry.bounds import bounding_box
from mitsuba_boundaries.sensing.film import Film
from mitsuba_boundaries.sensing.film_samples import backpropagate, radiance_samples

__all__ = [
    "ROTATION_STEP_DEG",
    "SCALE_STEP",
    "AttachedEmitters",
    "is_attachable_light",
    "translation_step",
    "visible_points",
]

POSITIONED_LIGHTS: Final = ("PointLight", "SpotLight")
ROTATION_STEP_DEG: Final = 1.0
SCALE_STEP: Final = 0.02
SIZE_STEP: Final = 0.25  # of the light's longest side, so that a step does not exceed the width of its penumbras
DISTANCE_STEP: Final = 0.02  # of the distance to the visible surfaces, for point lights and small area lights
DISTANCE_PERCENTILE: Final = 25.0  # of the distances from the light to the visible surfaces


def is_attachable_light(light: Any, scene: Any, *, scaled: bool) -> bool:
    """Return whether attached samples follow a moving light: an area, point or spot light.

    Mitsuba's samples of a mesh do not scale with it.
    """
    if isinstance(light, mi.Emitter):
        return light.class_name() in POSITIONED_LIGHTS
    follows = not (scaled and isinstance(light, mi.Mesh) and light.class_name() != "Rectangle")
    return isinstance(light, mi.Shape) and follows and bool(light.is_emitter()) and light in scene.shapes()


class AttachedEmitters:
    """The gradient of direct light at primary hits, with respect to lights that move.

    Light over several surfaces, and light through mirrors and clear glass, is left out.

    Parameters
    ----------
    scene : mi.Scene
    sensor : mi.Sensor
    binding : Binding
    lights : dict of mi.Shape or mi.Emitter
        The light that each parameter moves.
    steps : dict of float
        Step of the central difference of each parameter, in its unit.
    samples : int
        Samples per pixel.
    """

    def __init__(
        self,
        scene: Any,
        sensor: Any,
        binding: Binding,
        lights: Mapping[str, Any],
        steps: Mapping[str, float],
        samples: int,
    ) -> None:
        self._scene = scene
        self._sensor = sensor
        self._binding = binding
        self._lights = dict(lights)
        self._steps = dict(steps)
        self._samples = samples
        self._film = Film(sensor.film())

    def vjp(
        self, params: Mapping[str, Any], cotangent: Any, *, names: Iterable[str], seed: int
    ) -> dict[str, Float32Array]:
        """Return the gradients of the parameters `names` for a cotangent of the image, shape (H, W, C)."""
        wrt = tuple(names)
        integrator = _attached_integrator(mi.variant())(mi.Properties())
        integrator.area_lights = tuple(light for light in self._lights.values() if isinstance(light, mi.Shape))
        slopes = self._visibility_slopes(integrator, params, wrt, seed)
        with self._binding.attached(params, wrt) as leaves:
            integrator.slopes = [(leaves[name], index, slope) for name, index, slope in slopes]
            with dr.isolate_grad():
                radiance, position = radiance_samples(
                    integrator, self._scene, self._sensor, self._samples, seed, dr.ADMode.Backward
                )
                backpropagate(radiance, position, self._film, np.asarray(cotangent))
            return self._binding.gradients(leaves, wrt)

    def _visibility_slopes(
        self, integrator: Any, params: Mapping[str, Any], names: Iterable[str], seed: int
    ) -> list[tuple[str, int, Any]]:
        """Return the derivative of each sample's visibility with respect to each element of each parameter."""
        slopes = []
        for name in names:
            start = np.asarray(params[name], dtype=np.float32)
            step = np.float32(self._steps[name])
            for index in range(start.size):
                displaced = []
                for sign in (1.0, -1.0):
                    value = start.reshape(-1).copy()
                    value[index] += np.float32(sign) * step
                    self._binding.set(self._binding.leaves({**params, name: value.reshape(start.shape)}))
                    displaced.append(integrator.visibility(self._scene, self._sensor, seed, self._samples))
                (visible_ahead, lit_ahead), (visible_behind, lit_behind) = displaced
                change = dr.select(visible_ahead, 1.0, 0.0) - dr.select(visible_behind, 1.0, 0.0)
                slope = dr.select(lit_ahead & lit_behind, change / (2.0 * step), 0.0)
                dr.eval(slope)
                slopes.append((name, index, slope))
        return slopes


def visible_points(scene: Any, sensor: Any) -> Float64Array:
    """Return a point that the sensor sees for each pixel, shape (n, 3); pixels without a hit are left out."""
    size = np.array(sensor.film().crop_size(), dtype=np.int64).reshape(2)
    with dr.suspend_grad():
        sampler = sensor.sampler().clone()
        sampler.seed(0, int(np.prod(size)))
        position, aperture = sampler.next_2d(), sampler.next_2d()
        si = scene.ray_intersect(sensor.sample_ray(0.0, 0.5, position, aperture)[0])
        points: Float64Array = np.array(si.p, dtype=np.float64).T[np.array(si.is_valid())]
    return points


def translation_step(light: Any, position: Float64Array, points: Float64Array) -> float:
    """Return the step of the visibility's central difference for moving a light.

    Parameters
    ----------
    light : mi.Shape or mi.Emitter
    position : array, shape (3,)
        Position of the light.
    points : array, shape (n, 3)
        Visible points of the scene.
    """
    longest = float(np.max(np.ptp(bounding_box(light), axis=0))) if isinstance(light, mi.Shape) else 0.0
    distances = np.linalg.norm(points - position.reshape(1, 3), axis=1)
    distance = float(np.percentile(distances, DISTANCE_PERCENTILE)) if distances.size else 1.0  # nothing is visible
    return max(SIZE_STEP * longest, DISTANCE_STEP * distance)


@lru_cache
def _attached_integrator(variant: str) -> Any:  # noqa: ARG001 - Mitsuba's classes depend on the current variant
    """Return the class of an integrator that samples emitters only, at primary hits."""

    class AttachedEmitterIntegrator(mi.ad.integrators.common.ADIntegrator):  # type: ignore[misc]  # has no type
        slopes: tuple[tuple[Any, int, Any], ...] = ()
        area_lights: tuple[Any, ...] = ()

        def is_receiver(self, si: Any) -> Any:
            """Return a mask of hits that are not on a moving light; other emitters receive light too."""
            mask = si.is_valid()
            for light in self.area_lights:
                mask &= si.shape != mi.ShapePtr(light)
            return mask

        def visibility(self, scene: Any, sensor: Any, seed: int, samples: int) -> tuple[Any, Any]:
            """Return masks of the samples whose emitter point is visible, and of those on a receiver."""
            with dr.suspend_grad():
                sampler, _ = self.prepare(sensor, seed, samples, [])
                ray, _, _ = self.sample_rays(scene, sensor, sampler)
                si = scene.ray_intersect(mi.Ray3f(ray))
                receiver = self.is_receiver(si)
                ds, _ = scene.sample_emitter_direction(
                    si, sampler.next_2d(receiver), test_visibility=False, active=receiver
                )
                visible = (ds.pdf != 0.0) & ~scene.ray_test(si.spawn_ray_to(ds.p), receiver)
                dr.eval(visible, receiver)
            return visible, receiver

        def sample(self, *, scene: Any, sampler: Any, ray: Any, **_: Any) -> tuple[Any, ...]:
            """Return the radiance of each ray, attached to the poses of the lights and to no other shape."""
            with dr.resume_grad():
                with dr.suspend_grad():
                    si = scene.ray_intersect(mi.Ray3f(ray))
                    bsdf = si.bsdf(mi.RayDifferential3f(ray))
                    active = self.is_receiver(si)
                ds, weight = scene.sample_emitter_direction(
                    si, sampler.next_2d(active), test_visibility=False, active=active
                )
                active &= ds.pdf != 0.0
                with dr.suspend_grad():
                    visible = ~scene.ray_test(si.spawn_ray_to(ds.p), active)
                visibility = dr.select(visible, mi.Float(1.0), 0.0)
                for leaf, index, slope in self.slopes:
                    value = gather(leaf, mi.UInt32(index))
                    visibility += slope * (value - dr.detach(value))
                radiance = bsdf.eval(mi.BSDFContext(), si, si.to_local(ds.d), active) * weight
                return dr.select(active, radiance * visibility, 0.0), si.is_valid(), [], None

    return AttachedEmitterIntegrator

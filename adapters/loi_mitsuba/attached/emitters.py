"""The gradient by lights that move, from samples that move with them.

Mitsuba has the gradient by a lamp with a surface from its outline alone, at whose two sides nearly all cancels, and
none by a point. Here every sample is a point of the lamp that stays there as the lamp moves, so that what is lit has a
smooth gradient. What lies between, and hides that point or not, is a step; its slope is a central difference, of the
same samples with the lamp a little to either side.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.geometry.bounds import bounding_box
from loi_mitsuba.proxy.light_size import light_position
from loi_mitsuba.renderer import MitsubaRenderer, split_seed
from loi_mitsuba.scene.binding import ParameterBinding
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import SceneIndex
from loi_mitsuba.scene.poses import Rotate, Scale
from loi_mitsuba.scene.queries import has_medium
from loi_mitsuba.scene.settings import Settings
from loi_mitsuba.sensing.film import Film
from loi_mitsuba.sensing.film_samples import backpropagate, radiance_samples
from loi_mitsuba.sensing.frustum import Frustum

__all__ = ["AttachedEmitters", "attachable_emitters", "is_shape", "reason_of"]

POINTS: Final = ("PointLight", "SpotLight")
OF_LAMP: Final = 0.25  # of a lamp's longest side that it is put to either side: no more than its penumbras are wide
OF_DISTANCE: Final = 0.02  # of its distance from what the camera sees, for points and small lamps
NEAR: Final = 25.0  # percent of what the camera sees is nearer to the lamp than that distance
DEGREES: Final = 1.0
OF_SCALE: Final = 0.02
OUTLINE: Final = Settings("direct_projective", 2, 0)


def attachable_emitters(called: SceneIndex, targets: Mapping[str, ParameterTarget]) -> dict[str, Any]:
    """The parameters that move a light, each with the light: a shape that emits, a point or a spot.

    None where there is a medium, or light is polarised. Not what scales a mesh, whose samples Mitsuba does not scale.
    """
    if mi.is_polarized or has_medium(called.scene):
        return {}
    found = {}
    for name, target in targets.items():
        light = called.placed_by(target) if isinstance(target, str) else called.find_movable(target.shape)[1]
        if isinstance(target, Scale) and isinstance(light, mi.Mesh) and light.class_name() != "Rectangle":
            continue
        is_point = isinstance(light, mi.Emitter) and light.class_name() in POINTS
        if is_point or (isinstance(light, mi.Shape) and light.is_emitter() and light in called.scene.shapes()):
            found[name] = light
    return found


def is_shape(light: Any) -> bool:
    """Whether a light has a surface, whose outline has a gradient in Mitsuba too."""
    return isinstance(light, mi.Shape)


def reason_of(light: Any) -> str:
    """What a plan says of the gradient by a light that moves."""
    what = light.class_name() if isinstance(light, mi.Emitter) else "lamp"
    return f"it moves a {what}, and samples of its direct light move with it"


class AttachedEmitters:
    """The gradient of a scene by the lights that move in it.

    It is that of direct light, at what the camera sees first; where a lamp itself may be in view, its outline has a
    gradient too. Light over several surfaces, and what a mirror or clear glass makes of a lamp, is left out.

    Parameters
    ----------
    renderer : MitsubaRenderer
        Of the scene, whose values are those of the start.
    lights : dict of mi.Shape or mi.Emitter
        By parameter, the light that it moves.
    samples : int
        Per pixel.
    """

    def __init__(self, renderer: MitsubaRenderer, lights: Mapping[str, Any], samples: int) -> None:
        self._renderer = renderer
        self._lights = dict(lights)
        self._samples = samples
        self._film = Film(renderer.sensor.film())
        self._named = ParameterBinding(renderer.names, renderer.targets, tuple(renderer.targets))
        seen = _seen(renderer.scene, renderer.sensor)
        self._shifts = {name: _shift(renderer.targets[name], light, seen) for name, light in lights.items()}

    def vjp(
        self, params: Mapping[str, Any], cotangent: Any, *, names: Iterable[str], seed: int = 0
    ) -> dict[str, Float32Array]:
        """A cotangent of the image, shape (H, W, C), carried to the parameters `names`."""
        wanted = tuple(names)
        integrator = _integrator_of(mi.variant())(mi.Properties())
        integrator.lamps = tuple(one for one in self._lights.values() if is_shape(one))
        number, scene, sensor = split_seed(seed)[1], self._renderer.scene, self._renderer.sensor
        slopes = self._slopes(integrator, params, wanted, number)
        with self._named.attached(params, wanted) as leaves:
            integrator.slopes = [(leaves[name], index, slope) for name, index, slope in slopes]
            with dr.isolate_grad():
                value, place = radiance_samples(integrator, scene, sensor, self._samples, number, dr.ADMode.Backward)
                backpropagate(value, place, self._film, np.asarray(cotangent))
            pulled = self._named.gradients(leaves, wanted)
        seen = [name for name in wanted if self._is_seen(name)]
        if seen:
            outline = self._renderer.with_integrator(replace(OUTLINE, sppp=self._samples).load(), wrt=seen)
            added = outline.vjp(params, cotangent, seed=seed)
            pulled |= {name: pulled[name] + added[name] for name in seen}
        return pulled

    def _is_seen(self, name: str) -> bool:
        return is_shape(self._lights[name]) and Frustum(self._renderer.sensor).overlaps(self._lights[name])

    def _slopes(
        self, integrator: Any, params: Mapping[str, Any], names: Iterable[str], seed: int
    ) -> list[tuple[str, int, Any]]:
        """By number, of each sample how what can be seen of its lamp changes."""
        found = []
        for name in names:
            start = np.asarray(params[name], dtype=np.float32)
            shift = np.float32(self._shifts[name])
            for index in range(start.size):
                sides = []
                for sign in (1.0, -1.0):
                    value = start.reshape(-1).copy()
                    value[index] += np.float32(sign) * shift
                    moved = {**params, name: value.reshape(start.shape)}
                    self._named.set(self._named.leaves(moved))
                    scene, sensor = self._renderer.scene, self._renderer.sensor
                    sides.append(integrator.visibility(scene, sensor, seed, self._samples))
                (more, lit), (less, also_lit) = sides
                change = dr.select(more, 1.0, 0.0) - dr.select(less, 1.0, 0.0)
                slope = dr.select(lit & also_lit, change / (2.0 * shift), 0.0)
                dr.eval(slope)
                found.append((name, index, slope))
        return found


def _seen(scene: Any, sensor: Any) -> Float32Array:
    """Points that the camera sees, shape (n, 3)."""
    size = np.array(sensor.film().crop_size(), dtype=np.int64).reshape(2)
    with dr.suspend_grad():
        sampler = sensor.sampler().clone()
        sampler.seed(0, int(np.prod(size)))
        place, aperture = sampler.next_2d(), sampler.next_2d()
        si = scene.ray_intersect(sensor.sample_ray(0.0, 0.5, place, aperture)[0])
        points: Float32Array = np.array(si.p, dtype=np.float64).T[np.array(si.is_valid())]
    return points


def _shift(target: ParameterTarget, light: Any, seen: Float32Array) -> float:
    """How far to either side a parameter is put for the slope of what hides its lamp, in its own unit."""
    if isinstance(target, Rotate):
        return DEGREES
    if isinstance(target, Scale):
        return OF_SCALE
    if isinstance(light, mi.Shape):
        corners = bounding_box(light)
        place, longest = corners.mean(axis=0), float(np.max(np.ptp(corners, axis=0)))
    else:
        place, longest = light_position(light), 0.0
    away = np.linalg.norm(seen - place.reshape(1, 3), axis=1)
    distance = float(np.percentile(away, NEAR)) if away.size else 1.0  # where nothing is seen, nothing is to be found
    return max(OF_LAMP * longest, OF_DISTANCE * distance)


@lru_cache
def _integrator_of(variant: str) -> Any:  # noqa: ARG001 - Mitsuba's classes are those of the variant that is set
    """An integrator of direct light at what the camera sees, by samples of the lights alone."""
    from mitsuba.ad.integrators.common import ADIntegrator

    class FollowsLamps(ADIntegrator):  # type: ignore[misc]  # Mitsuba's integrators have no types
        slopes: tuple[tuple[Any, int, Any], ...] = ()
        lamps: tuple[Any, ...] = ()

        def is_lit(self, si: Any) -> Any:
            """Whether what is hit is lit by a lamp that moves, and is not one: a surface that shines may be lit too."""
            lit = si.is_valid()
            for lamp in self.lamps:
                lit &= si.shape != mi.ShapePtr(lamp)
            return lit

        def visibility(self, scene: Any, sensor: Any, seed: int, samples: int) -> tuple[Any, Any]:
            """Of each sample, whether its point of a lamp can be seen; and whether the camera sees no lamp there."""
            with dr.suspend_grad():
                sampler, _ = self.prepare(sensor, seed, samples, [])
                ray, _, _ = self.sample_rays(scene, sensor, sampler)
                si = scene.ray_intersect(mi.Ray3f(ray))
                lit = self.is_lit(si)
                ds, _ = scene.sample_emitter_direction(si, sampler.next_2d(lit), test_visibility=False, active=lit)
                seen = (ds.pdf != 0.0) & ~scene.ray_test(si.spawn_ray_to(ds.p), lit)
                dr.eval(seen, lit)
            return seen, lit

        def sample(self, *, scene: Any, sampler: Any, ray: Any, **_: Any) -> tuple[Any, ...]:
            """Radiance of each ray; attached to where the lamps are, and to nothing else that moves."""
            with dr.resume_grad():
                with dr.suspend_grad():
                    si = scene.ray_intersect(mi.Ray3f(ray))
                    bsdf = si.bsdf(mi.RayDifferential3f(ray))
                    lit = self.is_lit(si)
                ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(lit), test_visibility=False, active=lit)
                lit &= ds.pdf != 0.0
                with dr.suspend_grad():
                    seen = ~scene.ray_test(si.spawn_ray_to(ds.p), lit)
                share = dr.select(seen, mi.Float(1.0), 0.0)
                for leaf, index, slope in self.slopes:
                    value = dr.gather(mi.Float, leaf, mi.UInt32(index))
                    share += slope * (value - dr.detach(value))
                value = bsdf.eval(mi.BSDFContext(), si, si.to_local(ds.d), lit) * weight
                return dr.select(lit, value * share, 0.0), si.is_valid(), [], None

    return FollowsLamps

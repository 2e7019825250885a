"""Attached surface samples on dielectrics: the gradient of refractions and caustics with respect to moving glass.

Mitsuba's path tracer finds caustics by chance, so that its gradient with respect to the glass is noise. Here each
sample is a fixed point of the glass and moves with it. It is connected to a light, whose refracted light is traced to a
receiver (light tracing), and to the camera, whose refracted view is traced to the surface behind; both are
differentiated. The same contribution without the glass is subtracted. At the silhouette glass does not refract, so that
the difference vanishes there, and no boundary term is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, TypeAlias

import drjit as dr
import mitsuba as mi

from mitsuba_boundaries.attached.binding import Binding
from mitsuba_boundaries.drjit.arrays import Float32Array
from mitsuba_boundaries.geometry.mesh import is_closed
from mitsuba_boundaries.geometry.mesh_checks import is_sharp_edged
from mitsuba_boundaries.sensing.sensor import PerspectiveSensor, make_sampler, ray_epsilon

__all__ = ["AttachedDielectrics", "DielectricSamples", "is_attachable_glass", "is_clear_glass"]

Splats: TypeAlias = Iterable[tuple[Any, Any]]
"""Values of pixels and their film positions."""

MAX_SURFACES: Final = 6  # of a path; it crosses four in two glass balls
PIXEL_SAMPLES: Final = 8  # samples of the image for each sample of a kind here
MIN_SAMPLES: Final = 20_000
MIN_COSINE: Final = 0.01  # below it, the derivative of a refracted direction, unbounded at 0, is left out
ORIGIN_OFFSET: Final = 4.0  # in ray epsilons, from the origin of a ray to the surface that it is to hit first


def is_clear_glass(shape: Any) -> bool:
    """Return whether light passes a shape in single directions."""
    bsdf = shape.bsdf()
    return bsdf is not None and bool(mi.has_flag(bsdf.flags(), mi.BSDFFlags.DeltaTransmission))


def is_attachable_glass(shape: Any, *, rigid: bool) -> bool:
    """Return whether attached samples follow a moving shape: a sphere or smooth mesh of clear glass.

    The refraction of a mesh is continuous only if it is closed and has continuous normals, and its samples follow it
    only as long as it is `rigid`: moved or turned as a whole.
    """
    if not is_clear_glass(shape) or shape.class_name() == "Sphere":
        return is_clear_glass(shape)
    is_smooth = isinstance(shape, mi.Mesh) and shape.has_vertex_normals() and is_closed(shape)
    return rigid and is_smooth and not is_sharp_edged(shape)


class AttachedDielectrics:
    """The gradient of a scene with respect to clear glass that moves.

    It contains direct light that reaches a surface through glass, and the view through glass, with that light. It omits
    light over several surfaces and edges of other shapes seen through glass, and it is wrong where a camera or light is
    inside the glass.

    Parameters
    ----------
    scene : mi.Scene
    sensor : mi.Sensor
    binding : Binding
    samples : int
        Samples per pixel of the image; an eighth of them is traced from lights and from the camera.
    """

    def __init__(self, scene: Any, sensor: Any, binding: Binding, samples: int) -> None:
        self._scene = scene
        self._sensor = sensor
        self._binding = binding
        width, height = map(int, sensor.film().crop_size())
        self._count = max(MIN_SAMPLES, samples * width * height // PIXEL_SAMPLES)

    def vjp(
        self, params: Mapping[str, Any], cotangent: Any, *, names: Iterable[str], seed: int
    ) -> dict[str, Float32Array]:
        """Return the gradients of the parameters `names` for a cotangent of the image, shape (H, W, C)."""
        wrt = tuple(names)
        with self._binding.attached(params, wrt) as leaves:
            DielectricSamples(self._scene, self._sensor).vjp(cotangent, self._count, seed)
            return self._binding.gradients(leaves, wrt)


class DielectricSamples:
    """The contribution of samples on a scene's clear glass to its image, and the gradient of that contribution."""

    def __init__(self, scene: Any, sensor: Any) -> None:
        self._scene = scene
        indices = [index for index, shape in enumerate(scene.shapes()) if is_clear_glass(shape)]
        self._shapes = mi.UInt32(indices)
        self._shape_count = len(indices)
        self._camera = PerspectiveSensor(sensor)

    def image(self, count: int, seed: int) -> Float32Array:
        """Return the image less the image without glass, from `count` samples of each kind: shape (H, W, 3)."""
        with dr.suspend_grad():
            caustic = self._caustic(count, seed)
            views = self._camera.splat(self._views(self._camera.padded_texture(caustic), count, seed))
            return self._camera.crop(caustic + views)

    def vjp(self, cotangent: Any, count: int, seed: int) -> None:
        """Backpropagate a cotangent of the image, shape (H, W, C), to the attached parameters of the scene."""
        with dr.suspend_grad():
            caustic = self._caustic(count, seed)
        image_cotangent = self._camera.padded_cotangent(cotangent)
        dr.enable_grad(caustic)
        self._backpropagate(self._views(self._camera.padded_texture(caustic), count, seed), image_cotangent)
        image_cotangent += dr.grad(caustic)  # the caustic is seen directly, and through glass
        self._backpropagate(self._refracted_light(count, seed), image_cotangent)

    def _caustic(self, count: int, seed: int) -> Any:
        """Return the image of light that glass refracts onto visible surfaces, less the light that it takes away."""
        return self._camera.splat(self._refracted_light(count, seed))

    def _backpropagate(self, splats: Splats, cotangent: Any) -> None:
        texture = self._camera.padded_texture(cotangent)
        for value, position in splats:  # Dr.Jit would evaluate their sum and trace all rays twice
            product = value * self._camera.gather(texture, position)
            dr.set_grad(product, 1.0)
            dr.enqueue(dr.ADMode.Backward, product)
        dr.traverse(dr.ADMode.Backward, dr.ADFlag.ClearInterior)  # keeps edges, because all splats share the scene's

    def _surface_points(self, sampler: Any, count: int) -> tuple[Any, Any]:
        """Return points that are attached to the glass, and the area that each represents."""
        index = dr.minimum(mi.UInt32(sampler.next_1d() * self._shape_count), self._shape_count - 1)
        shape = dr.gather(mi.ShapePtr, self._scene.shapes_dr(), dr.gather(mi.UInt32, self._shapes, index))
        sample = shape.sample_position(0.0, sampler.next_2d())
        point = dr.zeros(mi.SurfaceInteraction3f, count)
        point.p, point.n, point.t = mi.Point3f(sample.p), mi.Normal3f(sample.n), mi.Float(1.0)
        return point, self._shape_count / (sample.pdf * count)

    def _refracted_light(self, count: int, seed: int) -> list[tuple[Any, Any]]:
        """Trace light through glass: splats of the refracted light, and negative ones of the unobstructed light."""
        sampler = make_sampler(seed, count)
        point, area = self._surface_points(sampler, count)
        light, weight = self._scene.sample_emitter_direction(point, sampler.next_2d(), test_visibility=False)
        cosine = dr.dot(point.n, light.d)
        lit = (light.pdf != 0.0) & (cosine > 0.0)
        with dr.suspend_grad():
            lit &= ~self._scene.ray_test(point.spawn_ray_to(light.p), lit)
        ray = _ray_onto(point, light.d)
        power = weight * cosine * area
        receiver, throughput = self._refracted(ray, sampler, lit, mi.TransportMode.Importance)
        unobstructed = self._unobstructed(ray, lit)
        return [self._splat_of(receiver, power * throughput, lit), self._splat_of(unobstructed, -power, lit)]

    def _views(self, caustic: Any, count: int, seed: int) -> list[tuple[Any, Any]]:
        """Trace the camera's view through glass: splats of the refracted less the unobstructed view."""
        sampler = make_sampler(seed + 1, count)
        point, area = self._surface_points(sampler, count)
        to_camera, weight, position, visible = self._camera.project(point.p)
        cosine = dr.dot(point.n, to_camera)
        visible &= cosine > 0.0
        with dr.suspend_grad():
            visible &= ~self._scene.ray_test(point.spawn_ray_to(self._camera.near_clip_point(point.p)), visible)
        ray = _ray_onto(point, to_camera)
        sample = sampler.next_2d()
        surface, throughput = self._refracted(ray, sampler, visible, mi.TransportMode.Radiance)
        refracted = throughput * self._radiance(surface, caustic, sample, visible)
        unobstructed = self._radiance(self._unobstructed(ray, visible), caustic, sample, visible)
        return [(dr.select(visible, weight * cosine * area * (refracted - unobstructed), 0.0), position)]

    def _refracted(self, ray: Any, sampler: Any, active: Any, mode: Any) -> tuple[Any, Any]:
        """Trace a ray through glass to the first other surface; return the hit and the throughput."""
        context = mi.BSDFContext(mode)
        active = mi.Bool(active)
        throughput = mi.Color3f(1.0)
        hit = self._scene.ray_intersect(ray, active)
        for _ in range(MAX_SURFACES - 1):
            active &= hit.is_valid() & _is_clear_at(hit)
            sample, weight = hit.bsdf().sample(context, hit, sampler.next_1d(), sampler.next_2d(), active)
            with dr.suspend_grad():
                steady = active & (dr.abs(hit.wi.z) > MIN_COSINE) & (dr.abs(sample.wo.z) > MIN_COSINE)
            throughput = dr.select(active, throughput * dr.select(steady, weight, dr.detach(weight)), throughput)
            direction = hit.to_world(sample.wo)
            ray = hit.spawn_ray(dr.select(steady, direction, dr.detach(direction)))
            ray.o = dr.replace_grad(ray.o, dr.select(steady, hit.p, dr.detach(hit.p)))
            hit = dr.select(active, self._scene.ray_intersect(ray, active), hit)
        return hit, throughput

    def _unobstructed(self, ray: Any, active: Any) -> Any:
        """Return the first hit of a ray that is not on glass, without refraction."""
        with dr.suspend_grad():
            distance = self._distance_through_glass(dr.detach(ray), active)
        ray = mi.Ray3f(ray.o + distance * ray.d, ray.d)
        return self._scene.ray_intersect(ray, active)

    def _distance_through_glass(self, ray: Any, active: Any) -> Any:
        """Return the distance along a ray beyond which its next hit is not on glass."""

        def step(ray: Any, active: Any, distance: Any, remaining: Any) -> tuple[Any, ...]:
            hit = self._scene.ray_intersect(ray, active)
            active = active & hit.is_valid() & _is_clear_at(hit)
            continued = hit.spawn_ray(ray.d)
            length = dr.dot(continued.o - ray.o, ray.d)
            continued.maxt = ray.maxt - length
            distance = dr.select(active, distance + length, distance)
            return continued, active, distance, remaining - 1

        state = (mi.Ray3f(ray), mi.Bool(active), mi.Float(0.0), mi.UInt32(MAX_SURFACES))
        return dr.while_loop(state, lambda _ray, active, _distance, remaining: active & (remaining > 0), step)[2]

    def _splat_of(self, si: Any, power: Any, active: Any) -> tuple[Any, Any]:
        """Connect light on a surface to the camera, past glass: the pixel value and the film position."""
        active = active & si.is_valid() & ~_is_clear_at(si)
        to_camera, weight, position, visible = self._camera.project(si.p)
        active &= visible & self._is_unoccluded(si, self._camera.near_clip_point(si.p), active)
        context = mi.BSDFContext(mi.TransportMode.Importance)
        value = si.bsdf().eval(context, si, si.to_local(to_camera), active)
        return dr.select(active, power * value * weight, 0.0), position

    def _radiance(self, si: Any, caustic: Any, sample: Any, active: Any) -> Any:
        """Return the emitted radiance of a surface, its reflected direct light, and its reflected `caustic`.

        The caustic is looked up in the image without glass: a diffuse surface looks the same from all directions.
        """
        emitted = dr.select(active, si.emitter(self._scene, active).eval(si, active), 0.0)
        active = active & si.is_valid() & ~_is_clear_at(si)
        light, weight = self._scene.sample_emitter_direction(si, sample, test_visibility=False, active=active)
        lit = active & (light.pdf != 0.0) & self._is_unoccluded(si, light.p, active)
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(light.d), lit)
        to_camera, _, position, visible = self._camera.project(si.p)
        visible = active & visible & (dr.dot(si.n, to_camera) > 0.0)
        visible &= self._is_unoccluded(si, self._camera.near_clip_point(si.p), active)
        reflected_caustic = dr.select(visible, self._camera.gather(caustic, position), 0.0)
        return emitted + dr.select(lit, value * weight, 0.0) + reflected_caustic

    def _is_unoccluded(self, si: Any, point: Any, active: Any) -> Any:
        """Return a mask of surface points with nothing but glass between them and another point."""
        with dr.suspend_grad():
            ray = dr.detach(si.spawn_ray_to(point))
            length = ray.maxt
            distance = self._distance_through_glass(ray, active)
            ray.o += distance * ray.d
            ray.maxt = length - distance
            return ~self._scene.ray_test(ray, active)


def _ray_onto(point: Any, outward: Any) -> Any:
    """Return a ray against `outward` whose first hit is the surface at a point."""
    step = ORIGIN_OFFSET * ray_epsilon(dr.detach(point.p))
    return mi.Ray3f(point.p + step * outward, -outward)


def _is_clear_at(si: Any) -> Any:
    return mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.DeltaTransmission)

"""The gradient by clear glass that moves, from light and from views that are followed through it.

Mitsuba's own path tracer meets what glass throws light on by chance alone, and its gradient by the glass is noise.
Here every sample is a point of the glass that stays there as the glass moves. Light is followed from that point to what
it falls on, and what the camera sees at that point, both with their derivative. From each is taken what would be
there without glass. At its outline glass bends nothing, so that the difference ends there without a step, and no edge
has to be sampled.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import drjit as dr
import mitsuba as mi

from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.geometry.mesh import is_closed
from loi_mitsuba.geometry.mesh_checks import is_sharp_edged
from loi_mitsuba.renderer import MitsubaRenderer, split_seed
from loi_mitsuba.scene.binding import ParameterBinding
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import SceneIndex
from loi_mitsuba.scene.poses import Scale
from loi_mitsuba.scene.queries import has_medium, is_clear_glass
from loi_mitsuba.sensing.sensor import PerspectiveSensor, make_sampler, ray_epsilon

__all__ = ["REASON", "AttachedDielectrics", "Samples", "attachable_dielectrics"]

REASON: Final = "it moves clear glass, and samples of what that bends move with it, but for edges seen through it"
DEPTH: Final = 6  # surfaces of a path, of which two balls of glass are four
SHARE: Final = 8  # samples of the image for one of each kind here
LEAST: Final = 20_000
GRAZING: Final = 0.01  # cosine below which the derivative of a direction, without bound at 0, is left out
LIFT: Final = 4.0  # times as far as Mitsuba lifts rays from surfaces, do rays begin before one that they are to meet


def attachable_dielectrics(called: SceneIndex, targets: Mapping[str, ParameterTarget], sensor: Any) -> dict[str, Any]:
    """The parameters that move clear glass whose light can be followed, each with its shape: balls and smooth meshes.

    None where colours are not red, green and blue, where there is a medium, or where the camera is not a perspective
    one that sees every lamp.
    """
    perspective = sensor.class_name() == "PerspectiveCamera"
    if not mi.is_rgb or mi.is_polarized or not perspective or has_medium(called.scene):
        return {}
    if getattr(called.scene.integrator(), "hide_emitters", False):
        return {}
    found = {}
    for name, target in targets.items():
        if isinstance(target, str):
            entry = called.known(target)
            shape = None if entry is None or entry.problem else called.moved_by(entry)
        else:
            shape = called.find_movable(target.shape)[1]
        if not isinstance(shape, mi.Shape) or shape not in called.scene.shapes() or not is_clear_glass(shape):
            continue
        if shape.class_name() == "Sphere" or (_is_smooth(shape) and not isinstance(target, (str, Scale))):
            found[name] = shape
    return found


class AttachedDielectrics:
    """The gradient of a scene by the clear glass that moves in it.

    It is that of direct light that reaches a surface by way of glass, and of what the camera sees in glass, such light
    included. Light over several surfaces has no part in it, nor have edges of other things that are seen in glass, nor
    has a camera or a lamp that is within glass itself.

    Parameters
    ----------
    renderer : MitsubaRenderer
        Of the scene, whose values are those of the start.
    samples : int
        Per pixel of the image; as many as one to 8 of these are followed each way.
    """

    def __init__(self, renderer: MitsubaRenderer, samples: int) -> None:
        self._renderer = renderer
        width, height = (int(one) for one in renderer.sensor.film().crop_size())
        self._count = max(LEAST, samples * width * height // SHARE)
        self._named = ParameterBinding(renderer.names, renderer.targets, tuple(renderer.targets))

    def vjp(
        self, params: Mapping[str, Any], cotangent: Any, *, names: Iterable[str], seed: int = 0
    ) -> dict[str, Float32Array]:
        """A cotangent of the image, shape (H, W, C), carried to the parameters `names`."""
        wanted = tuple(names)
        with self._named.attached(params, wanted) as leaves:
            samples = Samples(self._renderer.scene, self._renderer.sensor)
            samples.vjp(cotangent, self._count, split_seed(seed)[1])
            return self._named.gradients(leaves, wanted)


class Samples:
    """What samples on the glass of a scene add to its image, and the gradient of that."""

    def __init__(self, scene: Any, sensor: Any) -> None:
        self._scene = scene
        glass = [index for index, shape in enumerate(scene.shapes()) if is_clear_glass(shape)]
        self._glass = mi.UInt32(glass)
        self._kinds = len(glass)
        self._eye = PerspectiveSensor(sensor)

    def image(self, count: int, seed: int) -> Float32Array:
        """What they add, by `count` samples each way: the image less that without glass, shape (H, W, 3)."""
        with dr.suspend_grad():
            light = self._thrown(count, seed)
            return self._eye.crop(light + self._eye.splat(self._views(self._eye.padded_texture(light), count, seed)))

    def vjp(self, cotangent: Any, count: int, seed: int) -> None:
        """Carry a cotangent of the image by `count` samples each way to whatever of the scene has a gradient."""
        with dr.suspend_grad():
            light = self._thrown(count, seed)
        wanted = self._eye.padded_cotangent(cotangent)
        dr.enable_grad(light)
        self._back(self._views(self._eye.padded_texture(light), count, seed), wanted)
        wanted += dr.grad(light)  # light is seen past glass, and by way of glass
        self._back(self._light(count, seed), wanted)

    def _thrown(self, count: int, seed: int) -> Any:
        """The light that glass throws on what the camera sees, less what it takes."""
        return self._eye.splat(self._light(count, seed))

    def _back(self, values: Iterable[tuple[Any, Any]], cotangent: Any) -> None:
        """Carry back a cotangent of an image to values at their places."""
        texture = self._eye.padded_texture(cotangent)
        for value, place in values:  # not as their sum, which Dr.Jit would evaluate, and so trace all rays twice
            product = value * self._eye.gather(texture, place)
            dr.set_grad(product, 1.0)
            dr.enqueue(dr.ADMode.Backward, product)
        dr.traverse(dr.ADMode.Backward, dr.ADFlag.ClearInterior)  # edges stay, for all ways share those of the scene

    def _points(self, sampler: Any, count: int) -> tuple[Any, Any]:
        """Points of the glass, attached to it, and the area that each stands for."""
        index = dr.minimum(mi.UInt32(sampler.next_1d() * self._kinds), self._kinds - 1)
        shape = dr.gather(mi.ShapePtr, self._scene.shapes_dr(), dr.gather(mi.UInt32, self._glass, index))
        sample = shape.sample_position(0.0, sampler.next_2d())
        point = dr.zeros(mi.SurfaceInteraction3f, count)
        point.p, point.n, point.t = mi.Point3f(sample.p), mi.Normal3f(sample.n), mi.Float(1.0)
        return point, self._kinds / (sample.pdf * count)

    def _light(self, count: int, seed: int) -> list[tuple[Any, Any]]:
        """Light of the lamps that passes glass, where it falls, less where it would: values in pixels, and places."""
        sampler = make_sampler(seed, count)
        point, area = self._points(sampler, count)
        lamp, weight = self._scene.sample_emitter_direction(point, sampler.next_2d(), test_visibility=False)
        cosine = dr.dot(point.n, lamp.d)
        lit = (lamp.pdf != 0.0) & (cosine > 0.0)
        with dr.suspend_grad():
            lit &= ~self._scene.ray_test(point.spawn_ray_to(lamp.p), lit)
        start = _before(point, lamp.d)
        power = weight * cosine * area
        fallen, share = self._bent(start, sampler, lit, mi.TransportMode.Importance)
        return [self._shown(fallen, power * share, lit), self._shown(self._straight(start, lit), -power, lit)]

    def _views(self, light: Any, count: int, seed: int) -> list[tuple[Any, Any]]:
        """What the camera sees in glass, less what it would see there: values in pixels, and places."""
        sampler = make_sampler(seed + 1, count)
        point, area = self._points(sampler, count)
        along, weight, place, visible = self._eye.project(point.p)
        cosine = dr.dot(point.n, along)
        visible &= cosine > 0.0
        with dr.suspend_grad():
            visible &= ~self._scene.ray_test(point.spawn_ray_to(self._eye.near_clip_point(point.p)), visible)
        start = _before(point, along)
        number = sampler.next_2d()
        shown, share = self._bent(start, sampler, visible, mi.TransportMode.Radiance)
        bent = share * self._lit(shown, light, number, visible)
        straight = self._lit(self._straight(start, visible), light, number, visible)
        return [(dr.select(visible, weight * cosine * area * (bent - straight), 0.0), place)]

    def _bent(self, ray: Any, sampler: Any, active: Any, mode: Any) -> tuple[Any, Any]:
        """What a ray meets first that is not glass, on its way through glass; and what is left of it there."""
        context = mi.BSDFContext(mode)
        active = mi.Bool(active)
        share = mi.Color3f(1.0)
        met = self._scene.ray_intersect(ray, active)
        for _ in range(DEPTH - 1):
            active &= met.is_valid() & _clear_at(met)
            sample, weight = met.bsdf().sample(context, met, sampler.next_1d(), sampler.next_2d(), active)
            with dr.suspend_grad():
                steady = active & (dr.abs(met.wi.z) > GRAZING) & (dr.abs(sample.wo.z) > GRAZING)
            share = dr.select(active, share * dr.select(steady, weight, dr.detach(weight)), share)
            along = met.to_world(sample.wo)
            ray = met.spawn_ray(dr.select(steady, along, dr.detach(along)))
            ray.o = dr.replace_grad(ray.o, dr.select(steady, met.p, dr.detach(met.p)))
            met = dr.select(active, self._scene.ray_intersect(ray, active), met)
        return met, share

    def _straight(self, ray: Any, active: Any) -> Any:
        """What a ray meets first that is not glass."""
        with dr.suspend_grad():
            passed = self._passed(dr.detach(ray), active)
        ray = mi.Ray3f(ray.o + passed * ray.d, ray.d)
        return self._scene.ray_intersect(ray, active)

    def _passed(self, ray: Any, active: Any) -> Any:
        """How far a ray goes through glass, until there is none before what it meets next."""

        def on(ray: Any, active: Any, passed: Any, left: Any) -> tuple[Any, ...]:
            met = self._scene.ray_intersect(ray, active)
            active = active & met.is_valid() & _clear_at(met)
            further = met.spawn_ray(ray.d)
            step = dr.dot(further.o - ray.o, ray.d)
            further.maxt = ray.maxt - step
            passed = dr.select(active, passed + step, passed)
            return further, active, passed, left - 1

        state = (mi.Ray3f(ray), mi.Bool(active), mi.Float(0.0), mi.UInt32(DEPTH))
        return dr.while_loop(state, lambda _ray, active, _passed, left: active & (left > 0), on)[2]

    def _shown(self, si: Any, power: Any, active: Any) -> tuple[Any, Any]:
        """Of light that falls on a surface, what the camera sees of it past glass, and its place."""
        active = active & si.is_valid() & ~_clear_at(si)
        along, weight, place, visible = self._eye.project(si.p)
        active &= visible & self._is_open(si, self._eye.near_clip_point(si.p), active)
        context = mi.BSDFContext(mi.TransportMode.Importance)
        value = si.bsdf().eval(context, si, si.to_local(along), active)
        return dr.select(active, power * value * weight, 0.0), place

    def _lit(self, si: Any, light: Any, number: Any, active: Any) -> Any:
        """What a surface emits, and shows of the lamps, and of the `light` that glass throws on it.

        The latter is as the camera sees it without glass, for a diffuse surface shows the same to all sides.
        """
        emitted = dr.select(active, si.emitter(self._scene, active).eval(si, active), 0.0)
        active = active & si.is_valid() & ~_clear_at(si)
        lamp, weight = self._scene.sample_emitter_direction(si, number, test_visibility=False, active=active)
        lit = active & (lamp.pdf != 0.0) & self._is_open(si, lamp.p, active)
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(lamp.d), lit)
        along, _, place, visible = self._eye.project(si.p)
        shown = (
            active & visible & (dr.dot(si.n, along) > 0.0) & self._is_open(si, self._eye.near_clip_point(si.p), active)
        )
        thrown = dr.select(shown, self._eye.gather(light, place), 0.0)
        return emitted + dr.select(lit, value * weight, 0.0) + thrown

    def _is_open(self, si: Any, place: Any, active: Any) -> Any:
        """Whether nothing but glass lies between a surface and a place."""
        with dr.suspend_grad():
            ray = dr.detach(si.spawn_ray_to(place))
            whole = ray.maxt
            passed = self._passed(ray, active)
            ray.o += passed * ray.d
            ray.maxt = whole - passed
            return ~self._scene.ray_test(ray, active)


def _before(point: Any, away: Any) -> Any:
    """A ray that comes from where `away` points to, and meets next the surface at a point of it."""
    step = LIFT * ray_epsilon(dr.detach(point.p))
    return mi.Ray3f(point.p + step * away, -away)


def _clear_at(si: Any) -> Any:
    return mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.DeltaTransmission)


def _is_smooth(shape: Any) -> bool:
    """Whether a mesh is closed, with one normal where its triangles meet: what it bends has no steps then."""
    return isinstance(shape, mi.Mesh) and shape.has_vertex_normals() and is_closed(shape) and not is_sharp_edged(shape)

"""The boundary term of shadows that fall on moving shapes, and of all shadows under delta lights.

Projective sampling follows the silhouettes of moving shapes, and thereby the shadows that they cast, unless the light
is a point, spot or directional one, which no ray hits. A shape that moves under an occluder, or has components that
shadow each other, also moves through shadows. The edges of these shadows are searched for along segments of the image:
for light from one random point of an emitter, one end is lit and the other is not. The plane of light rays that graze
the occluder contains the shadow edge. The motion of the receiver through this plane, and that of the plane with the
occluder, give the velocity of the edge in the image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import drjit as dr
import mitsuba as mi

from mitsuba_boundaries.area_jacobian import MIN_COSINE
from mitsuba_boundaries.drjit.ragged import RaggedTable, hit_shape_index, shape_index
from mitsuba_boundaries.plugins.proxy_emitter import hittable_proxy_emitters
from mitsuba_boundaries.segments import DIFFERENCE_STEP_PX, SegmentSampler, bisect
from mitsuba_boundaries.sensing.film_samples import to_rgb
from mitsuba_boundaries.sensing.sensor import make_sampler, ray_epsilon, supports_boundary_sampling

__all__ = ["ReceivedShadowBoundary"]

TANGENT_STEP_PX: Final = 0.05  # between the two points of a shadow edge that give its direction
SEARCH_RADIUS_PX: Final = 0.06  # of the search for the second of them
SILHOUETTE_MARGIN_PX: Final = 0.01  # from a silhouette, where rounding makes rays hit the unlit back of closed shapes
SHADOW_MARGIN_PX: Final = 1e-3  # from a shadow's edge, where rounding makes rays miss the occluder that they graze
MIN_LIGHT_COSINE: Final = 1e-3  # at smaller ones a surface may shadow itself, because rays are spawned off surfaces
MAX_HIT_DISTANCE_PX: Final = 0.05  # between the ends of a bisected segment; larger ones have a jump in depth
MIN_RELATIVE_SPEED: Final = 1e-3  # of the surface point across the grazing plane, relative to its whole speed

_Predicate = Callable[[Any], Callable[[Any], Any]]  # maps indices of segments to a predicate of positions on them


@dataclass(frozen=True)
class _EmitterSample:
    """One point of an emitter for each segment.

    Attributes
    ----------
    p : mi.Point3f
        Position.
    n : mi.Normal3f
        Normal of the emitter's surface.
    d : mi.Vector3f
        Direction to an infinitely distant emitter.
    is_infinite : mi.Bool
    is_surface : mi.Bool
        Whether the emitter is an area light, whose solid angle depends on its orientation.
    weight : mi.Color3f
        Radiance over the sampling density, per area of a surface or per solid angle.
    emitter : mi.EmitterPtr
    """

    p: Any
    n: Any
    d: Any
    is_infinite: Any
    is_surface: Any
    weight: Any
    emitter: Any

    @classmethod
    def sample(cls, emitters: Any, si: Any, uv: Any) -> _EmitterSample:
        """Sample one of `emitters`, mi.EmitterPtr, for each surface interaction, without testing for occluders."""
        count = dr.opaque(mi.UInt32, dr.width(emitters))
        index = dr.minimum(mi.UInt32(uv.x * count), count - 1)
        chosen = dr.gather(mi.EmitterPtr, emitters, index)
        ds, weight = chosen.sample_direction(si, mi.Point2f(uv.x * count - index, uv.y), si.is_valid())
        weight = dr.select(ds.pdf > 0.0, mi.Float(count) * to_rgb(weight), 0.0)
        flags = chosen.flags()
        is_infinite, is_surface = (
            mi.has_flag(flags, flag) for flag in (mi.EmitterFlags.Infinite, mi.EmitterFlags.Surface)
        )
        emitter = cls(ds.p, ds.n, ds.d, is_infinite, is_surface, weight, chosen)
        # The other points of the segment may see the emitter at a much larger cosine than this one.
        jacobian = emitter._area_jacobian(si.p, MIN_COSINE)
        return replace(emitter, weight=weight * dr.select(emitter._area_jacobian(si.p) > 0.0, dr.rcp(jacobian), 0.0))

    def gather(self, index: Any) -> _EmitterSample:
        """Return the samples of some segments."""
        arrays = (getattr(self, field.name) for field in fields(self))
        return _EmitterSample(*(dr.gather(type(array), array, index) for array in arrays))

    def unoccluded(self, point: Any) -> Any:
        """Return the incident light, mi.Color3f, at points without occluders; of emitters that are not delta lights."""
        return self.weight * self._area_jacobian(point)

    def _area_jacobian(self, point: Any, min_cosine: float = 0.0) -> Any:
        """Return the solid angle per area of the emitter, seen from points; 1 for emitters without a surface."""
        direction, distance = self.direction(point)
        cosine = dr.maximum(-dr.dot(self.n, direction), min_cosine)
        return dr.select(self.is_surface, cosine / dr.square(distance), 1.0)

    def direction(self, point: Any) -> tuple[Any, Any]:
        """Return the unit direction and distance from points to the emitter."""
        return self._direction_to(self.p, point)

    def spawned_direction(self, point: Any) -> tuple[Any, Any]:
        """Return the same to a position just off the emitter, which rounding errors do not hide at grazing angles."""
        return self._direction_to(dr.select(self.is_surface, self.p + ray_epsilon(self.p) * self.n, self.p), point)

    def _direction_to(self, position: Any, point: Any) -> tuple[Any, Any]:
        offset = position - point
        distance = dr.norm(offset)
        return (
            dr.select(self.is_infinite, self.d, offset / distance),
            dr.select(self.is_infinite, dr.largest(mi.Float), distance),
        )


@dataclass(frozen=True)
class _ShadowCrossing:
    """Segments that see one shape, lit at one end and not at the other.

    Attributes
    ----------
    first, second : mi.Point2f
        Ends, in pixels.
    direction : mi.Vector2f
    is_first_lit : mi.Bool
    weight : mi.Float
        Number of segments that each one counts for.
    emitter : _EmitterSample
    """

    first: Any
    second: Any
    direction: Any
    is_first_lit: Any
    weight: Any
    emitter: _EmitterSample


class ReceivedShadowBoundary:
    """The edges of shadows that fall on visible shapes.

    Parameters
    ----------
    sensor : mi.Sensor
        A perspective camera.
    receivers : list of mi.Shape
    emitters : list of mi.Emitter
        Either all delta lights, or none. With delta lights, the motion of the occluders counts as well.
    """

    def __init__(self, sensor: Any, receivers: list[Any], emitters: list[Any]) -> None:
        self._segments = SegmentSampler(sensor)
        self._receivers = receivers
        self._receiver_table = RaggedTable({shape_index(shape): 1 for shape in receivers})
        self._emitters = mi.EmitterPtr(emitters)
        self._is_delta = _is_delta(emitters[0])

    @classmethod
    def from_scene(cls, scene: Any, sensor: Any, shapes: Iterable[Any]) -> list[ReceivedShadowBoundary]:
        """Build for the moving `shapes` under area lights, and for all shapes under delta lights.

        Empty without moving shapes, or without support for boundary sampling.
        """
        in_scene = scene.shapes()
        moving = [shape for shape in dict.fromkeys(shapes) if shape in in_scene]
        if not moving or not supports_boundary_sampling(scene, sensor):
            return []
        delta = [emitter for emitter in scene.emitters() if _is_delta(emitter)]
        others = [emitter for emitter in scene.emitters() if not _is_delta(emitter)]
        receivers = ((moving, others), (in_scene, delta))
        return [cls(sensor, shapes, emitters) for shapes, emitters in receivers if emitters]

    @hittable_proxy_emitters()
    def sample(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any] | None:  # noqa: ARG002
        """Sample the shadow edges of direct light; see :class:`mitsuba_boundaries.terms.BoundarySampler`.

        `integrator` is not used.
        """
        with dr.suspend_grad():
            crossing = self._find_crossings(scene, samples, seed)
            if crossing is None:
                return None
            direction, emitter, is_first_lit = crossing.direction, crossing.emitter, crossing.is_first_lit
            first, second = self._bisect_shadow(scene, crossing.first, crossing.second, emitter, is_first_lit)
            position = dr.lerp(first, second, 0.5)
            next_position, active = self._next_edge_point(scene, position, direction, emitter, is_first_lit)
            ray = self._segments.ray(position)
            hit = scene.ray_intersect(ray)
            active &= self._is_smooth(scene, first, second, hit, emitter)
            edge = self._on_tangent_plane(hit, next_position) - hit.p
            step = DIFFERENCE_STEP_PX * direction
            forward, backward = (
                self._on_tangent_plane(hit, position + step),
                self._on_tangent_plane(hit, position - step),
            )
            surface_velocity = (forward - backward) / (2.0 * DIFFERENCE_STEP_PX)  # per pixel
            to_emitter, distance = emitter.direction(hit.p)
            grazing_normal = dr.normalize(dr.cross(to_emitter, edge))  # of the plane of rays that graze the occluder
            speed = dr.dot(grazing_normal, surface_velocity)
            active &= dr.abs(speed) > MIN_RELATIVE_SPEED * dr.norm(surface_velocity)
            bsdf_value = hit.bsdf().eval(mi.BSDFContext(), hit, hit.to_local(to_emitter), active)
            radiance = self._unoccluded(hit, emitter) * to_rgb(bsdf_value)
            difference = dr.select(is_first_lit, radiance, -radiance) * crossing.weight
            difference = dr.select(active, self._segments.average(difference, samples), 0.0)
            margin = SHADOW_MARGIN_PX * direction
            shadow_ray = self._shadow_ray(scene, dr.select(is_first_lit, second + margin, first - margin), emitter)
        receiver, occluder = _motions(scene, ray, shadow_ray) if self._is_delta else (_motions(scene, ray)[0], None)
        with dr.suspend_grad():
            # At a fixed position of the image, the visible point of the receiver moves along the camera ray.
            along_ray = hit.n * dr.dot(grazing_normal, ray.d) / dr.dot(hit.n, ray.d)
            scale = dr.select(active, -dr.rcp(speed), 0.0)
        displacement = dr.dot(along_ray, receiver.displacement)
        if occluder is not None:
            with dr.suspend_grad():
                # Light rays diverge from a position, and are parallel from a direction.
                magnification = dr.select(emitter.is_infinite, 1.0, distance / dr.norm(emitter.p - occluder.p))
            displacement -= magnification * dr.dot(grazing_normal, occluder.displacement)
        return difference * dr.select(active, scale * displacement, 0.0), position / self._segments.size

    def _find_crossings(self, scene: Any, samples: int, seed: int) -> _ShadowCrossing | None:
        """Return the segments with one end in a shadow."""
        # The shadow of a moving shape under a delta light may fall anywhere.
        pixels = None if self._is_delta else self._segments.pixels_covering(self._receivers)
        if pixels is not None and dr.width(pixels) == 0:
            return None
        first, second, direction = self._segments.sample(scene, samples, seed, pixels)
        first_shape, second_shape = (
            self._segments.visible_shape(scene, first),
            self._segments.visible_shape(scene, second),
        )
        # A segment that sees two receivers is assigned to either with probability one half.
        sees_two = self._is_receiver(first_shape) & self._is_receiver(second_shape) & (first_shape != second_shape)
        coin = make_sampler(seed + 1, dr.width(first_shape)).next_1d() < 0.5
        at_second = ~self._is_receiver(first_shape) | (sees_two & coin)
        shape = dr.select(at_second, second_shape, first_shape)
        index = dr.compress(self._is_receiver(shape))
        if dr.width(index) == 0:
            return None
        weight = dr.select(sees_two, 2.0, 1.0)
        sees_one = first_shape == second_shape
        first, second, direction, at_second, shape, weight, sees_one = (
            dr.gather(type(array), array, index)
            for array in (first, second, direction, at_second, shape, weight, sees_one)
        )
        first, second = self._clip(first, second, at_second, dr.compress(~sees_one), self._sees(scene, shape))
        sampler = make_sampler(seed + 2, dr.width(first))
        si = scene.ray_intersect(self._segments.ray(first))
        emitter = _EmitterSample.sample(self._emitters, si, sampler.next_2d())
        second_si = scene.ray_intersect(self._segments.ray(second))
        # A surface that turns away from the light has no shadow edge there: no light is lost.
        first_faces, second_faces = self._faces(si, emitter), self._faces(second_si, emitter)
        index = dr.compress((dr.max(emitter.weight) > 0.0) & (first_faces | second_faces))
        if dr.width(index) == 0:
            return None
        first, second, direction, weight, first_faces, second_faces = (
            dr.gather(type(array), array, index)
            for array in (first, second, direction, weight, first_faces, second_faces)
        )
        emitter = emitter.gather(index)
        partial = dr.compress(first_faces != second_faces)
        first, second = self._clip(first, second, second_faces, partial, self._faces_emitter(scene, emitter))
        is_first_lit = self._is_lit_at(scene, first, emitter)
        index = dr.compress(is_first_lit != self._is_lit_at(scene, second, emitter))
        if dr.width(index) == 0:
            return None
        first, second, direction, is_first_lit, weight = (
            dr.gather(type(array), array, index) for array in (first, second, direction, is_first_lit, weight)
        )
        return _ShadowCrossing(first, second, direction, is_first_lit, weight, emitter.gather(index))

    def _clip(self, first: Any, second: Any, at_second: Any, index: Any, predicate: _Predicate) -> tuple[Any, Any]:
        """Clip some segments to where a predicate holds, less SILHOUETTE_MARGIN_PX.

        It holds at one end of the segments `index`: at the second end where `at_second` is set.
        """
        if dr.width(index) == 0:
            return first, second
        is_second = dr.gather(mi.Bool, at_second, index)
        begin, stop = (dr.gather(type(position), position, index) for position in (first, second))
        start, outside = dr.select(is_second, stop, begin), dr.select(is_second, begin, stop)
        inside, _ = bisect(start, outside, predicate(index))
        margin = SILHOUETTE_MARGIN_PX / dr.maximum(dr.norm(start - inside), SILHOUETTE_MARGIN_PX)
        inside = dr.lerp(inside, start, margin)
        first, second = mi.Point2f(first), mi.Point2f(second)
        dr.scatter(first, dr.select(is_second, inside, begin), index)
        dr.scatter(second, dr.select(is_second, stop, inside), index)
        return first, second

    def _sees(self, scene: Any, shape: Any) -> _Predicate:
        """Return the predicate that positions on segments see the segment's shape."""

        def for_segments(index: Any) -> Callable[[Any], Any]:
            expected = dr.gather(mi.UInt32, shape, index)
            return lambda position: self._segments.visible_shape(scene, position) == expected

        return for_segments

    def _faces_emitter(self, scene: Any, emitter: _EmitterSample) -> _Predicate:
        """Return the predicate that the surface at positions on segments faces the segment's emitter sample."""

        def for_segments(index: Any) -> Callable[[Any], Any]:
            gathered = emitter.gather(index)
            return lambda position: self._faces(scene.ray_intersect(self._segments.ray(position)), gathered)

        return for_segments

    def _bisect_shadow(
        self, scene: Any, first: Any, second: Any, emitter: _EmitterSample, is_first_lit: Any
    ) -> tuple[Any, Any]:
        """Bisect segments for the boundary between lit and unlit."""
        return bisect(first, second, lambda position: self._is_lit_at(scene, position, emitter) == is_first_lit)

    def _next_edge_point(
        self, scene: Any, position: Any, direction: Any, emitter: _EmitterSample, is_first_lit: Any
    ) -> tuple[Any, Any]:
        """Return a second point of each shadow edge, and whether there is one at less than 45 degrees to the normal."""
        step = TANGENT_STEP_PX * mi.Vector2f(direction.y, direction.x)
        is_found = dr.zeros(mi.Bool)
        first, second = mi.Point2f(position), mi.Point2f(position)
        for offset in (step, -step):  # the edge may end on one side
            begin = position + offset - SEARCH_RADIUS_PX * direction
            stop = position + offset + SEARCH_RADIUS_PX * direction
            brackets = (
                ~is_found
                & (self._is_lit_at(scene, begin, emitter) == is_first_lit)
                & (self._is_lit_at(scene, stop, emitter) != is_first_lit)
            )
            first, second = dr.select(brackets, begin, first), dr.select(brackets, stop, second)
            is_found |= brackets
            dr.eval(first, second, is_found)
        first, second = self._bisect_shadow(scene, first, second, emitter, is_first_lit)
        next_position = dr.lerp(first, second, 0.5)
        shape = self._segments.visible_shape(scene, position)  # beyond its silhouette, another shape may be lit
        is_found &= (self._segments.visible_shape(scene, first) == shape) & (
            self._segments.visible_shape(scene, second) == shape
        )
        # Segments of one direction count edges within 45 degrees of their normal, so that each edge counts once.
        return next_position, is_found & (dr.abs(dr.dot(next_position - position, direction)) <= TANGENT_STEP_PX)

    def _is_smooth(self, scene: Any, first: Any, second: Any, hit: Any, emitter: _EmitterSample) -> Any:
        """Return whether both ends of a bisected segment see one surface without a jump in depth, facing the light."""
        end_hits = [scene.ray_intersect(self._segments.ray(position)) for position in (first, second)]
        is_smooth = dr.ones(mi.Bool)
        for end_hit in end_hits:
            is_smooth &= (hit_shape_index(end_hit) == hit_shape_index(hit)) & self._faces(end_hit, emitter)
        shifted = first + mi.Vector2f(MAX_HIT_DISTANCE_PX, 0.0)
        max_distance = dr.norm(self._on_tangent_plane(hit, shifted) - self._on_tangent_plane(hit, first))
        return is_smooth & (dr.norm(end_hits[1].p - end_hits[0].p) < max_distance)

    def _on_tangent_plane(self, hit: Any, position: Any) -> Any:
        """Return where the rays through positions in pixels intersect the tangent plane of a hit."""
        ray = self._segments.ray(position)
        return ray.o + ray.d * (dr.dot(hit.p - ray.o, hit.n) / dr.dot(ray.d, hit.n))

    def _is_lit_at(self, scene: Any, position: Any, emitter: _EmitterSample) -> Any:
        """Return whether the emitter sample lights the surface that is visible at positions in pixels."""
        return ~scene.ray_test(self._shadow_ray(scene, position, emitter))

    def _unoccluded(self, si: Any, emitter: _EmitterSample) -> Any:
        """Return the incident light, mi.Color3f, at surface interactions without occluders."""
        if not self._is_delta:
            return emitter.unoccluded(si.p)
        _, weight = emitter.emitter.sample_direction(si, mi.Point2f(0.5))  # which delta lights do not use
        return dr.opaque(mi.Float, dr.width(self._emitters)) * to_rgb(weight)

    def _shadow_ray(self, scene: Any, position: Any, emitter: _EmitterSample) -> Any:
        """Return the ray to the emitter sample from the surface that is visible at positions in pixels."""
        si = scene.ray_intersect(self._segments.ray(position))
        to_emitter, distance = emitter.spawned_direction(si.p)
        ray = si.spawn_ray(to_emitter)
        ray.maxt = dr.select(emitter.is_infinite, distance, distance * (1.0 - mi.math.ShadowEpsilon))
        ray.maxt = dr.select(si.is_valid(), ray.maxt, 0.0)  # which hits nothing
        return ray

    def _is_receiver(self, shape: Any) -> Any:
        """Return a mask of the shape indices that are receivers."""
        return self._receiver_table.first_row(shape)[1]

    @staticmethod
    def _faces(si: Any, emitter: _EmitterSample) -> Any:
        """Return whether the surface faces the emitter sample on the side that the camera ray came from."""
        to_emitter, _ = emitter.direction(si.p)
        orientation = dr.sign(dr.dot(si.n, si.to_world(si.wi)))
        return dr.dot(si.n, to_emitter) * orientation > MIN_LIGHT_COSINE


@dataclass(frozen=True)
class _Motion:
    """The surface points that rays hit.

    Attributes
    ----------
    p : mi.Point3f
        Detached.
    displacement : mi.Vector3f
        Zero, with the velocity of the material point as its derivative.
    """

    p: Any
    displacement: Any


def _motions(scene: Any, *rays: Any) -> list[_Motion]:
    """Return the motions of the points that several arrays of rays hit, all of the same width.

    All are found by one call: Dr.Jit propagates no forward gradient through two calls on one shape.
    """
    width = dr.width(rays[0])
    ray = (
        rays[0]
        if len(rays) == 1
        else mi.Ray3f(
            *(
                type(components[0])(*(dr.concat(list(axes)) for axes in zip(*components, strict=True)))
                for components in zip(*((ray.o, ray.d) for ray in rays), strict=True)
            )
        )
    )
    si = scene.ray_intersect(ray, ray_flags=mi.RayFlags.Minimal | mi.RayFlags.FollowShape, coherent=False)
    displacement = dr.select(si.is_valid(), si.p - dr.detach(si.p), 0.0)
    count = dr.opaque(mi.UInt32, width)  # a literal would be compiled into kernels
    slices = [dr.arange(mi.UInt32, width) + k * count for k in range(len(rays))]
    return [
        _Motion(
            dr.gather(mi.Point3f, dr.detach(si.p), rows),
            dr.gather(type(displacement), displacement, rows, mode=dr.ReduceMode.NoConflicts),
        )
        for rows in slices
    ]


def _is_delta(emitter: Any) -> bool:
    return bool(mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta))

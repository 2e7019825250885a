"""The boundary term of visible intersection curves of interpenetrating shapes.

Radiance is discontinuous along the curve where a half-sunk ball meets the floor, and the curve moves with the ball. It
is no silhouette, so projective sampling does not find it. Here it is searched for along segments of the image. Where
a segment crosses from one shape to another, and each continues behind the other, the difference of the two depths is an
implicit function whose root gives the velocity of the curve.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.geometry.bounds import bounding_box
from mitsuba_boundaries.geometry.components import ComponentIds
from mitsuba_boundaries.segments import DIFFERENCE_STEP_PX, SegmentSampler, bisect
from mitsuba_boundaries.sensing.sensor import (
    DEPTH_TOLERANCE,
    make_sampler,
    radiance_difference,
    ray_epsilon,
    supports_boundary_sampling,
)

__all__ = ["IntersectionBoundary"]

MAX_DEPTH_GAP_PX: Final = 0.05  # pixels from a crossing to where the tangent planes of the two shapes intersect
OFFSET_RANGE_PX: Final = (0.0125, 0.05)  # pixels from a crossing to the rays on its two sides
OFFSET_EPSILONS: Final = 4.0  # ray epsilons of the surface, within that range
DEPTH_MARGIN: Final = 0.5  # fraction of the depth between two planes within which the hidden shape is searched for


@dataclass(frozen=True)
class _Hit:
    """Camera hits at the ends of segments.

    Attributes
    ----------
    t : mi.Float
        Distance along the ray, attached to the motion of the shape.
    p : mi.Point3f
        Detached.
    n : mi.Normal3f
        Geometric normal, detached.
    shape : mi.UInt32
        Id of the shape or of the mesh's component; 0 for none.
    """

    t: Any
    p: Any
    n: Any
    shape: Any


class IntersectionBoundary:
    """The visible intersection curves of moving shapes with each other, with other shapes and with themselves.

    Parameters
    ----------
    sensor : mi.Sensor
        A perspective camera.
    shapes : list of mi.Shape
        The moving shapes.
    component_ids : ComponentIds
        Of all shapes of the scene.
    """

    def __init__(self, sensor: Any, shapes: list[Any], component_ids: ComponentIds) -> None:
        self._sensor = sensor
        self._shapes = shapes
        self._component_ids = component_ids
        self._segments = SegmentSampler(sensor)

    @classmethod
    def from_scene(cls, scene: Any, sensor: Any, shapes: Iterable[Any]) -> IntersectionBoundary | None:
        """Build for the moving `shapes`; None if nothing can intersect, or without support for boundary sampling."""
        in_scene = scene.shapes()
        moving = [shape for shape in dict.fromkeys(shapes) if shape in in_scene]
        if not moving or not supports_boundary_sampling(scene, sensor):
            return None
        component_ids = ComponentIds(in_scene, moving)
        return cls(sensor, moving, component_ids) if len(in_scene) > 1 or component_ids.may_intersect else None

    def sample(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any] | None:
        """Sample the curves; see :class:`mitsuba_boundaries.terms.BoundarySampler`."""
        if not self._bounds_overlap(scene):
            return None
        with dr.suspend_grad():
            crossings = self._find_crossings(scene, samples, seed)
            if crossings is None:
                return None
            first, second, direction = crossings
            shape = self._visible_id(scene, first)
            first, second = bisect(first, second, lambda position: self._visible_id(scene, position) == shape)
        front, rear = self._hits(scene, first, second)
        with dr.suspend_grad():
            crossing = dr.lerp(first, second, 0.5)
            slope, active = self._depth_slope(scene, front, rear, crossing, direction)
            count = dr.width(crossing)
            offset = self._offset_px(front, crossing) * direction
            active &= self._is_visible(scene, front, rear, crossing, offset)
            # Under a shape that bulges over the curve, radiance grows with the square root of the distance: it doubles
            # at four times the offset. Extrapolate to offset 0, unless the far offset is beyond another silhouette.
            near_difference, far_difference = (
                radiance_difference(
                    self._sensor,
                    integrator,
                    scene,
                    ((crossing - step) / self._segments.size, (crossing + step) / self._segments.size),
                    active,
                    make_sampler(seed + 1, count),
                )
                for step in (offset, 4.0 * offset)
            )
            can_extrapolate = self._is_visible(scene, front, rear, crossing, 4.0 * offset)
            difference = dr.select(can_extrapolate, 2.0 * near_difference - far_difference, near_difference)
        gap = front.t - rear.t
        displacement = dr.select(active, -(gap - dr.detach(gap)) / slope, 0.0)
        value = dr.select(active, self._segments.average(-difference, samples), 0.0) * displacement
        return value, crossing / self._segments.size

    def _bounds_overlap(self, scene: Any) -> bool:
        """Return whether the bounding box of a moving shape overlaps another, or its own components may intersect."""
        if self._component_ids.may_intersect:
            return True
        shapes = scene.shapes()
        lower, upper = np.stack([bounding_box(shape) for shape in shapes], axis=1)
        moving = [shapes.index(shape) for shape in self._shapes]
        overlap = np.all((lower[moving, None] <= upper) & (lower <= upper[moving, None]), axis=-1)
        overlap[np.arange(len(moving)), moving] = False
        return bool(np.any(overlap))

    def _find_crossings(self, scene: Any, samples: int, seed: int) -> tuple[Any, Any, Any] | None:
        """Return the segments whose ends see two shapes: ends in pixels, and directions."""
        first, second, direction = self._segments.sample(scene, samples, seed)
        first_id, second_id = self._visible_id(scene, first), self._visible_id(scene, second)
        index = dr.compress((first_id != 0) & (second_id != 0) & (first_id != second_id))
        if dr.width(index) == 0:
            return None
        return tuple(dr.gather(type(array), array, index) for array in (first, second, direction))

    def _depth_slope(self, scene: Any, front: _Hit, rear: _Hit, crossing: Any, direction: Any) -> tuple[Any, Any]:
        """Return the derivative per pixel of the first shape's depth behind the second, and a mask of intersections."""
        perpendicular = mi.Vector2f(direction.y, direction.x)
        slope, slope_across = (
            self._depth_derivative(front, rear, crossing, axis) for axis in (direction, perpendicular)
        )
        distance = dr.norm(front.p - self._segments.camera_position)
        # Segments of one direction count curves within 45 degrees of their normal, so that each curve counts once.
        active = (front.shape != 0) & (rear.shape != 0) & (slope > 0.0) & (slope >= dr.abs(slope_across))
        gap = self._plane_depth(front, crossing) - self._plane_depth(rear, crossing)
        active &= dr.abs(gap) < MAX_DEPTH_GAP_PX * slope
        # A shape that does not continue to this depth has an edge there, which the edge term samples.
        beyond = DEPTH_TOLERANCE * distance / slope * direction
        active &= self._continues_behind(scene, front, rear, crossing + beyond, active)
        active &= self._continues_behind(scene, rear, front, crossing - beyond, active)
        return dr.select(active, slope, 1.0), active

    def _is_visible(self, scene: Any, front: _Hit, rear: _Hit, crossing: Any, offset: Any) -> Any:
        """Return whether the first shape is visible on one side of a crossing, and the second on the other."""
        first_id, second_id = self._visible_id(scene, crossing - offset), self._visible_id(scene, crossing + offset)
        return (first_id == front.shape) & (second_id == rear.shape)

    def _visible_id(self, scene: Any, position: Any) -> Any:
        """Return the id of the shape or component that is visible at positions in pixels; 0 for none."""
        return self._component_ids.ids(scene.ray_intersect_preliminary(self._segments.ray(position)))

    def _offset_px(self, hit: _Hit, crossing: Any) -> Any:
        """Return the offset in pixels, large enough that rays spawned off the surface see beyond the crossing."""
        ray, next_ray = (self._segments.ray(position) for position in (crossing, crossing + mi.Vector2f(1.0, 0.0)))
        pixel_width = dr.norm(next_ray.d - ray.d) * dr.norm(hit.p - self._segments.camera_position)
        return dr.clip(OFFSET_EPSILONS * ray_epsilon(hit.p) / pixel_width, *OFFSET_RANGE_PX)

    def _depth_derivative(self, front: _Hit, rear: _Hit, crossing: Any, axis: Any) -> Any:
        """Return the derivative along an axis of the depth difference of the two tangent planes."""
        forward, backward = (
            self._plane_depth(front, position) - self._plane_depth(rear, position)
            for position in (crossing + DIFFERENCE_STEP_PX * axis, crossing - DIFFERENCE_STEP_PX * axis)
        )
        return (forward - backward) / (2.0 * DIFFERENCE_STEP_PX)

    def _continues_behind(self, scene: Any, hidden: _Hit, front: _Hit, position: Any, active: Any) -> Any:
        """Return whether the hidden shape exists near its tangent plane behind the front shape."""
        ray = self._segments.ray(position)
        depth = self._plane_depth(front, position)
        gap = self._plane_depth(hidden, position) - depth
        ray.o = self._segments.camera_position + ray.d * (depth + (1.0 - DEPTH_MARGIN) * gap)
        ray.maxt = 2.0 * DEPTH_MARGIN * gap
        active = active & (gap > 0.0)
        hit = scene.ray_intersect_preliminary(ray, active=active)
        return active & (self._component_ids.ids(hit) == hidden.shape)

    def _plane_depth(self, hit: _Hit, position: Any) -> Any:
        """Return the distance from the camera to the tangent plane of a hit, along the ray through a position."""
        return dr.dot(hit.p - self._segments.camera_position, hit.n) / dr.dot(self._segments.ray(position).d, hit.n)

    def _hits(self, scene: Any, *positions: Any) -> list[_Hit]:
        """Return the camera hits at several arrays of positions of equal width.

        All rays are traced by one call: Dr.Jit propagates no forward gradient through two calls on one shape.
        """
        # A literal width would be compiled into kernels, which would be compiled again for each other width. The opaque
        # offsets also make the gathers below free of conflicts, so their adjoint needs no atomic sums.
        width = dr.width(positions[0])
        count = dr.opaque(mi.UInt32, width)
        index, position = dr.arange(mi.UInt32, len(positions) * width), mi.Point2f(0.0)
        for k, array in enumerate(positions):
            mask = (index >= k * count) & (index < (k + 1) * count)
            position = dr.select(mask, dr.gather(mi.Point2f, array, index - k * count, mask), position)
        hit = scene.ray_intersect(self._segments.ray(position))
        shape = self._component_ids.ids(hit)
        slices = [dr.arange(mi.UInt32, width) + k * count for k in range(len(positions))]
        return [
            _Hit(
                dr.gather(mi.Float, hit.t, rows, mode=dr.ReduceMode.NoConflicts),
                dr.gather(mi.Point3f, dr.detach(hit.p), rows),
                dr.gather(mi.Normal3f, dr.detach(hit.n), rows),
                dr.gather(mi.UInt32, shape, rows),
            )
            for rows in slices
        ]

"""The curves in view along which shapes go through each other: the gradient by how they move.

A ball that is half in a floor meets it in a curve, at which brightness jumps, and which moves when the ball does. It is
no outline: projective sampling does not look for it. So it is searched for here, along lines of a pixel's length. Where
one crosses from a shape to another, and each goes on behind the other, the depths of both say how the crossing moves.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.boundary.segments import STEP, SegmentSampler, narrowed
from loi_mitsuba.geometry.bounds import bounding_box
from loi_mitsuba.geometry.components import ComponentIds
from loi_mitsuba.sensing.sensor import (
    NEARLY,
    make_sampler,
    radiance_difference,
    ray_epsilon,
    supports_boundary_sampling,
)

__all__ = ["IntersectionBoundary"]

NEAR: Final = 0.05  # pixels between a crossing and where the planes of the two shapes cross
BESIDE: Final = (0.0125, 0.05)  # pixels from a crossing, to either side: at least, and at the most in reach of LIFTS
LIFTS: Final = 4.0  # of what Mitsuba lifts a ray by, off the surface that it leaves
AROUND: Final = 0.5  # of how far a shape lies behind the other, to either side of where its plane is


@dataclass(frozen=True)
class _Hit:
    """What the ends of lines see.

    Attributes
    ----------
    t : mi.Float
        How far away it is along the ray, which changes with the shape.
    p, n : mi.Point3f, mi.Normal3f
        Where, and the normal there.
    shape : mi.UInt32
        The number of its shape, or of the part of a mesh; 0 for none.
    """

    t: Any
    p: Any
    n: Any
    shape: Any


class IntersectionBoundary:
    """Where shapes go through each other in view, and the gradient by how they move.

    Parameters
    ----------
    sensor : mi.Sensor
        A perspective camera.
    shapes : list of mi.Shape
        Those that move.
    parts : Parts
        Of these, and of all others.
    """

    def __init__(self, sensor: Any, shapes: list[Any], parts: ComponentIds) -> None:
        self._sensor = sensor
        self._shapes = shapes
        self._parts = parts
        self._lines = SegmentSampler(sensor)

    @classmethod
    def of(cls, scene: Any, sensor: Any, shapes: Iterable[Any]) -> IntersectionBoundary | None:
        """Those of shapes that move, with all others of a scene and of a mesh's parts with each other.

        None where there are none, or the scene is not plain.
        """
        own = scene.shapes()
        moving = [one for one in dict.fromkeys(shapes) if one in own]
        if not moving or not supports_boundary_sampling(scene, sensor):
            return None
        parts = ComponentIds(own, moving)
        return cls(sensor, moving, parts) if len(own) > 1 or parts.meet else None

    def sample(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any] | None:
        """At crossings, 0 with how it changes: the jump times how far the crossing moves; and places. None without."""
        if not self._may_meet(scene):
            return None
        with dr.suspend_grad():
            found = self._changes(scene, samples, seed)
            if found is None:
                return None
            first, second, along = self._narrowed(scene, *found)
        near, far = self._hits(scene, first, second)
        with dr.suspend_grad():
            middle = dr.lerp(first, second, 0.5)
            slope, active = self._slope(scene, near, far, middle, along)
            count = dr.width(middle)
            aside = self._aside(near, middle) * along
            active &= self._shows(scene, near, far, middle, aside)
            # Under a shape that bulges over the crossing, light grows as the root of the distance from it, which is
            # twice as much at four times the distance; unless that is beyond the outline of something in front.
            close, off = (
                radiance_difference(
                    self._sensor,
                    integrator,
                    scene,
                    ((middle - way) / self._lines.size, (middle + way) / self._lines.size),
                    active,
                    make_sampler(seed + 1, count),
                )
                for way in (aside, 4.0 * aside)
            )
            jump = dr.select(self._shows(scene, near, far, middle, 4.0 * aside), 2.0 * close - off, close)
        gap = near.t - far.t
        moved = dr.select(active, -(gap - dr.detach(gap)) / slope, 0.0)
        return dr.select(active, self._lines.mean(-jump, samples), 0.0) * moved, middle / self._lines.size

    def _may_meet(self, scene: Any) -> bool:
        """Whether the box of a shape that moves touches that of another, or its own parts touch."""
        if self._parts.meet:
            return True
        every = scene.shapes()
        low, high = np.stack([bounding_box(one) for one in every], axis=1)
        moving = [every.index(one) for one in self._shapes]
        meet = np.all((low[moving, None] <= high) & (low <= high[moving, None]), axis=-1)
        meet[np.arange(len(moving)), moving] = False
        return bool(np.any(meet))

    def _changes(self, scene: Any, samples: int, seed: int) -> tuple[Any, Any, Any] | None:
        """Lines that begin at one shape and end at another: their ends, in pixels, and their directions."""
        first, second, along = self._lines.drawn(scene, samples, seed)
        before, after = self._seen(scene, first), self._seen(scene, second)
        which = dr.compress((before != 0) & (after != 0) & (before != after))
        if dr.width(which) == 0:
            return None
        return tuple(dr.gather(type(one), one, which) for one in (first, second, along))

    def _narrowed(self, scene: Any, first: Any, second: Any, along: Any) -> tuple[Any, Any, Any]:
        """The same lines, from the last point that sees the first shape to the next that does not."""
        shape = self._seen(scene, first)
        first, second = narrowed(first, second, lambda at: self._seen(scene, at) == shape)
        return first, second, along

    def _slope(self, scene: Any, near: _Hit, far: _Hit, middle: Any, along: Any) -> tuple[Any, Any]:
        """How fast the first shape falls behind the second along a line, by pixel; and whether they do cross there."""
        aside = mi.Vector2f(along.y, along.x)
        slope, other = (self._behind(near, far, middle, way) for way in (along, aside))
        away = dr.norm(near.p - self._lines.eye)
        # Lines of one direction find curves that are within 45 degrees of upright to it, each once.
        active = (near.shape != 0) & (far.shape != 0) & (slope > 0.0) & (slope >= dr.abs(other))
        active &= dr.abs(self._depth(near, middle) - self._depth(far, middle)) < NEAR * slope
        # What goes no deeper than this ends there, and its edge is drawn as one.
        beyond = NEARLY * away / slope * along
        active &= self._goes_on(scene, near, far, middle + beyond, active)
        active &= self._goes_on(scene, far, near, middle - beyond, active)
        return dr.select(active, slope, 1.0), active

    def _shows(self, scene: Any, near: _Hit, far: _Hit, middle: Any, way: Any) -> Any:
        """Whether the first shape is seen on one side of a crossing, and the second on the other."""
        before, after = self._seen(scene, middle - way), self._seen(scene, middle + way)
        return (before == near.shape) & (after == far.shape)

    def _seen(self, scene: Any, at: Any) -> Any:
        """The number of the shape or part that a place in pixels sees; 0 for none."""
        return self._parts.of(scene.ray_intersect_preliminary(self._lines.ray(at)))

    def _aside(self, hit: _Hit, middle: Any) -> Any:
        """Pixels from a crossing to where brightness is looked up: rays that start there see what is around it."""
        one = dr.norm(self._lines.ray(middle + mi.Vector2f(1.0, 0.0)).d - self._lines.ray(middle).d) * dr.norm(
            hit.p - self._lines.eye
        )
        return dr.clip(LIFTS * ray_epsilon(hit.p) / one, *BESIDE)

    def _behind(self, near: _Hit, far: _Hit, middle: Any, way: Any) -> Any:
        """The slope along a direction of how far the first shape's plane is behind the second's."""
        ahead, back = (
            self._depth(near, at) - self._depth(far, at) for at in (middle + STEP * way, middle - STEP * way)
        )
        return (ahead - back) / (2.0 * STEP)

    def _goes_on(self, scene: Any, hidden: _Hit, front: _Hit, at: Any, active: Any) -> Any:
        """Whether a shape is where its plane is behind another one."""
        ray = self._lines.ray(at)
        depth = self._depth(front, at)
        behind = self._depth(hidden, at) - depth
        ray.o = self._lines.eye + ray.d * (depth + (1.0 - AROUND) * behind)
        ray.maxt = 2.0 * AROUND * behind
        active = active & (behind > 0.0)
        return active & (self._parts.of(scene.ray_intersect_preliminary(ray, active=active)) == hidden.shape)

    def _depth(self, hit: _Hit, at: Any) -> Any:
        """How far away the plane of what was hit is, where a place in pixels looks."""
        return dr.dot(hit.p - self._lines.eye, hit.n) / dr.dot(self._lines.ray(at).d, hit.n)

    def _hits(self, scene: Any, *ends: Any) -> list[_Hit]:
        """What places in pixels see, as many of each.

        All by one call: Dr.Jit carries no gradient forward through two of one shape.
        """
        # How many there are must not be written into kernels: they would be compiled again for each other number. So it
        # is opaque, and the gradient comes back without sums of each thread's own, which lie that far apart.
        lines = dr.width(ends[0])
        count = dr.opaque(mi.UInt32, lines)
        number, at = dr.arange(mi.UInt32, len(ends) * lines), mi.Point2f(0.0)
        for k, end in enumerate(ends):
            part = (number >= k * count) & (number < (k + 1) * count)
            at = dr.select(part, dr.gather(mi.Point2f, end, number - k * count, part), at)
        found = scene.ray_intersect(self._lines.ray(at))
        shape = self._parts.of(found)
        each = [dr.arange(mi.UInt32, lines) + k * count for k in range(len(ends))]
        return [
            _Hit(
                dr.gather(mi.Float, found.t, part, mode=dr.ReduceMode.NoConflicts),
                dr.gather(mi.Point3f, dr.detach(found.p), part),
                dr.gather(mi.Normal3f, dr.detach(found.n), part),
                dr.gather(mi.UInt32, shape, part),
            )
            for part in each
        ]

"""Shadows that fall on what moves: the gradient by how it moves through them.

Projective sampling follows the outlines of what moves, and so the shadows that it throws. Where it moves under
something else, or its own parts throw shadows on each other, a shadow passes over it as well. So the edges of these
shadows are searched for here, along lines of a pixel's length that see it: under light from one random point, one end
is lit and the other is not. The plane of light that just passes what throws the shadow goes through the edge, and says
how that moves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, Final

import drjit as dr
import mitsuba as mi

from loi_mitsuba.boundary.area_jacobian import LEAST
from loi_mitsuba.boundary.segments import STEP, SegmentSampler, narrowed
from loi_mitsuba.drjit.ragged import RaggedTable, hit_shape_index, shape_index
from loi_mitsuba.plugins.proxy_emitter import hittable_proxy_emitters
from loi_mitsuba.sensing.film_samples import to_rgb
from loi_mitsuba.sensing.sensor import make_sampler, ray_epsilon, supports_boundary_sampling

__all__ = ["ReceivedShadowBoundary"]

ASIDE: Final = 0.05  # pixels between the two points of a shadow's edge that give its direction
REACH: Final = 0.06  # pixels to either side in which the second of them is looked for
CLEAR: Final = 0.01  # pixels from an outline, at which rounding has rays hit the dark far side of what is closed
GRAZING: Final = 1e-3  # cosine of light that a surface may seem to hide from itself, since rays are lifted off surfaces
NEAR: Final = 0.05  # pixels between the two ends that a line is narrowed to: farther, and depth jumps there

_Within = Callable[[Any], Callable[[Any], Any]]  # for lines of some numbers, what says whether places on them are in it


@dataclass(frozen=True)
class _Light:
    """Light from one point for each line.

    Attributes
    ----------
    p, n, d : mi.Point3f, mi.Normal3f, mi.Vector3f
        Where it comes from, and the normal there; or if it comes from infinitely far, the direction to there.
    far, flat : mi.Bool
        Whether it does, and whether it comes off a surface, which is seen the smaller the more it is turned.
    power : mi.Color3f
        Radiance over the density with which the point was drawn, per area of a surface or solid angle.
    """

    p: Any
    n: Any
    d: Any
    far: Any
    flat: Any
    power: Any

    @classmethod
    def drawn(cls, scene: Any, si: Any, sample: Any) -> _Light:
        """From one point that lights each of some places."""
        ds, power = scene.sample_emitter_direction(si, sample, test_visibility=False, active=si.is_valid())
        power = dr.select(ds.pdf > 0.0, to_rgb(power), 0.0)
        flags = ds.emitter.flags()
        far, flat = (mi.has_flag(flags, one) for one in (mi.EmitterFlags.Infinite, mi.EmitterFlags.Surface))
        light = cls(ds.p, ds.n, ds.d, far, flat, power)
        share = light._share(si.p, LEAST)  # what is seen edge-on from here may be seen much better from there
        return replace(light, power=power * dr.select(light._share(si.p) > 0.0, dr.rcp(share), 0.0))

    def gathered(self, which: Any) -> _Light:
        """That of some lines."""
        parts = (self.p, self.n, self.d, self.far, self.flat, self.power)
        return _Light(*(dr.gather(type(one), one, which) for one in parts))

    def reaching(self, point: Any) -> Any:
        """What of it comes to a point, if nothing is in between."""
        return self.power * self._share(point)

    def _share(self, point: Any, least: float = 0.0) -> Any:
        """The solid angle of an area of its surface from a point, by a cosine of at least this; 1 where it has none."""
        way, away = self.way(point)
        return dr.select(self.flat, dr.maximum(-dr.dot(self.n, way), least) / dr.square(away), 1.0)

    def way(self, point: Any) -> tuple[Any, Any]:
        """The direction from a point to the light, and how far it is."""
        return self._way_to(self.p, point)

    def way_clear_of_it(self, point: Any) -> tuple[Any, Any]:
        """The same to where its surface, seen nearly edge-on, does not hide the light by an error of rounding."""
        return self._way_to(dr.select(self.flat, self.p + ray_epsilon(self.p) * self.n, self.p), point)

    def _way_to(self, there: Any, point: Any) -> tuple[Any, Any]:
        to = there - point
        away = dr.norm(to)
        return dr.select(self.far, self.d, to / away), dr.select(self.far, dr.largest(mi.Float), away)


@dataclass(frozen=True)
class _Found:
    """Lines at whose ends one shape is lit, and is not.

    Attributes
    ----------
    first, second : mi.Point2f
        Their ends, in pixels.
    along : mi.Vector2f
        Their directions.
    lit : mi.Bool
        Whether it is the first end that is lit.
    weight : mi.Float
        Of how many such lines each is one.
    light : _Light
        What by.
    """

    first: Any
    second: Any
    along: Any
    lit: Any
    weight: Any
    light: _Light


class ReceivedShadowBoundary:
    """Where shadows fall on shapes that move and are in view, and the gradient by how they move.

    Parameters
    ----------
    sensor : mi.Sensor
        A perspective camera.
    shapes : list of mi.Shape
        Those that move.
    """

    def __init__(self, sensor: Any, shapes: list[Any]) -> None:
        self._lines = SegmentSampler(sensor)
        self._shapes = shapes
        self._moves = RaggedTable({shape_index(one): 1 for one in shapes})

    @classmethod
    def of(cls, scene: Any, sensor: Any, shapes: Iterable[Any]) -> ReceivedShadowBoundary | None:
        """Those on shapes that move in a scene; None where there are none, or it is not plain."""
        moving = [one for one in dict.fromkeys(shapes) if one in scene.shapes()]
        return (
            cls(sensor, moving) if moving and scene.emitters() and supports_boundary_sampling(scene, sensor) else None
        )

    @hittable_proxy_emitters()
    def sample(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any] | None:  # noqa: ARG002  # direct light alone
        """At edges of shadows, 0 with how it changes: the jump times how far they move; and places. None without."""
        with dr.suspend_grad():
            found = self._changes(scene, samples, seed)
            if found is None:
                return None
            along, light, lit = found.along, found.light, found.lit
            first, second = self._narrowed(scene, found.first, found.second, light, lit)
            middle = dr.lerp(first, second, 0.5)
            beside, active = self._beside(scene, middle, along, light, lit)
        si = scene.ray_intersect(self._lines.ray(middle))
        with dr.suspend_grad():
            at = dr.detach(si)
            active &= self._is_smooth(scene, first, second, at, light)
            edge = self._on_plane(at, beside) - at.p
            step = STEP * along
            over = (self._on_plane(at, middle + step) - self._on_plane(at, middle - step)) / (2.0 * STEP)
            way, _ = light.way(at.p)
            # Of the plane of light that just passes what throws the shadow.
            normal = dr.normalize(dr.cross(way, edge))
            speed = dr.dot(normal, over)
            active &= dr.abs(speed) > 1e-3 * dr.norm(over)
            value = light.reaching(at.p) * at.bsdf().eval(mi.BSDFContext(), at, at.to_local(way), active)
            jump = to_rgb(value)
            jump = self._lines.mean(dr.select(lit, jump, -jump) * found.weight, samples)
            jump = dr.select(active, jump, 0.0)
            scale = dr.select(active, -dr.rcp(speed), 0.0)
        moved = scale * dr.dot(normal, si.p - dr.detach(si.p))
        return jump * dr.select(active, moved, 0.0), middle / self._lines.size

    def _changes(self, scene: Any, samples: int, seed: int) -> _Found | None:
        """Lines of which one end is in a shadow."""
        pixels = self._lines.around(self._shapes)
        if dr.width(pixels) == 0:
            return None
        first, second, along = self._lines.drawn(scene, samples, seed, pixels)
        one, other = self._lines.seen(scene, first), self._lines.seen(scene, second)
        # Where a line sees two shapes that move, it is taken for either, half of the time.
        two = self._moving(one) & self._moving(other) & (one != other)
        turn = ~self._moving(one) | (two & (make_sampler(seed + 1, dr.width(one)).next_1d() < 0.5))
        shape = dr.select(turn, other, one)
        which = dr.compress(self._moving(shape))
        if dr.width(which) == 0:
            return None
        weight = dr.select(two, 2.0, 1.0)
        within = one == other
        first, second, along, turn, shape, weight, within = (
            dr.gather(type(part), part, which) for part in (first, second, along, turn, shape, weight, within)
        )
        first, second = self._cut(first, second, turn, dr.compress(~within), self._sees(scene, shape))
        sampler = make_sampler(seed + 2, dr.width(first))
        si = scene.ray_intersect(self._lines.ray(first))
        light = _Light.drawn(scene, si, sampler.next_2d())
        end = scene.ray_intersect(self._lines.ray(second))
        # What is turned away from light has no edge of a shadow there, for no light is lost.
        facing, turn = self._faces(si, light), self._faces(end, light)
        which = dr.compress((dr.max(light.power) > 0.0) & (facing | turn))
        if dr.width(which) == 0:
            return None
        first, second, along, weight, facing, turn = (
            dr.gather(type(part), part, which) for part in (first, second, along, weight, facing, turn)
        )
        light = light.gathered(which)
        first, second = self._cut(first, second, turn, dr.compress(facing != turn), self._is_faced(scene, light))
        lit = self._lit_at(scene, first, light)
        which = dr.compress(lit != self._lit_at(scene, second, light))
        if dr.width(which) == 0:
            return None
        first, second, along, lit, weight = (
            dr.gather(type(part), part, which) for part in (first, second, along, lit, weight)
        )
        return _Found(first, second, along, lit, weight, light.gathered(which))

    def _cut(self, first: Any, second: Any, turn: Any, which: Any, within: _Within) -> tuple[Any, Any]:
        """Lines as far as they are within something, and not quite to where it ends.

        Those of some numbers have one end in it, the second if `turn` says so.
        """
        if dr.width(which) == 0:
            return first, second
        turned = dr.gather(mi.Bool, turn, which)
        low, high = (dr.gather(type(end), end, which) for end in (first, second))
        start, outside = dr.select(turned, high, low), dr.select(turned, low, high)
        inside, _ = narrowed(start, outside, within(which))
        inside = dr.lerp(inside, start, CLEAR / dr.maximum(dr.norm(start - inside), CLEAR))
        first, second = mi.Point2f(first), mi.Point2f(second)
        dr.scatter(first, dr.select(turned, inside, low), which)
        dr.scatter(second, dr.select(turned, high, inside), which)
        return first, second

    def _sees(self, scene: Any, shape: Any) -> _Within:
        """Whether lines see the shape of a number at places."""

        def within(which: Any) -> Callable[[Any], Any]:
            own = dr.gather(mi.UInt32, shape, which)
            return lambda at: self._lines.seen(scene, at) == own

        return within

    def _is_faced(self, scene: Any, light: _Light) -> _Within:
        """Whether what lines see at places is turned to their light."""

        def within(which: Any) -> Callable[[Any], Any]:
            own = light.gathered(which)
            return lambda at: self._faces(scene.ray_intersect(self._lines.ray(at)), own)

        return within

    def _narrowed(self, scene: Any, first: Any, second: Any, light: _Light, lit: Any) -> tuple[Any, Any]:
        """Lines narrowed to where lit and unlit meet."""
        return narrowed(first, second, lambda at: self._lit_at(scene, at, light) == lit)

    def _beside(self, scene: Any, middle: Any, along: Any, light: _Light, lit: Any) -> tuple[Any, Any]:
        """A second point of the edge of each shadow, and whether there is one, on lines nearly upright to it."""
        aside = ASIDE * mi.Vector2f(along.y, along.x)
        there = dr.zeros(mi.Bool)  # the edge may end on one side
        first, second = mi.Point2f(middle), mi.Point2f(middle)
        for way in (aside, -aside):
            low, high = middle + way - REACH * along, middle + way + REACH * along
            found = ~there & (self._lit_at(scene, low, light) == lit) & (self._lit_at(scene, high, light) != lit)
            first, second = dr.select(found, low, first), dr.select(found, high, second)
            there |= found
            dr.eval(first, second, there)
        first, second = self._narrowed(scene, first, second, light, lit)
        beside = dr.lerp(first, second, 0.5)
        shape = self._lines.seen(scene, middle)  # off which another one may be lit where it is not
        there &= (self._lines.seen(scene, first) == shape) & (self._lines.seen(scene, second) == shape)
        # Lines of one direction find edges that are within 45 degrees of upright to it, each once.
        return beside, there & (dr.abs(dr.dot(beside - middle, along)) <= ASIDE)

    def _is_smooth(self, scene: Any, first: Any, second: Any, at: Any, light: _Light) -> Any:
        """Whether both ends of a narrowed line see one surface, which faces the light."""
        ends = [scene.ray_intersect(self._lines.ray(end)) for end in (first, second)]
        smooth = dr.ones(mi.Bool)
        for one in ends:
            smooth &= (hit_shape_index(one) == hit_shape_index(at)) & self._faces(one, light)
        apart = dr.norm(self._on_plane(at, first + mi.Vector2f(NEAR, 0.0)) - self._on_plane(at, first))
        return smooth & (dr.norm(ends[1].p - ends[0].p) < apart)

    def _on_plane(self, hit: Any, at: Any) -> Any:
        """Where a place in pixels would see the plane of what was hit."""
        ray = self._lines.ray(at)
        return ray.o + ray.d * (dr.dot(hit.p - ray.o, hit.n) / dr.dot(ray.d, hit.n))

    def _lit_at(self, scene: Any, at: Any, light: _Light) -> Any:
        return self._lit(scene, scene.ray_intersect(self._lines.ray(at)), light)

    def _moving(self, shape: Any) -> Any:
        """Whether the shape of a number moves."""
        return self._moves.of(shape)[1]

    @staticmethod
    def _faces(si: Any, light: _Light) -> Any:
        """Whether what a ray has hit is turned to the light on the side that the ray came from."""
        way, _ = light.way(si.p)
        return dr.dot(si.n, way) * dr.sign(dr.dot(si.n, si.to_world(si.wi))) > GRAZING

    @staticmethod
    def _lit(scene: Any, si: Any, light: _Light) -> Any:
        """Whether light comes to where a ray has hit."""
        way, away = light.way_clear_of_it(si.p)
        ray = si.spawn_ray(way)
        ray.maxt = dr.select(light.far, away, away * (1.0 - mi.math.ShadowEpsilon))
        return ~scene.ray_test(ray, active=si.is_valid())

"""The edges of meshes with sides, as of a box: the gradient by how they move in view.

Projective sampling asks how bright a mesh is at an outline, and takes for it the triangle that the edge was found with,
which of a box is as often the side that is turned away. Between two sides that are both seen it looks for no edge. And
edges of a rectangle or disk that leans count for more or less than they are long. So points of such edges are drawn
here, and the jump at each is that of two rays, one on either side of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.drjit.ragged import hit_shape_index, shape_index
from loi_mitsuba.geometry.coincident_edges import uncovered_segments
from loi_mitsuba.geometry.mesh import crease_edges, edge_vertices, has_creases
from loi_mitsuba.sensing.sensor import (
    BESIDE,
    NEARLY,
    PerspectiveSensor,
    make_sampler,
    radiance_difference,
    supports_boundary_sampling,
)

__all__ = ["EdgeBoundary"]

SHARE: Final = 4  # samples of the image for one here
LEAST: Final = 4096
WITHIN: Final = 0.25  # of the way from an edge to the middle of a triangle, at most, for a ray that is to hit it
HIDDEN: Final = 0.02  # of the length of an edge: what is nearer than it by less does not hide it
IN_FRONT: Final = 0.01  # of the distance to the camera: what is nearer by less touches the edge, as a floor under a box
RIM: Final = 1024  # edges of a disk: they are off its rim by less than BESIDE, up to 20,000 pixels across
STEP: Final = 0.01  # of the distance to the camera, along an edge to either side, for the direction that it is seen in


class EdgeBoundary:
    """The edges of flat shapes, and of meshes that have sides, and the gradient of what is in view by where they are.

    Parameters
    ----------
    sensor : mi.Sensor
        A perspective camera.
    shapes : list of mi.Shape

    Attributes
    ----------
    shapes : list of mi.Shape
    """

    def __init__(self, sensor: Any, shapes: list[Any]) -> None:
        self.shapes = shapes
        self._sensor = sensor
        self._params = [(str(shape.class_name()), mi.traverse(shape)) for shape in shapes]
        places = [np.array(_positions(*one)).reshape(-1, 3) for one in self._params]
        first = np.cumsum([0, *map(len, places[:-1])])
        found = [_pieces_of(shape, place) for shape, place in zip(shapes, places, strict=True)]
        ends, third = (
            np.concatenate([one[k] + start for one, start in zip(found, first, strict=True)]) for k in (0, 1)
        )
        self._ends, self._third = (
            [mi.UInt32(np.ascontiguousarray(one, dtype=np.uint32)) for one in every.T] for every in (ends, third)
        )
        between = np.concatenate([one[2] for one in found])
        self._between = [mi.Float(np.ascontiguousarray(one, dtype=np.float32)) for one in between.T]
        counts = [len(one[0]) for one in found]
        self._shape = mi.UInt32(np.repeat([shape_index(one) for one in shapes], counts).astype(np.uint32))
        width, height = sensor.film().crop_size()
        self._size = mi.Point2f(float(width), float(height))

    @classmethod
    def of(cls, scene: Any, sensor: Any, shapes: Iterable[Any]) -> EdgeBoundary | None:
        """The edges of those of some shapes of a scene that are flat, or meshes with sides.

        None where there are none, or the scene is not plain.
        """
        if not supports_boundary_sampling(scene, sensor):
            return None
        own = scene.shapes()
        sided = [one for one in dict.fromkeys(shapes) if one in own and (one.class_name() in FLAT or has_creases(one))]
        return cls(sensor, sided) if sided else None

    def sample(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any]:
        """At points of the edges, 0 with how it changes: the jump times how far the edge moves across; and places."""
        eye = PerspectiveSensor(self._sensor)  # which may move
        pixels = int(self._size.x[0] * self._size.y[0])
        count = max(LEAST, samples * pixels // SHARE)
        sampler = make_sampler(seed, count)
        positions = dr.concat([_positions(*one) for one in self._params])
        with dr.suspend_grad():
            drawn = self._drawn(eye, dr.detach(positions))
            index, along = drawn.sample_reuse(sampler.next_1d())
        first, second, *third = (
            dr.gather(mi.Point3f, positions, dr.gather(mi.UInt32, one, index)) for one in (*self._ends, *self._third)
        )
        low, high = (dr.gather(mi.Float, one, index) for one in self._between)
        point = dr.lerp(first, second, dr.lerp(low, high, along))
        place = eye.project(point)[2]
        with dr.suspend_grad():
            point, edge = dr.detach(point), dr.detach(second - first)
            away = eye.place - point
            distance = dr.norm(away)
            step = STEP * distance * dr.normalize(edge)
            ahead, behind = (eye.project(point + sign * step)[2] for sign in (1.0, -1.0))
            seen = (ahead - behind) * self._size
            length = dr.norm(seen)
            across = mi.Vector2f(-seen.y, seen.x) / length
            start = eye.near_clip_point(point)
            ray = mi.Ray3f(start, -away / distance)
            ray.maxt = dr.norm(point - start) - dr.minimum(NEARLY * distance, HIDDEN * dr.norm(edge))
            active = eye.project(point)[3] & (length > 0.0) & ~scene.ray_test(ray)
            middles = [eye.project((first + second + one) / 3.0)[2] for one in third]
            ends = self._sides(dr.detach(place), across, middles)
            own = dr.gather(mi.UInt32, self._shape, index)
            for end in ends:
                active &= ~self._is_hidden(scene, end, eye, distance, own, active)
            jump = radiance_difference(self._sensor, integrator, scene, ends, active, sampler)
            # Points to a unit of length.
            density = drawn.eval_pmf_normalized(index) * count / (dr.norm(edge) * (high - low))
            pixels_each = length / (2.0 * STEP * distance * density)
        moved = dr.dot(across, place * self._size)
        moved = dr.select(active, moved - dr.detach(moved), 0.0)
        return dr.select(active, -jump * pixels_each, 0.0) * moved, dr.detach(place)

    def _is_hidden(self, scene: Any, place: Any, eye: PerspectiveSensor, distance: Any, own: Any, active: Any) -> Any:
        """Whether a place beside an edge shows another shape, in front of it, which ends between the two."""
        ray = self._sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))[0]
        hit = scene.ray_intersect_preliminary(ray, active=active)
        nearer = hit.t + dr.norm(ray.o - eye.place) < (1.0 - IN_FRONT) * distance
        return hit.is_valid() & nearer & (hit_shape_index(hit) != own)

    def _drawn(self, eye: PerspectiveSensor, positions: Any) -> Any:
        """How often each edge is drawn: half of the time by its length, and half if it looks like an outline.

        Of the edges of a fine mesh few are outlines, and brightness jumps most there.
        """
        first, second, *third = (dr.gather(mi.Point3f, positions, one) for one in (*self._ends, *self._third))
        begin, end, middle = (eye.project(one)[2] * self._size for one in (first, second, 0.5 * (first + second)))
        across = mi.Vector2f(begin.y - end.y, end.x - begin.x)
        one, other = (
            dr.dot(across, eye.project((first + second + each) / 3.0)[2] * self._size - middle) for each in third
        )
        length = dr.norm(second - first) * (self._between[1] - self._between[0])
        outline = dr.select(one * other > 0.0, length, 0.0)
        shares = [each / dr.maximum(dr.sum(each), 1e-30) for each in (length, outline)]
        return mi.DiscreteDistribution(shares[0] + shares[1])

    def _sides(self, place: Any, across: Any, middles: list[Any]) -> tuple[Any, Any]:
        """A place before an edge and one beyond it, of the film: in the triangle that is there, or close to the edge.

        A triangle that is seen nearly edge-on is much narrower than what is close.
        """
        ends = []
        for sign in (-1.0, 1.0):
            beside = place + sign * BESIDE * across / self._size
            for middle in middles:
                way = middle - place
                far = sign * dr.dot(across, way * self._size)
                inside = place + dr.minimum(WITHIN, BESIDE / far) * way
                beside = dr.select(far > 0.0, inside, beside)
            ends.append(beside)
        return ends[0], ends[1]


def _rims() -> dict[str, Float32Array]:
    """The outlines of Mitsuba's flat shapes, in their own coordinates: shape (n, 3)."""
    turns = 2.0 * np.pi * np.arange(RIM) / RIM
    return {
        "Rectangle": np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]),
        "Disk": np.stack([np.cos(turns), np.sin(turns), np.zeros(RIM)], axis=1),
    }


FLAT: Final = _rims()


def _positions(kind: str, params: Any) -> Any:
    """Of the vertices of a shape, one after the other; they change with what moves it."""
    if kind not in FLAT:
        return params["vertex_positions"]
    return dr.ravel(params["to_world"] @ mi.Point3f(np.ascontiguousarray(FLAT[kind].T, dtype=np.float32)))


def _pieces_of(shape: Any, places: Float32Array) -> tuple[Float32Array, Float32Array, Float32Array]:
    """The edges of a shape, each line of them once: as of :func:`_edges_of`, and where each piece begins and ends.

    `places` are those of its vertices, shape (n, 3).
    """
    ends, third = _edges_of(shape)
    which, between = uncovered_segments(places, ends)
    return ends[which], third[which], between


def _edges_of(shape: Any) -> tuple[Float32Array, Float32Array]:
    """As :func:`edges_of`, of a rectangle or disk as well."""
    if shape.class_name() not in FLAT:
        return edge_vertices(shape, crease_edges(shape))
    count = len(FLAT[shape.class_name()])
    first = np.arange(count)
    ends: Float32Array = np.stack([first, (first + 1) % count], axis=1)
    across: Float32Array = np.repeat(((first + count // 2) % count)[:, None], 2, axis=1)
    return ends, across

"""The edges of meshes with sides, as of a box: the gradient by how they move in view.

Projective sampling asks how bright a mesh is at an outline, and takes for it the triangle that the edge was found with,
which of a box is as often the side that is turned away. Between two sides that are both seen it looks for no edge. So
points of such edges are drawn here, and the jump at each is that of two rays, one on either side of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.eye import NEARLY, Eye, brighter, is_plain, sampler_of
from loi_mitsuba.handles import Host
from loi_mitsuba.seams import edges_of, has_sides

__all__ = ["Edges"]

SHARE: Final = 4  # samples of the image for one here
LEAST: Final = 4096
STEP: Final = 0.01  # of the distance to the camera, along an edge to either side, for the direction that it is seen in


class Edges:
    """The edges of meshes that have sides, and the gradient of what is in view by where their vertices are.

    Parameters
    ----------
    sensor : mi.Sensor
        A perspective camera that shows its whole film.
    shapes : list of mi.Mesh
    edges : list of array of int, shape (n, 2)
        Of each, the ends of its edges.

    Attributes
    ----------
    shapes : list of mi.Mesh
    """

    def __init__(self, sensor: Any, shapes: list[Any], edges: list[Host]) -> None:
        self.shapes = shapes
        self._sensor = sensor
        self._params = [mi.traverse(shape) for shape in shapes]
        counts = [len(one["vertex_positions"]) // 3 for one in self._params]
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        ends = np.concatenate([one + start for one, start in zip(edges, first, strict=True)]).astype(np.uint32)
        self._ends = [mi.UInt32(np.ascontiguousarray(end)) for end in ends.T]
        places = np.concatenate([np.array(one["vertex_positions"]).reshape(-1, 3) for one in self._params])
        lengths = np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1)
        self._drawn = mi.DiscreteDistribution(mi.Float(lengths.astype(np.float32)))
        width, height = sensor.film().size()
        self._size = mi.Point2f(float(width), float(height))

    @classmethod
    def of(cls, scene: Any, sensor: Any, shapes: Iterable[Any]) -> Edges | None:
        """The edges of those of some shapes that are meshes of a scene and have sides.

        None where there are none, or the scene is not plain.
        """
        if not is_plain(scene, sensor):
            return None
        own = scene.shapes()
        meshes = [one for one in dict.fromkeys(shapes) if one in own and has_sides(one)]
        return cls(sensor, meshes, [edges_of(one) for one in meshes]) if meshes else None

    def jumps(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any]:
        """At points of the edges, 0 with how it changes: the jump times how far the edge moves across; and places."""
        eye = Eye(self._sensor)  # which may move
        pixels = int(self._size.x[0] * self._size.y[0])
        count = max(LEAST, samples * pixels // SHARE)
        sampler = sampler_of(seed, count)
        index, along = self._drawn.sample_reuse(sampler.next_1d())
        positions = dr.concat([one["vertex_positions"] for one in self._params])
        first, second = (dr.gather(mi.Point3f, positions, dr.gather(mi.UInt32, end, index)) for end in self._ends)
        point = dr.lerp(first, second, along)
        place = eye.sees(point)[2]
        with dr.suspend_grad():
            point, edge = dr.detach(point), dr.detach(second - first)
            away = eye.place - point
            distance = dr.norm(away)
            step = STEP * distance * dr.normalize(edge)
            ahead, behind = (eye.sees(point + sign * step)[2] for sign in (1.0, -1.0))
            seen = (ahead - behind) * self._size
            length = dr.norm(seen)
            across = mi.Vector2f(-seen.y, seen.x) / length
            ray = mi.Ray3f(eye.place, -away / distance)
            ray.maxt = distance * (1.0 - NEARLY)
            active = eye.sees(point)[3] & (length > 0.0) & ~scene.ray_test(ray)
            jump = brighter(self._sensor, integrator, scene, dr.detach(place), across / self._size, active, sampler)
            density = self._drawn.eval_pmf_normalized(index) * count / dr.norm(edge)  # points to a unit of length
            pixels_each = length / (2.0 * STEP * distance * density)
        moved = dr.dot(across, place * self._size)
        moved = dr.select(active, moved - dr.detach(moved), 0.0)
        return dr.select(active, -jump * pixels_each, 0.0) * moved, dr.detach(place)

"""The boundary term of creased meshes, rectangles and disks by edge sampling (Li et al. 2018).

At a silhouette edge, projective sampling evaluates the radiance of a mesh on the triangle that it found the edge with.
For a box, this triangle faces away as often as not (mitsuba3#1648). Projective sampling also finds no edge between two
visible faces, and weighs the edges of a leaning rectangle or disk wrongly. Here points are sampled on such edges, and
the radiance difference at each is measured by two rays, one on either side.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import HostArray
from mitsuba_boundaries.drjit.ragged import hit_shape_index, shape_index
from mitsuba_boundaries.geometry.coincident_edges import uncovered_segments
from mitsuba_boundaries.geometry.mesh import crease_edges, edge_vertices
from mitsuba_boundaries.geometry.mesh_checks import has_creases, is_unwelded
from mitsuba_boundaries.sensing.sensor import (
    DEPTH_TOLERANCE,
    OFFSET_PX,
    PerspectiveSensor,
    make_sampler,
    radiance_difference,
    supports_boundary_sampling,
)

__all__ = ["EdgeBoundary"]

IMAGE_SAMPLES_PER_EDGE_SAMPLE: Final = 4
MIN_SAMPLES: Final = 4096
MAX_INSET: Final = 0.25  # fraction of the way from an edge to the centroid of a triangle, for a ray that must hit it
MAX_SELF_OCCLUSION: Final = 0.02  # fraction of an edge's length: occluders nearer to the edge are its own triangles
CONTACT_DEPTH: Final = 0.01  # fraction of the distance to the camera: nearer shapes touch the edge, as a floor a box
RIM_VERTICES: Final = 1024  # of a disk: within OFFSET_PX of the circle for disks up to 20,000 pixels wide
TANGENT_STEP: Final = 0.01  # fraction of the distance to the camera, for central differences along an edge


class EdgeBoundary:
    """The edges of flat shapes and of creased meshes.

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
        positions = [np.array(_positions(*params)).reshape(-1, 3) for params in self._params]
        first_vertex = np.cumsum([0, *map(len, positions[:-1])])
        edges = [_edges_of(shape, vertices) for shape, vertices in zip(shapes, positions, strict=True)]
        end_vertices, opposite = (
            np.concatenate([arrays[k] + first for arrays, first in zip(edges, first_vertex, strict=True)])
            for k in (0, 1)
        )
        self._ends, self._opposite = (
            [mi.UInt32(np.ascontiguousarray(column, dtype=np.uint32)) for column in vertices.T]
            for vertices in (end_vertices, opposite)
        )
        interval = np.concatenate([arrays[2] for arrays in edges])
        self._interval = [mi.Float(np.ascontiguousarray(bound, dtype=np.float32)) for bound in interval.T]
        counts = [len(arrays[0]) for arrays in edges]
        self._shape = mi.UInt32(np.repeat([shape_index(shape) for shape in shapes], counts).astype(np.uint32))
        width, height = sensor.film().crop_size()
        self._size = mi.Point2f(float(width), float(height))

    @classmethod
    def from_scene(cls, scene: Any, sensor: Any, shapes: Iterable[Any]) -> EdgeBoundary | None:
        """Build from the flat shapes and the creased or unwelded meshes among `shapes`.

        Projective sampling counts the silhouettes of unwelded meshes twice. None if there is no such shape, or without
        support for boundary sampling.
        """
        if not supports_boundary_sampling(scene, sensor):
            return None
        in_scene = scene.shapes()
        edged = [
            shape
            for shape in dict.fromkeys(shapes)
            if shape in in_scene and (shape.class_name() in OUTLINES or has_creases(shape) or is_unwelded(shape))
        ]
        return cls(sensor, edged) if edged else None

    def sample(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any]:
        """Sample the edges; see :class:`mitsuba_boundaries.terms.BoundarySampler`."""
        camera = PerspectiveSensor(self._sensor)  # built here, because the sensor may move between calls
        pixels = int(self._size.x[0] * self._size.y[0])
        count = max(MIN_SAMPLES, samples * pixels // IMAGE_SAMPLES_PER_EDGE_SAMPLE)
        sampler = make_sampler(seed, count)
        positions = dr.concat([_positions(*params) for params in self._params])
        with dr.suspend_grad():
            distribution = self._edge_distribution(camera, dr.detach(positions))
            index, fraction = distribution.sample_reuse(sampler.next_1d())
        first, second, *opposite = (
            dr.gather(mi.Point3f, positions, dr.gather(mi.UInt32, vertex, index))
            for vertex in (*self._ends, *self._opposite)
        )
        lower, upper = (dr.gather(mi.Float, bound, index) for bound in self._interval)
        point = dr.lerp(first, second, dr.lerp(lower, upper, fraction))
        uv = camera.project(point).uv
        with dr.suspend_grad():
            point, edge = dr.detach(point), dr.detach(second - first)
            to_camera = camera.position - point
            distance = dr.norm(to_camera)
            step = TANGENT_STEP * distance * dr.normalize(edge)
            forward, backward = (camera.project(point + sign * step).uv for sign in (1.0, -1.0))
            tangent = (forward - backward) * self._size
            length = dr.norm(tangent)
            normal = mi.Vector2f(-tangent.y, tangent.x) / length
            start = camera.near_clip_point(point)
            ray = mi.Ray3f(start, -to_camera / distance)
            ray.maxt = dr.norm(point - start) - dr.minimum(
                DEPTH_TOLERANCE * distance, MAX_SELF_OCCLUSION * dr.norm(edge)
            )
            active = camera.project(point).visible & (length > 0.0) & ~scene.ray_test(ray)
            centroids = [camera.project((first + second + vertex) / 3.0).uv for vertex in opposite]
            offset_uvs = self._offset_positions(dr.detach(uv), normal, centroids)
            shape = dr.gather(mi.UInt32, self._shape, index)
            for offset_uv in offset_uvs:
                active &= ~self._is_occluded(scene, offset_uv, camera, distance, shape, active)
            difference = radiance_difference(self._sensor, integrator, scene, offset_uvs, active, sampler)
            # Samples per unit of length.
            density = distribution.eval_pmf_normalized(index) * count / (dr.norm(edge) * (upper - lower))
            pixels_per_sample = length / (2.0 * TANGENT_STEP * distance * density)
        displacement = dr.dot(normal, uv * self._size)
        displacement = dr.select(active, displacement - dr.detach(displacement), 0.0)
        return dr.select(active, -difference * pixels_per_sample, 0.0) * displacement, dr.detach(uv)

    def _is_occluded(
        self, scene: Any, uv: Any, camera: PerspectiveSensor, distance: Any, shape: Any, active: Any
    ) -> Any:
        """Return a mask of the film positions beside an edge that show another shape in front of the edge."""
        ray = self._sensor.sample_ray(0.0, 0.5, uv, mi.Point2f(0.5))[0]
        hit = scene.ray_intersect_preliminary(ray, active=active)
        is_nearer = hit.t + dr.norm(ray.o - camera.position) < (1.0 - CONTACT_DEPTH) * distance
        return hit.is_valid() & is_nearer & (hit_shape_index(hit) != shape)

    def _edge_distribution(self, camera: PerspectiveSensor, positions: Any) -> Any:
        """Return the distribution of samples over edges: half by length, half by length of silhouette edges.

        Few edges of a fine mesh are silhouettes, but the largest radiance differences are there.
        """
        first, second, *opposite = (
            dr.gather(mi.Point3f, positions, vertex) for vertex in (*self._ends, *self._opposite)
        )
        first_px, second_px, middle = (
            camera.project(point).uv * self._size for point in (first, second, 0.5 * (first + second))
        )
        normal = mi.Vector2f(first_px.y - second_px.y, second_px.x - first_px.x)
        signed_distance, opposite_distance = (
            dr.dot(normal, camera.project((first + second + vertex) / 3.0).uv * self._size - middle)
            for vertex in opposite
        )
        length = dr.norm(second - first) * (self._interval[1] - self._interval[0])
        silhouette_length = dr.select(signed_distance * opposite_distance > 0.0, length, 0.0)
        pdfs = [weight / dr.maximum(dr.sum(weight), 1e-30) for weight in (length, silhouette_length)]
        return mi.DiscreteDistribution(pdfs[0] + pdfs[1])

    def _offset_positions(self, uv: Any, normal: Any, centroids: list[Any]) -> tuple[Any, Any]:
        """Return a film position on either side of an edge: inside the adjacent triangle, or OFFSET_PX away.

        A triangle seen at a grazing angle may be much narrower than OFFSET_PX.
        """
        offsets = []
        for sign in (-1.0, 1.0):
            position = uv + sign * OFFSET_PX * normal / self._size
            for centroid in centroids:
                inwards = centroid - uv
                width = sign * dr.dot(normal, inwards * self._size)
                inside = uv + dr.minimum(MAX_INSET, OFFSET_PX / width) * inwards
                position = dr.select(width > 0.0, inside, position)
            offsets.append(position)
        return offsets[0], offsets[1]


def _outlines() -> dict[str, HostArray]:
    """Return the outline vertices of Mitsuba's flat shapes in local coordinates, shape (n, 3), by class name."""
    angle = 2.0 * np.pi * np.arange(RIM_VERTICES) / RIM_VERTICES
    return {
        "Rectangle": np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]),
        "Disk": np.stack([np.cos(angle), np.sin(angle), np.zeros(RIM_VERTICES)], axis=1),
    }


OUTLINES: Final = _outlines()


def _positions(class_name: str, params: Any) -> Any:
    """Return the flat vertex positions of a shape, mi.Float, attached to its parameters."""
    if class_name not in OUTLINES:
        return params["vertex_positions"]
    return dr.ravel(params["to_world"] @ mi.Point3f(np.ascontiguousarray(OUTLINES[class_name].T, dtype=np.float32)))


def _edges_of(shape: Any, positions: HostArray) -> tuple[HostArray, HostArray, HostArray]:
    """Return a shape's edges without coincident ones, given its vertex positions, shape (n, 3).

    Each array has shape (edges, 2): the end vertices, the opposite vertices of the adjacent triangles, and the interval
    of the edge that counts, as fractions of its length.
    """
    end_vertices, opposite = _all_edges(shape)
    index, interval = uncovered_segments(positions, end_vertices)
    return end_vertices[index], opposite[index], interval


def _all_edges(shape: Any) -> tuple[HostArray, HostArray]:
    """Return the end vertices and opposite vertices of a mesh's creases and borders, or of a flat shape's outline."""
    if shape.class_name() not in OUTLINES:
        return edge_vertices(shape, crease_edges(shape))
    count = len(OUTLINES[shape.class_name()])
    first = np.arange(count)
    end_vertices: HostArray = np.stack([first, (first + 1) % count], axis=1)
    opposite: HostArray = np.repeat(((first + count // 2) % count)[:, None], 2, axis=1)
    return end_vertices, opposite

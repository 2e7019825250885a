"""Search for discontinuities by bisection of segments of the image plane that are one pixel long."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.ragged import hit_shape_index
from mitsuba_boundaries.geometry.bounds import bounding_box
from mitsuba_boundaries.sensing.sensor import PerspectiveSensor, make_sampler

__all__ = ["DIFFERENCE_STEP_PX", "SegmentSampler", "bisect"]

IMAGE_SAMPLES_PER_PAIR: Final = 4  # a pair is one horizontal and one vertical segment
MAX_SEGMENTS: Final = 2**22  # of one direction: curves in large images are long, so fewer per pixel suffice
BISECTIONS: Final = 16
PIECES: Final = 4  # of a segment that may cross a narrow shape; 8 find hardly more
MIN_SMOOTH_COSINE: Final = 0.9  # between the normals at the ends of a segment that is not split
DIFFERENCE_STEP_PX: Final = 0.05  # to either side, for central differences


class SegmentSampler:
    """Horizontal and vertical segments of a camera's image. Positions are in pixels.

    Parameters
    ----------
    sensor : mi.Sensor
        A perspective camera.

    Attributes
    ----------
    size : mi.Point2f
        Width and height of the image in pixels.
    """

    def __init__(self, sensor: Any) -> None:
        self._sensor = sensor
        self._pixels = tuple(int(length) for length in sensor.film().crop_size())
        self.size = mi.Point2f(*map(float, self._pixels))

    def segments_per_pixel(self, samples: int) -> int:
        """Return the number of horizontal, and of vertical, segments per pixel for `samples` per pixel of the image."""
        width, height = self._pixels
        return max(1, min(samples // IMAGE_SAMPLES_PER_PAIR, MAX_SEGMENTS // (width * height)))

    def average(self, value: Any, samples: int) -> Any:
        """Divide values found by segments by the number of segments per pixel."""
        return value / dr.opaque(mi.Float, self.segments_per_pixel(samples))

    def sample(self, scene: Any, samples: int, seed: int, pixels: Any = None) -> tuple[Any, Any, Any]:
        """Sample segments that are stratified by pixel.

        Segments also begin in the column left of the image and in the row above it.

        Parameters
        ----------
        scene : mi.Scene
        samples : int
            Per pixel of the image.
        seed : int
        pixels : mi.UInt32, optional
            Pixels to begin in, of :meth:`pixels_covering`; all by default.

        Returns
        -------
        first, second : mi.Point2f
            Ends of the segments, or of their pieces.
        direction : mi.Vector2f
            (1, 0) or (0, 1).
        """
        width, height = (length + 1 for length in self._pixels)
        per_pixel = 2 * self.segments_per_pixel(samples)
        index = dr.arange(mi.UInt32, per_pixel * (width * height if pixels is None else dr.width(pixels)))
        pixel = index // dr.opaque(mi.UInt32, per_pixel)  # a literal would be compiled into kernels
        if pixels is not None:
            pixel = dr.gather(mi.UInt32, pixels, pixel)
        sampler = make_sampler(seed, dr.width(index))
        first = mi.Point2f(pixel % width, pixel // width) - 1.0 + sampler.next_2d()
        return self._split(scene, first, dr.select(index % 2 == 0, mi.Vector2f(1.0, 0.0), mi.Vector2f(0.0, 1.0)))

    def _split(self, scene: Any, first: Any, direction: Any) -> tuple[Any, Any, Any]:
        """Split segments whose ends hit two shapes, or one shape with different normals.

        Neither end hits a shape between them that is narrower than a pixel, as a face of a box at a grazing angle.
        """
        hit, next_hit = (
            scene.ray_intersect(self.ray(position), ray_flags=mi.RayFlags.Minimal, coherent=True)
            for position in (first, first + direction)
        )
        is_split = (hit_shape_index(hit) != hit_shape_index(next_hit)) | (
            hit.is_valid() & (dr.dot(hit.n, next_hit.n) < MIN_SMOOTH_COSINE)
        )
        dr.eval(is_split)  # else the rays are traced again below
        piece = dr.arange(mi.UInt32, PIECES * dr.width(is_split))
        piece = dr.compress((piece % PIECES == 0) | dr.gather(mi.Bool, is_split, piece // PIECES))
        segment = piece // PIECES
        first, direction, is_split = (dr.gather(type(array), array, segment) for array in (first, direction, is_split))
        first = mi.Point2f(first + dr.select(is_split, mi.Float(piece % PIECES) / PIECES, 0.0) * direction)
        return first, mi.Point2f(first + dr.select(is_split, 1.0 / PIECES, 1.0) * direction), direction

    def pixels_covering(self, shapes: list[Any]) -> Any:
        """Return the pixels, mi.UInt32, whose segments may reach the bounding boxes of some shapes.

        All pixels, if a box reaches beside or behind the camera.
        """
        width, height = (length + 1 for length in self._pixels)
        lower, upper = np.stack([bounding_box(shape) for shape in shapes], axis=1)[..., None]
        corners = lower + (upper - lower) * np.indices((2, 2, 2)).reshape(3, 8)  # shape (shapes, 3, 8)
        points = np.ascontiguousarray(corners.transpose(1, 0, 2).reshape(3, -1), dtype=np.float32)
        projection = PerspectiveSensor(self._sensor).project(mi.Point3f(points))
        covered = np.zeros((height, width), dtype=bool)
        if not np.all(np.array(projection.visible)):
            covered[:] = True
        uv = np.nan_to_num(np.array(projection.uv)).reshape(2, len(shapes), 8)
        position = uv * np.array(self._pixels)[:, None, None]
        begin = np.clip(np.floor(position.min(axis=2)), 0, [[width], [height]]).astype(int)
        stop = np.clip(np.floor(position.max(axis=2)) + 2.0, 0, [[width], [height]]).astype(int)
        for (left, top), (right, bottom) in zip(begin.T, stop.T, strict=True):
            covered[top:bottom, left:right] = True
        return mi.UInt32(np.flatnonzero(covered).astype(np.uint32))

    @property
    def camera_position(self) -> Any:
        """The current position of the camera, mi.Point3f."""
        return mi.Point3f(self._sensor.world_transform().translation())

    def ray(self, position: Any) -> Any:
        """Return the camera rays, mi.Ray3f, through positions in pixels."""
        return self._sensor.sample_ray(0.0, 0.5, position / self.size, mi.Point2f(0.5))[0]

    def visible_shape(self, scene: Any, position: Any) -> Any:
        """Return the index, mi.UInt32, of the shape that is visible at positions in pixels; 0 for none."""
        return hit_shape_index(scene.ray_intersect_preliminary(self.ray(position)))


def bisect(first: Any, second: Any, holds: Callable[[Any], Any]) -> tuple[Any, Any]:
    """Shrink segments to where a condition changes that holds at `first`, and not at `second`."""
    for _ in range(BISECTIONS):
        middle = dr.lerp(first, second, 0.5)
        at_middle = holds(middle)
        first, second = dr.select(at_middle, middle, first), dr.select(at_middle, second, middle)
        dr.eval(first, second)
    return first, second

"""Lines of a pixel's length on the film of a perspective camera, along which jumps of brightness are searched for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.drjit.ragged import hit_shape_index
from loi_mitsuba.geometry.bounds import bounding_box
from loi_mitsuba.sensing.sensor import PerspectiveSensor, make_sampler

__all__ = ["STEP", "SegmentSampler", "narrowed"]

SHARE: Final = 4  # samples of the image for one line across and one down
MOST: Final = 2**22  # lines of one direction: in large images curves are long, and fewer to a pixel will do
HALVINGS: Final = 16  # of a line
PIECES: Final = 4  # of a line that may pass over something narrow: an eighth finds hardly more
BENT: Final = 0.9  # least cosine between normals at its ends, for one that does not
STEP: Final = 0.05  # pixels to either side, for a slope


class SegmentSampler:
    """Lines across and down the film of a camera.

    Parameters
    ----------
    sensor : mi.Sensor
        A perspective camera.

    Attributes
    ----------
    size : mi.Point2f
        Of the image, in pixels.
    """

    def __init__(self, sensor: Any) -> None:
        self._sensor = sensor
        self._pixels = tuple(int(side) for side in sensor.film().crop_size())
        self.size = mi.Point2f(*map(float, self._pixels))

    def number(self, samples: int) -> int:
        """How many go across, and as many down, from every pixel."""
        width, height = self._pixels
        return max(1, min(samples // SHARE, MOST // (width * height)))

    def mean(self, value: Any, samples: int) -> Any:
        """What lines have found, as a change of the image."""
        return value / dr.opaque(mi.Float, self.number(samples))

    def drawn(self, scene: Any, samples: int, seed: int, pixels: Any = None) -> tuple[Any, Any, Any]:
        """Where lines begin and end, in pixels, at random, and their directions: also left of and above the film.

        `pixels` are those that :meth:`around` gives, or all.
        """
        width, height = (side + 1 for side in self._pixels)
        both = 2 * self.number(samples)
        number = dr.arange(mi.UInt32, both * (width * height if pixels is None else dr.width(pixels)))
        pixel = number // dr.opaque(mi.UInt32, both)  # or kernels would be compiled again for each other number
        if pixels is not None:
            pixel = dr.gather(mi.UInt32, pixels, pixel)
        sampler = make_sampler(seed, dr.width(number))
        first = mi.Point2f(pixel % width, pixel // width) - 1.0 + sampler.next_2d()
        return self._split(scene, first, dr.select(number % 2 == 0, mi.Vector2f(1.0, 0.0), mi.Vector2f(0.0, 1.0)))

    def _split(self, scene: Any, first: Any, along: Any) -> tuple[Any, Any, Any]:
        """The same lines, in pieces where their ends see two shapes, or what is turned to two sides.

        Of what is between them and narrower than a line, as a side of a box that is seen nearly edge-on, neither end
        would tell.
        """
        one, other = (
            scene.ray_intersect(self.ray(at), ray_flags=mi.RayFlags.Minimal, coherent=True)
            for at in (first, first + along)
        )
        bent = (hit_shape_index(one) != hit_shape_index(other)) | (one.is_valid() & (dr.dot(one.n, other.n) < BENT))
        dr.eval(bent)  # or rays are traced again for what follows
        piece = dr.arange(mi.UInt32, PIECES * dr.width(bent))
        piece = dr.compress((piece % PIECES == 0) | dr.gather(mi.Bool, bent, piece // PIECES))
        line = piece // PIECES
        first, along, bent = (dr.gather(type(one), one, line) for one in (first, along, bent))
        first = mi.Point2f(first + dr.select(bent, mi.Float(piece % PIECES) / PIECES, 0.0) * along)
        return first, mi.Point2f(first + dr.select(bent, 1.0 / PIECES, 1.0) * along), along

    def around(self, shapes: list[Any]) -> Any:
        """Pixels from which lines may reach some shapes; those of all lines where one is beside or behind the camera.

        The boxes of the shapes tell.
        """
        width, height = (side + 1 for side in self._pixels)
        low, high = np.stack([bounding_box(one) for one in shapes], axis=1)[..., None]
        corners = low + (high - low) * np.indices((2, 2, 2)).reshape(3, 8)  # shape (shapes, 3, 8)
        points = np.ascontiguousarray(corners.transpose(1, 0, 2).reshape(3, -1), dtype=np.float32)
        _, _, place, visible = PerspectiveSensor(self._sensor).project(mi.Point3f(points))
        within = np.zeros((height, width), dtype=bool)
        if not np.all(np.array(visible)):
            within[:] = True
        at = np.nan_to_num(np.array(place)).reshape(2, len(shapes), 8) * np.array(self._pixels)[:, None, None]
        least = np.clip(np.floor(at.min(axis=2)), 0, [[width], [height]]).astype(int)
        most = np.clip(np.floor(at.max(axis=2)) + 2.0, 0, [[width], [height]]).astype(int)
        for (left, top), (right, bottom) in zip(least.T, most.T, strict=True):
            within[top:bottom, left:right] = True
        return mi.UInt32(np.flatnonzero(within).astype(np.uint32))

    @property
    def eye(self) -> Any:
        """Where the camera is, which may move."""
        return mi.Point3f(self._sensor.world_transform().translation())

    def ray(self, at: Any) -> Any:
        """What a place in pixels looks along."""
        return self._sensor.sample_ray(0.0, 0.5, at / self.size, mi.Point2f(0.5))[0]

    def seen(self, scene: Any, at: Any) -> Any:
        """The number of the shape that a place in pixels sees; 0 for none."""
        return hit_shape_index(scene.ray_intersect_preliminary(self.ray(at)))


def narrowed(first: Any, second: Any, is_first: Callable[[Any], Any]) -> tuple[Any, Any]:
    """Lines narrowed to where what holds at their first ends ceases to hold."""
    for _ in range(HALVINGS):
        middle = dr.lerp(first, second, 0.5)
        same = is_first(middle)
        first, second = dr.select(same, middle, first), dr.select(same, second, middle)
        dr.eval(first, second)
    return first, second

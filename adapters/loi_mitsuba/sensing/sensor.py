"""A perspective camera as what shows a point of the scene: where on the film, and with what weight."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.sensing.film import Film
from loi_mitsuba.sensing.film_samples import to_rgb

__all__ = [
    "BESIDE",
    "NEARLY",
    "PerspectiveSensor",
    "is_off_centre",
    "make_sampler",
    "principal_point_offset",
    "radiance_difference",
    "ray_epsilon",
    "supports_boundary_sampling",
]

BESIDE: Final = 0.05  # pixels from a jump of brightness, to either side
NEARLY: Final = 1e-3  # of the distance to the camera: what is nearer than an edge by less does not hide it
LEAST_AHEAD: Final = 1e-3  # cosine between the way to a point and where the camera looks: less is out of any view


class PerspectiveSensor:
    """A perspective camera; of points around the image, to a quarter of its longer side, it knows the place as well."""

    def __init__(self, sensor: Any) -> None:
        self._film = Film(sensor.film())
        self._size = width, height = self._film.size  # of the image, and what places are fractions of
        self._around = 1 + max(width, height) // 4
        to_world = sensor.world_transform()
        self.place = mi.Point3f(to_world.translation())
        self._to_local = to_world.inverse()
        self._to_film = sensor.projection_transform()
        self._offset = principal_point_offset(sensor)
        self._near = float(np.array(sensor.near_clip()).reshape(-1)[0])
        matrix = np.array(self._to_film.matrix, dtype=np.float64).reshape(4, 4)
        # Pixels to the area of the film at distance 1.
        self._density = abs(float(width * height * matrix[0, 0] * matrix[1, 1] / matrix[3, 2] ** 2))

    def padded_cotangent(self, cotangent: Any) -> Any:
        """A cotangent of the image, shape (H, W, C), as one of its red, green and blue, with zeros around it."""
        around = (self._around, self._around)
        colours = self._film.colours_of(cotangent)
        return mi.TensorXf(np.ascontiguousarray(np.pad(colours, (around, around, (0, 0)))))

    def cropped(self, image: Any) -> Float32Array:
        """An image without what is around it."""
        inner = slice(self._around, -self._around)
        return np.array(image, dtype=np.float32)[inner, inner]

    def splat(self, values: Iterable[tuple[Any, Any]]) -> Any:
        """Values at places, as an image with what is around it: what :meth:`looked_up` is the transpose of."""
        width, height = (one + 2 * self._around for one in self._size)
        image = dr.zeros(mi.Float, 3 * width * height)
        for value, place in values:
            at = self._pixels(place) - 0.5
            low = mi.Point2i(dr.floor(at))
            high = at - mi.Point2f(low)
            for right in (0, 1):
                for down in (0, 1):
                    x, y = low.x + right, low.y + down
                    there = (x >= 0) & (y >= 0) & (x < width) & (y < height)
                    part = (high.x if right else 1.0 - high.x) * (high.y if down else 1.0 - high.y)
                    first = 3 * mi.UInt32(y * width + x)
                    for channel in range(3):
                        dr.scatter_add(image, part * value[channel], first + channel, there)
        return mi.TensorXf(image, shape=(height, width, 3))

    def padded_texture(self, image: Any) -> Any:
        """An image with what is around it, to look up between its pixels, with zero beyond.

        Its outermost pixels count as beyond: they are what a lookup far away gives.
        """
        height, width = image.shape[:2]
        inner = np.zeros((height, width, 1), dtype=np.float32)
        inner[1:-1, 1:-1] = 1.0
        return mi.Texture2f(image * mi.TensorXf(inner), filter_mode=dr.FilterMode.Linear, wrap_mode=dr.WrapMode.Clamp)

    def gather(self, texture: Any, place: Any) -> Any:
        """A texture of :meth:`texture` at places of the film."""
        width, height = (one + 2 * self._around for one in self._size)
        at = self._pixels(place)
        return mi.Color3f(*texture.eval(mi.Point2f(at.x / width, at.y / height)))

    def _pixels(self, place: Any) -> Any:
        """Places of the film, 0 to 1 both ways, in pixels of an image with what is around it."""
        return mi.Point2f(place.x * self._size[0], place.y * self._size[1]) + self._around

    def project(self, point: Any) -> tuple[Any, Any, Any, Any]:
        """Of a point: the direction to the camera, weight in pixels, place on the film, whether it is in front."""
        away = self.place - point
        distance = dr.norm(away)
        local = self._to_local @ point
        ahead = local.z / distance
        visible = (ahead > LEAST_AHEAD) & (local.z > self._near)
        place = self._to_film @ local
        weight = self._density / (dr.square(distance) * ahead * ahead * ahead)
        shown = mi.Point2f(place.x, place.y) - mi.Point2f(*self._offset)
        return away / distance, dr.select(visible, weight, 0.0), shown, visible

    def near_clip_point(self, point: Any) -> Any:
        """Where the way to a point in front begins: what is nearer than the near clipping plane hides nothing."""
        local = self._to_local @ point
        return self.place + (point - self.place) * (self._near / dr.maximum(local.z, self._near))


def principal_point_offset(sensor: Any) -> tuple[float, float]:
    """How far the principal point of a perspective camera is from the middle, in sides of the image.

    Mitsuba has it in sides of the whole film, of which the image may be a part.
    """
    params, film = mi.traverse(sensor), sensor.film()
    given = (float(np.array(params[f"principal_point_offset_{axis}"]).reshape(-1)[0]) for axis in "xy")
    x, y = (one * side / part for one, side, part in zip(given, film.size(), film.crop_size(), strict=True))
    return float(x), float(y)


def is_off_centre(sensor: Any) -> bool:
    """Whether a camera is a perspective one whose principal point is not in the middle."""
    return sensor.class_name() == "PerspectiveCamera" and any(principal_point_offset(sensor))


def supports_boundary_sampling(scene: Any, sensor: Any) -> bool:
    """Whether jumps of brightness can be drawn here.

    Not with spectra or polarised light, in media, and for cameras other than a perspective one.
    """
    colours = (mi.is_rgb or mi.is_monochromatic) and not mi.is_polarized
    within = any(one.is_medium_transition() for one in scene.shapes())
    return colours and sensor.class_name() == "PerspectiveCamera" and not within


def radiance_difference(
    sensor: Any, integrator: Any, scene: Any, ends: tuple[Any, Any], active: Any, sampler: Any
) -> Any:
    """How much brighter it is at the second of two places of the film, 0 to 1 both ways, than at the first."""
    values = []
    for place in ends:
        ray, weight = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
        values.append(integrator.sample(scene, sampler, ray, active=active)[0] * weight)
    return to_rgb(values[1] - values[0])


def ray_epsilon(point: Any) -> Any:
    """How far off a surface Mitsuba begins the rays that leave it at a point."""
    return mi.math.RayEpsilon * (1.0 + dr.max(dr.abs(point)))


def make_sampler(seed: int, count: int) -> Any:
    """Random numbers for as many samples."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed % 2**32, count)
    return sampler

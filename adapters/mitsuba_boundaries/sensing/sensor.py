"""The connection of scene points to a perspective sensor: projection, importance, and padded splatting.

Also helpers of the boundary terms: radiance differences, ray offsets and samplers.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import Float32Array
from mitsuba_boundaries.sensing.film import Film
from mitsuba_boundaries.sensing.film_samples import to_rgb

__all__ = [
    "DEPTH_TOLERANCE",
    "OFFSET_PX",
    "PerspectiveSensor",
    "Projection",
    "is_off_centre",
    "make_sampler",
    "principal_point_offset",
    "radiance_difference",
    "ray_epsilon",
    "supports_boundary_sampling",
]

OFFSET_PX: Final = 0.05  # pixels from a discontinuity to the film positions on its two sides
DEPTH_TOLERANCE: Final = 1e-3  # minimum depth of an occluder before a surface, as a fraction of the distance
MIN_COSINE: Final = 1e-3  # between a direction and the optical axis; points beyond are outside of any view


class Projection(NamedTuple):
    """The connection of points to the sensor.

    Attributes
    ----------
    direction : mi.Vector3f
        Unit direction to the camera.
    weight : mi.Float
        Importance in pixels: radiance times this, per projected area, is added to the image. 0 behind the camera.
    uv : mi.Point2f
        Film position, as a fraction of the image.
    visible : mi.Bool
        Whether the point is in front of the camera and its near clipping plane.
    """

    direction: Any
    weight: Any
    uv: Any
    visible: Any


class PerspectiveSensor:
    """A perspective camera with an image that is padded by a quarter of its longer side.

    Parameters
    ----------
    sensor : mi.Sensor
        Of type ``perspective``. Its pose is read once.

    Attributes
    ----------
    position : mi.Point3f
    """

    def __init__(self, sensor: Any) -> None:
        self._film = Film(sensor.film())
        self._size = width, height = self._film.size
        self._padding = 1 + max(width, height) // 4  # pixels
        to_world = sensor.world_transform()
        self.position = mi.Point3f(to_world.translation())
        self._to_local = to_world.inverse()
        self._to_film = sensor.projection_transform()
        self._offset = principal_point_offset(sensor)
        self._near_clip = float(np.array(sensor.near_clip()).reshape(-1)[0])
        matrix = np.array(self._to_film.matrix, dtype=np.float64).reshape(4, 4)
        # Pixels per area of the film plane at distance 1.
        self._pixel_density = abs(float(width * height * matrix[0, 0] * matrix[1, 1] / matrix[3, 2] ** 2))

    def padded_cotangent(self, cotangent: Any) -> Any:
        """Return a cotangent of the image, shape (H, W, C), as one of linear RGB with zero padding: mi.TensorXf."""
        padding = (self._padding, self._padding)
        rgb = self._film.rgb_cotangent(cotangent)
        return mi.TensorXf(np.ascontiguousarray(np.pad(rgb, (padding, padding, (0, 0)))))

    def crop(self, image: Any) -> Float32Array:
        """Remove the padding of an image."""
        inner = slice(self._padding, -self._padding)
        return np.array(image, dtype=np.float32)[inner, inner]

    def splat(self, splats: Iterable[tuple[Any, Any]]) -> Any:
        """Return the padded image, mi.TensorXf, of bilinearly splatted values, mi.Color3f, at film positions."""
        width, height = (length + 2 * self._padding for length in self._size)
        image = dr.zeros(mi.Float, 3 * width * height)
        for value, uv in splats:
            position = self._to_pixels(uv) - 0.5
            corner = mi.Point2i(dr.floor(position))
            fraction = position - mi.Point2f(corner)
            for dx in (0, 1):
                for dy in (0, 1):
                    x, y = corner.x + dx, corner.y + dy
                    in_image = (x >= 0) & (y >= 0) & (x < width) & (y < height)
                    weight = (fraction.x if dx else 1.0 - fraction.x) * (fraction.y if dy else 1.0 - fraction.y)
                    first = 3 * mi.UInt32(y * width + x)
                    for channel in range(3):
                        dr.scatter_add(image, weight * value[channel], first + channel, in_image)
        return mi.TensorXf(image, shape=(height, width, 3))

    def padded_texture(self, image: Any) -> Any:
        """Return a padded image as a texture with bilinear interpolation that is zero beyond the image.

        The outermost pixels are set to zero, because lookups beyond the image return them.
        """
        height, width = image.shape[:2]
        inner = np.zeros((height, width, 1), dtype=np.float32)
        inner[1:-1, 1:-1] = 1.0
        return mi.Texture2f(image * mi.TensorXf(inner), filter_mode=dr.FilterMode.Linear, wrap_mode=dr.WrapMode.Clamp)

    def gather(self, texture: Any, uv: Any) -> Any:
        """Return a texture of :meth:`padded_texture` at film positions: mi.Color3f. The adjoint of :meth:`splat`."""
        width, height = (length + 2 * self._padding for length in self._size)
        position = self._to_pixels(uv)
        return mi.Color3f(*texture.eval(mi.Point2f(position.x / width, position.y / height)))

    def _to_pixels(self, uv: Any) -> Any:
        """Convert film positions to pixels of the padded image."""
        return mi.Point2f(uv.x * self._size[0], uv.y * self._size[1]) + self._padding

    def project(self, point: Any) -> Projection:
        """Connect points, mi.Point3f, to the camera, without testing for occluders."""
        to_camera = self.position - point
        distance = dr.norm(to_camera)
        local = self._to_local @ point
        cosine = local.z / distance
        visible = (cosine > MIN_COSINE) & (local.z > self._near_clip)
        position = self._to_film @ local
        weight = self._pixel_density / (dr.square(distance) * cosine * cosine * cosine)
        uv = mi.Point2f(position.x, position.y) - mi.Point2f(*self._offset)
        return Projection(to_camera / distance, dr.select(visible, weight, 0.0), uv, visible)

    def near_clip_point(self, point: Any) -> Any:
        """Return where the ray from the camera to a point crosses the near clipping plane: mi.Point3f."""
        local = self._to_local @ point
        return self.position + (point - self.position) * (self._near_clip / dr.maximum(local.z, self._near_clip))


def principal_point_offset(sensor: Any) -> tuple[float, float]:
    """Return the offset of a perspective camera's principal point from the centre, as a fraction of the image.

    Mitsuba's parameter is a fraction of the whole film, and the image may be a crop window of it.
    """
    params, film = mi.traverse(sensor), sensor.film()
    offset = (float(np.array(params[f"principal_point_offset_{axis}"]).reshape(-1)[0]) for axis in "xy")
    x, y = (value * length / crop for value, length, crop in zip(offset, film.size(), film.crop_size(), strict=True))
    return float(x), float(y)


def is_off_centre(sensor: Any) -> bool:
    """Return whether a sensor is a perspective camera whose principal point is not in the centre."""
    return sensor.class_name() == "PerspectiveCamera" and any(principal_point_offset(sensor))


def supports_boundary_sampling(scene: Any, sensor: Any) -> bool:
    """Return whether boundary terms can be sampled here.

    They support RGB and monochromatic variants without polarisation, surfaces without media, and perspective cameras.
    """
    is_colour = (mi.is_rgb or mi.is_monochromatic) and not mi.is_polarized
    has_media = any(shape.is_medium_transition() for shape in scene.shapes())
    return is_colour and sensor.class_name() == "PerspectiveCamera" and not has_media


def radiance_difference(
    sensor: Any, integrator: Any, scene: Any, uvs: tuple[Any, Any], active: Any, sampler: Any
) -> Any:
    """Return the radiance, mi.Color3f, at the second of two film positions minus the radiance at the first."""
    values = []
    for uv in uvs:
        ray, weight = sensor.sample_ray(0.0, 0.5, uv, mi.Point2f(0.5))
        values.append(integrator.sample(scene, sampler, ray, active=active)[0] * weight)
    return to_rgb(values[1] - values[0])


def ray_epsilon(point: Any) -> Any:
    """Return the offset from the surface of rays that Mitsuba spawns at a point."""
    return mi.math.RayEpsilon * (1.0 + dr.max(dr.abs(point)))


def make_sampler(seed: int, count: int) -> Any:
    """Return an independent sampler, mi.Sampler, of wavefront size `count`."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed % 2**32, count)
    return sampler

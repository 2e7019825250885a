"""The reconstruction filter of a film: splatting of samples, and its adjoint."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import Float32Array

__all__ = ["Film", "max_samples"]

LUMINANCE: Final = ((0.2126, 0.7152, 0.0722),)  # of linear red, green and blue (Rec. 709)
XYZ: Final = ((0.412453, 0.357580, 0.180423), (0.212671, 0.715160, 0.072169), (0.019334, 0.119193, 0.950227))
MAX_IMAGE_SAMPLES: Final = 2**32 - 1  # Mitsuba counts the samples of an image in 32 bits
FILTER_STEPS: Final = 1024  # of the midpoint rule for the integral of the filter, whose error is of second order


class Film:
    """The crop window, reconstruction filter and colour channels of a film.

    Film positions (uv) are fractions of the image, 0 to 1 on both axes. Values are linear red, green and blue.

    Parameters
    ----------
    film : mi.Film

    Attributes
    ----------
    size : tuple of int
        Width and height of the image in pixels.
    channels : int
        Number of channels of the image.
    """

    def __init__(self, film: Any) -> None:
        width, height = (int(length) for length in film.crop_size())
        self.size = (width, height)
        self.channels = int(film.base_channels_count())
        self._from_rgb = np.asarray(_channel_matrix(film, self.channels), dtype=np.float32)
        self._filter = film.rfilter()
        self._border = float(self._filter.border_size()) if film.sample_border() else 0.0

    @property
    def border_oversampling(self) -> float:
        """Number of sampled pixels, including the border, per pixel of the image."""
        return math.prod(1.0 + 2.0 * self._border / length for length in self.size)

    @cached_property
    def _normalisation(self) -> list[Any]:
        """For each axis, one over the integral of the filter around each pixel, restricted to the sampled region."""
        radius = float(self._filter.radius())
        offset = radius * (2.0 * (np.arange(FILTER_STEPS) + 0.5) / FILTER_STEPS - 1.0)
        value = np.array(self._filter.eval(mi.Float(offset.astype(np.float32))), dtype=np.float64)
        norms = []
        for length in self.size:
            position = np.arange(length)[:, None] + 0.5 + offset
            is_sampled = (position >= -self._border) & (position <= length + self._border)
            norms.append(mi.Float((FILTER_STEPS / (2.0 * radius) / (is_sampled @ value)).astype(np.float32)))
        return norms

    def rgb_cotangent(self, cotangent: Any) -> Float32Array:
        """Convert a cotangent of the image, shape (H, W, C), to one of linear RGB, shape (H, W, 3).

        The adjoint of :meth:`to_channels`. Alpha and other extra channels have no gradient.
        """
        return np.asarray(cotangent, dtype=np.float32)[..., : len(self._from_rgb)] @ self._from_rgb

    def to_channels(self, rgb: Float32Array) -> Float32Array:
        """Convert linear RGB, shape (H, W, 3), to the film's channels, shape (H, W, C), with 0 in extra channels."""
        return np.pad(rgb @ self._from_rgb.T, ((0, 0), (0, 0), (0, self.channels - len(self._from_rgb))))

    def gather(self, cotangent: Any, uv: Any) -> Any:
        """Return the filter-weighted mean of a cotangent of the image, shape (H, W, C), at film positions: mi.Color3f.

        The adjoint of :meth:`splat`.
        """
        values = mi.Float(np.ascontiguousarray(self.rgb_cotangent(cotangent)).ravel())
        total = mi.Color3f(0.0)
        for pixel, weight, in_image in self._pixels(uv):
            total += weight * dr.gather(mi.Color3f, values, pixel, in_image)
        return total

    def splat(self, value: Any, uv: Any) -> Float32Array:
        """Return the sum of values, mi.Color3f, splatted at film positions: an image, shape (H, W, C)."""
        return self.to_channels(self._splat_sums(value, uv))

    def reconstruct(self, value: Any, uv: Any) -> Float32Array:
        """Return the image, shape (H, W, C), of samples with these values, mi.Color3f, and film positions."""
        sums = self._splat_sums(mi.Vector4f(*value, 1.0), uv)
        return self.to_channels(sums[..., :3] / _nonzero(sums[..., 3:]))

    def normalised_cotangent(self, cotangent: Any, uv: Any) -> Float32Array:
        """Divide a cotangent of the image, shape (H, W, C), by the pixels' total weights of samples at `uv`.

        :meth:`gather` of the result is the adjoint of :meth:`reconstruct`.
        """
        return np.asarray(cotangent, dtype=np.float32) / _nonzero(self._splat_sums(mi.Vector1f(1.0), uv))

    def _splat_sums(self, value: Any, uv: Any) -> Float32Array:
        """Return weighted sums of values over pixels, shape (H, W, channels of `value`)."""
        width, height = self.size
        image = dr.zeros(mi.Float, len(value) * width * height)
        for pixel, weight, in_image in self._pixels(uv):
            dr.scatter_add(image, weight * value, pixel, in_image)
        return np.array(image, dtype=np.float32).reshape(height, width, len(value))

    def _pixels(self, uv: Any) -> Iterator[tuple[Any, Any, Any]]:
        """Yield the pixels in the filter's footprint: flat index, weight, and whether the image has the pixel."""
        columns, rows = (list(self._footprint(axis, uv[axis] * length)) for axis, length in enumerate(self.size))
        for row, row_weight, in_rows in rows:
            for column, column_weight, in_columns in columns:
                yield mi.UInt32(row * self.size[0] + column), row_weight * column_weight, in_rows & in_columns

    def _footprint(self, axis: int, position: Any) -> Iterator[tuple[Any, Any, Any]]:
        """Yield the same for one axis: pixel, weight and mask, for positions in pixels."""
        radius = float(self._filter.radius())
        is_sampled = (position >= -self._border) & (position <= self.size[axis] + self._border)
        first = mi.Int32(dr.floor(position - radius + 0.5))
        for index in range(math.ceil(2.0 * radius)):
            pixel = first + index
            mask = is_sampled & (pixel >= 0) & (pixel < self.size[axis])
            weight = self._filter.eval(position - 0.5 - mi.Float(pixel)) if radius > 0.5 else mi.Float(1.0)
            yield pixel, weight * dr.gather(mi.Float, self._normalisation[axis], mi.UInt32(pixel), mask), mask


def max_samples(film: Any) -> int:
    """Return the largest number of samples per pixel, counting the border if the film samples it."""
    border = 2 * film.rfilter().border_size() if film.sample_border() else 0
    width, height = film.crop_size()
    return MAX_IMAGE_SAMPLES // int((width + border) * (height + border))


def _nonzero(weights: Float32Array) -> Float32Array:
    """Replace the weight 0 of pixels without samples by 1."""
    return np.where(weights > 0.0, weights, np.float32(1.0))


def _channel_matrix(film: Any, channels: int) -> Any:
    """Return the matrix, shape (C, 3), from linear RGB to the film's colour channels."""
    if channels < 3:
        return LUMINANCE
    return XYZ if "pixel_format = xyz" in str(film) else np.eye(3)

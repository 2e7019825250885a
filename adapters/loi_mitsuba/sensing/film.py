"""What the film of a camera makes of a point of light: which pixels show it, how much of it, and in which colours."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.drjit.arrays import Float32Array

__all__ = ["Film"]

LUMINANCE: Final = ((0.2126, 0.7152, 0.0722),)  # of linear red, green and blue (Rec. 709)
XYZ: Final = ((0.412453, 0.357580, 0.180423), (0.212671, 0.715160, 0.072169), (0.019334, 0.119193, 0.950227))
STEPS: Final = 1024  # of the integral over a reconstruction filter, which is off by their square


class Film:
    """The image that a film shows: its window, its reconstruction filter and its colours.

    Parameters
    ----------
    film : mi.Film

    Attributes
    ----------
    size : tuple of int
        Width and height of the image.
    channels : int
        Of colour.
    """

    def __init__(self, film: Any) -> None:
        width, height = (int(one) for one in film.crop_size())
        self.size = (width, height)
        self.channels = int(film.base_channels_count())
        self._mix = np.asarray(_mix_of(film, self.channels), dtype=np.float32)
        self._filter = film.rfilter()
        self._beyond = float(self._filter.border_size()) if film.sample_border() else 0.0

    @property
    def sampled(self) -> float:
        """How many pixels samples are drawn for, with those of a border, to each of the image."""
        return math.prod(1.0 + 2.0 * self._beyond / side for side in self.size)

    @cached_property
    def _norms(self) -> list[Any]:
        """Along each axis, one over the integral of the filter around each pixel, as far as it is sampled."""
        radius = float(self._filter.radius())
        offset = radius * (2.0 * (np.arange(STEPS) + 0.5) / STEPS - 1.0)
        value = np.array(self._filter.eval(mi.Float(offset.astype(np.float32))), dtype=np.float64)
        norms = []
        for side in self.size:
            at = np.arange(side)[:, None] + 0.5 + offset
            sampled = (at >= -self._beyond) & (at <= side + self._beyond)
            norms.append(mi.Float((STEPS / (2.0 * radius) / (sampled @ value)).astype(np.float32)))
        return norms

    def colours_of(self, cotangent: Any) -> Float32Array:
        """A cotangent of the image, shape (H, W, C), as one of its red, green and blue.

        Channels beyond colours have no gradient.
        """
        return np.asarray(cotangent, dtype=np.float32)[..., : len(self._mix)] @ self._mix

    def shown(self, image: Float32Array) -> Float32Array:
        """An image of red, green and blue in the film's channels: what :meth:`colours_of` is the transpose of."""
        return np.pad(image @ self._mix.T, ((0, 0), (0, 0), (0, self.channels - len(self._mix))))

    def gather(self, cotangent: Any, place: Any) -> Any:
        """A cotangent of the image, shape (H, W, C), for red, green and blue at places of the film, 0 to 1 both ways.

        That is its mean over the pixels that show a place, with the weights of the reconstruction filter.
        """
        values = mi.Float(np.ascontiguousarray(self.colours_of(cotangent)).ravel())
        found = mi.Color3f(0.0)
        for first, weight, there in self._pixels(place):
            found += weight * dr.gather(mi.Color3f, values, first, there)
        return found

    def splat(self, value: Any, place: Any) -> Float32Array:
        """What red, green and blue at places add to the image, shape (H, W, C).

        What :meth:`looked_up` is the transpose of.
        """
        return self.shown(self._sums(value, place))

    def mean(self, value: Any, place: Any) -> Float32Array:
        """The image, shape (H, W, C), of samples that are red, green and blue at places."""
        sums = self._sums(mi.Vector4f(*value, 1.0), place)
        return self.shown(sums[..., :3] / _above(sums[..., 3:]))

    def shared(self, cotangent: Any, place: Any) -> Float32Array:
        """A cotangent of the image, shape (H, W, C), for :meth:`looked_up` at the places of all samples of an image.

        What :meth:`mean` is then the transpose of.
        """
        return np.asarray(cotangent, dtype=np.float32) / _above(self._sums(mi.Vector1f(1.0), place))

    def _sums(self, value: Any, place: Any) -> Float32Array:
        """Sums of values over the pixels that show their places, shape (H, W, channels of the values)."""
        width, height = self.size
        image = dr.zeros(mi.Float, len(value) * width * height)
        for first, weight, there in self._pixels(place):
            dr.scatter_add(image, weight * value, first, there)
        return np.array(image, dtype=np.float32).reshape(height, width, len(value))

    def _pixels(self, place: Any) -> Iterator[tuple[Any, Any, Any]]:
        """The pixels that show places: index in the image, share of it, and whether the image has that pixel."""
        across, down = (list(self._along(axis, place[axis] * side)) for axis, side in enumerate(self.size))
        for row, of_row, in_row in down:
            for column, of_column, in_column in across:
                yield mi.UInt32(row * self.size[0] + column), of_row * of_column, in_row & in_column

    def _along(self, axis: int, at: Any) -> Iterator[tuple[Any, Any, Any]]:
        """The same along one axis, of places in pixels."""
        radius = float(self._filter.radius())
        sampled = (at >= -self._beyond) & (at <= self.size[axis] + self._beyond)
        first = mi.Int32(dr.floor(at - radius + 0.5))
        for index in range(math.ceil(2.0 * radius)):
            pixel = first + index
            there = sampled & (pixel >= 0) & (pixel < self.size[axis])
            weight = self._filter.eval(at - 0.5 - mi.Float(pixel)) if radius > 0.5 else mi.Float(1.0)
            yield pixel, weight * dr.gather(mi.Float, self._norms[axis], mi.UInt32(pixel), there), there


def _above(weights: Float32Array) -> Float32Array:
    """Weights of pixels, and 1 where there is no sample."""
    return np.where(weights > 0.0, weights, np.float32(1.0))


def _mix_of(film: Any, channels: int) -> Any:
    """What the channels of a film that are colours have of red, green and blue, shape (C, 3)."""
    if channels < 3:
        return LUMINANCE
    return XYZ if "pixel_format = xyz" in str(film) else np.eye(3)

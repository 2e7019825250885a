"""Arrays that hold the same numbers in unusual ways, and arrays that hold what is no image."""

from __future__ import annotations

import numpy as np

from loi_core.support.arrays import Host

__all__ = [
    "big_endian",
    "booleans",
    "bytes_of_image",
    "complex_numbers",
    "masked",
    "negative_strides",
    "objects",
    "read_only",
    "strided",
    "zero_strides",
]


def strided(image: Host) -> Host:
    """Every other pixel of a larger array, its channels first in memory: not contiguous in any order."""
    height, width, channels = image.shape
    larger = np.full((channels, 2 * height, 3 * width), np.nan, image.dtype)
    view = np.moveaxis(larger, 0, -1)[::2, ::3]
    view[...] = image
    return view


def negative_strides(image: Host) -> Host:
    """Stored upside down and from right to left."""
    return np.ascontiguousarray(image[::-1, ::-1])[::-1, ::-1]


def zero_strides(image: Host) -> Host:
    """The first channel, seen as all of them without a copy."""
    return np.broadcast_to(image[..., :1], image.shape)


def read_only(image: Host) -> Host:
    """Memory that may not be written to."""
    copy = image.copy()
    copy.flags.writeable = False
    return copy


def big_endian(image: Host) -> Host:
    """In the byte order of another machine."""
    return image.astype(image.dtype.newbyteorder(">" if np.little_endian else "<"))


def masked(image: Host) -> Host:
    """With a mask that says which pixels do not count."""
    hidden: Host = np.ma.MaskedArray(image, mask=image > 0.5)
    return hidden


def bytes_of_image(image: Host) -> Host:
    """As a PNG file holds it: 0 to 255."""
    return (image * 255.0).astype(np.uint8)


def booleans(image: Host) -> Host:
    """A silhouette."""
    return image > 0.5


def complex_numbers(image: Host) -> Host:
    """As a Fourier transform returns it."""
    return image.astype(np.complex64)


def objects(image: Host) -> Host:
    """Python numbers, one by one."""
    return image.astype(object)

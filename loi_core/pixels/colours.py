"""The compared quantities of colours: channels, or their differences, which white light does not change."""

from __future__ import annotations

import math
from typing import Final, Literal, get_args

from loi_core.errors import OptionError
from loi_core.support.arrays import Array, namespace
from loi_core.support.wording import shown

__all__ = ["CHANNELS", "LARGEST_FACTOR", "Colours", "check_colours", "differences", "differences_pullback"]

Colours = Literal["channels", "differences"]

CHANNELS: Final = 3
"""Number of channels of images whose colours may differ."""

LARGEST_FACTOR: Final = math.sqrt(3.0) / 2.0
"""Largest factor by which :func:`differences_pullback` multiplies the 2-norm of a cotangent."""


def check_colours(colours: object, channels: int | None) -> Colours:
    """Return `colours` if it is valid for images with this number of channels, None for images without a channel axis.

    Raises
    ------
    OptionError
        For another name, and for differences of images without three channels.
    """
    for name in get_args(Colours):
        if isinstance(colours, str) and colours == name:
            if name == "differences" and channels != CHANNELS:
                msg = f"`colours` may be 'differences' for images of three channels, got images of {channels or 'none'}"
                raise OptionError(msg)
            checked: Colours = name
            return checked
    msg = f"`colours` must be 'channels' or 'differences', got {shown(colours)}"
    raise OptionError(msg)


def differences(planes: Array, middle: float) -> Array:
    """Return half of red - green, green - blue and blue - red, plus `middle`, for planes of shape (3 N, H, W).

    Values within bounds stay within them if `middle` is the middle of the bounds.
    """
    xp = namespace(planes)
    halves = _by_image(planes) * 0.5  # before they are subtracted: no two finite values overflow
    return xp.reshape(halves - xp.roll(halves, -1, axis=1) + middle, planes.shape)


def differences_pullback(cotangent: Array) -> Array:
    """Return the cotangent of the planes, shape (3 N, H, W), from the cotangent of :func:`differences`."""
    xp = namespace(cotangent)
    halves = _by_image(cotangent) * 0.5
    return xp.reshape(halves - xp.roll(halves, 1, axis=1), cotangent.shape)


def _by_image(planes: Array) -> Array:
    return namespace(planes).reshape(planes, (-1, CHANNELS, *planes.shape[1:]))

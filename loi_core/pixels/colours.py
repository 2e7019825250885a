"""What of the colours is compared: the channels, or their differences, in which white light leaves no trace."""

from __future__ import annotations

import math
from typing import Final, Literal, get_args

from loi_core.errors import OptionError
from loi_core.support.arrays import Array, namespace
from loi_core.support.wording import shown

__all__ = ["LARGEST_FACTOR", "Colours", "check_colours", "differences", "differences_pullback"]

Colours = Literal["channels", "differences"]

CHANNELS: Final = 3
LARGEST_FACTOR: Final = math.sqrt(3.0) / 2.0
"""The most that :func:`differences_pullback` multiplies the 2-norm of a cotangent by."""


def check_colours(colours: object, channels: int | None) -> Colours:
    """`colours` itself, once it is known to be one that images of so many channels have.

    Raises
    ------
    OptionError
        For another name, and for differences of images without three channels.
    """
    for known in get_args(Colours):
        if isinstance(colours, str) and colours == known:
            if known == "differences" and channels != CHANNELS:
                msg = (
                    f"`colours` may be 'differences' for images of three channels, `reference` has {channels or 'none'}"
                )
                raise OptionError(msg)
            checked: Colours = known
            return checked
    msg = f"`colours` must be 'channels' or 'differences', got {shown(colours)}"
    raise OptionError(msg)


def differences(planes: Array, middle: float) -> Array:
    """Half of red - green, green - blue and blue - red, around `middle`: of planes, shape (3 N, H, W), as many.

    Values within bounds stay within them, if `middle` is the middle of the bounds.
    """
    xp = namespace(planes)
    halves = _by_image(planes) * 0.5  # before they are subtracted: no two finite values overflow
    return xp.reshape(halves - xp.roll(halves, -1, axis=1) + middle, planes.shape)


def differences_pullback(cotangent: Array) -> Array:
    """Carry a cotangent of :func:`differences` back to the planes, shape (3 N, H, W)."""
    xp = namespace(cotangent)
    halves = _by_image(cotangent) * 0.5
    return xp.reshape(halves - xp.roll(halves, 1, axis=1), cotangent.shape)


def _by_image(planes: Array) -> Array:
    return namespace(planes).reshape(planes, (-1, CHANNELS, *planes.shape[1:]))

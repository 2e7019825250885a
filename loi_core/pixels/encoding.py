"""Light as renderers count it, and as files and displays encode it (sRGB, IEC 61966-2-1)."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import numpy as np

from loi_core.errors import OptionError
from loi_core.support.arrays import Host
from loi_core.support.wording import shown

__all__ = ["Encoding", "check_encoding", "decode_srgb", "encode_srgb"]

Encoding: TypeAlias = Literal["linear", "sRGB"]

KNEE = 0.0031308  # of linear light: below, the curve is straight
SLOPE = 12.92


def check_encoding(encoding: object) -> Encoding:
    """`encoding` as it is spelled here, whatever its case.

    Raises
    ------
    OptionError
        If it is not known.
    """
    for known in get_args(Encoding):
        if isinstance(encoding, str) and encoding.casefold() == known.casefold():
            return known  # type: ignore[no-any-return]  # get_args is untyped
    msg = f"`encoding` must be 'linear' or 'sRGB', got {shown(encoding)}"
    raise OptionError(msg)


def decode_srgb(values: Host) -> Host:
    """Linear light of values encoded as sRGB; straight below 0, and on along the curve beyond 1."""
    values = np.asarray(values)
    curve = ((np.maximum(values, 0.0) + 0.055) / 1.055) ** 2.4
    return np.where(values <= SLOPE * KNEE, values / SLOPE, curve)


def encode_srgb(light: Host) -> Host:
    """Linear light encoded as sRGB; straight below 0, and on along the curve beyond 1."""
    light = np.asarray(light)
    curve = 1.055 * np.maximum(light, KNEE) ** (1.0 / 2.4) - 0.055
    return np.where(light <= KNEE, light * SLOPE, curve)

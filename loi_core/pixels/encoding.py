"""Encoding of light: linear, as renderers compute it, and sRGB (IEC 61966-2-1), as files and displays hold it."""

from __future__ import annotations

from typing import Final, Literal, TypeAlias, get_args

from loi_core.errors import OptionError
from loi_core.support.arrays import Array, namespace
from loi_core.support.wording import shown

__all__ = ["Encoding", "check_encoding", "decode_srgb", "encode_srgb"]

Encoding: TypeAlias = Literal["linear", "sRGB"]

LINEAR_LIMIT: Final = 0.0031308  # linear light; below it the curve is a straight line
LINEAR_SLOPE: Final = 12.92


def check_encoding(encoding: object) -> Encoding:
    """Return `encoding` in its canonical spelling, whatever its case.

    Raises
    ------
    OptionError
        If it is unknown.
    """
    for spelling in get_args(Encoding):
        if isinstance(encoding, str) and encoding.casefold() == spelling.casefold():
            return spelling  # type: ignore[no-any-return]  # get_args is untyped
    msg = f"`encoding` must be 'linear' or 'sRGB', got {shown(encoding)}"
    raise OptionError(msg)


def decode_srgb(encoded: Array) -> Array:
    """Return linear light of sRGB values, an array of any library; the line extends below 0, the curve beyond 1."""
    xp = namespace(encoded)
    on_line = encoded <= LINEAR_SLOPE * LINEAR_LIMIT
    curve = ((xp.where(on_line, xp.ones_like(encoded), encoded) + 0.055) / 1.055) ** 2.4
    return xp.where(on_line, encoded / LINEAR_SLOPE, curve)


def encode_srgb(light: Array) -> Array:
    """Return linear light as sRGB values, an array of any library; the line extends below 0, the curve beyond 1.

    Its derivative is finite everywhere, also for frameworks that differentiate both branches.
    """
    xp = namespace(light)
    on_line = light <= LINEAR_LIMIT
    curve = 1.055 * xp.where(on_line, xp.ones_like(light), light) ** (1.0 / 2.4) - 0.055
    return xp.where(on_line, light * LINEAR_SLOPE, curve)

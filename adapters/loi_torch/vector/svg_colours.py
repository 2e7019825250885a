"""Colours of SVG, which are sRGB, and the linear RGB that shapes are mixed in."""

from __future__ import annotations

import re
from typing import Final

import numpy as np
from svgelements import Color

from loi_core.renderers.checks import FloatArray

__all__ = ["CORNERS", "NAMESPACE", "read_colour", "spell_colour"]

NAMESPACE: Final = "http://www.w3.org/2000/svg"

CORNERS: Final = "data-loi-corners"
"""The attribute that holds the four colours of a bilinear fill, which SVG has no other place for."""

NUMBER: Final = r"\s*([+-]?[0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]+)?|[+-]?\.[0-9]+)(%?)\s*"
FUNCTION: Final = re.compile(rf"rgb\({NUMBER},{NUMBER},{NUMBER}\)")
NAME: Final = re.compile(r"#[0-9a-fA-F]{3}|#[0-9a-fA-F]{6}|[a-zA-Z]+")


def read_colour(text: str) -> FloatArray | None:
    """Linear RGB, shape (3,), of ``#rgb``, ``#rrggbb``, ``rgb(...)`` or a name; None if it is none of them."""
    function = FUNCTION.fullmatch(text)
    if function:
        parts = function.groups()
        values = [float(parts[at]) / (100.0 if parts[at + 1] else 255.0) for at in (0, 2, 4)]
    elif NAME.fullmatch(text):
        try:
            colour = Color(text)
        except ValueError:
            return None
        if colour.value is None:
            return None
        values = [one / 255.0 for one in (colour.red, colour.green, colour.blue)]
    else:
        return None
    return _linear(np.clip(np.array(values, dtype=np.float64), 0.0, 1.0))


def spell_colour(colour: FloatArray) -> str:
    """Linear RGB as ``rgb(...)`` with more digits than a byte has, so that reading it gives the same colour."""
    encoded = 100.0 * _encoded(np.clip(np.asarray(colour, dtype=np.float64)[:3], 0.0, 1.0))
    return f"rgb({', '.join(f'{one:.10f}%' for one in encoded)})"


def _linear(encoded: FloatArray) -> FloatArray:
    linear: FloatArray = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return linear


def _encoded(linear: FloatArray) -> FloatArray:
    encoded: FloatArray = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    return encoded

"""Conversion between SVG's sRGB colours and linear RGB."""

from __future__ import annotations

import re
from typing import Final

import numpy as np
from PIL import ImageColor

from loi_core.pixels.encoding import decode_srgb, encode_srgb
from loi_core.renderers.validation import FloatArray

__all__ = ["CORNERS", "NAMESPACE", "read_colour", "spell_colour"]

NAMESPACE: Final = "http://www.w3.org/2000/svg"

CORNERS: Final = "data-loi-corners"
"""The attribute that holds the four colours of a bilinear fill, which SVG has no other place for."""

NUMBER: Final = r"([+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:e[+-]?[0-9]+)?)(%?)"
COMMAS: Final = re.compile(rf"rgba?\(\s*{NUMBER}\s*,\s*{NUMBER}\s*,\s*{NUMBER}\s*(?:,\s*{NUMBER}\s*)?\)")
SPACES: Final = re.compile(rf"rgba?\(\s*{NUMBER}\s+{NUMBER}\s+{NUMBER}\s*(?:/\s*{NUMBER}\s*)?\)")
NAME: Final = re.compile(rf"#[0-9a-f]{{3,8}}|{'|'.join(ImageColor.colormap)}")


def read_colour(text: str) -> FloatArray | None:
    """Return linear RGB and opacity, shape (4,); None if it is no colour.

    Supports ``#rgb``, ``#rrggbb`` and ``rgb(...)``, each also with an opacity, and the names of CSS.
    """
    text = text.lower()
    if NAME.fullmatch(text):
        try:
            values = [byte / 255.0 for byte in ImageColor.getrgb(text)]
        except ValueError:
            return None
    else:
        commas, spaces = COMMAS.fullmatch(text), SPACES.fullmatch(text)
        match = commas or spaces
        if match is None or (commas and len(set(commas.groups()[1:6:2])) > 1):  # percent for all, or for none
            return None
        values = [
            float(number) / (100.0 if percent else maximum)
            for number, percent, maximum in zip(
                match.groups()[::2], match.groups()[1::2], (255.0,) * 3 + (1.0,), strict=True
            )
            if number is not None
        ]
    colour = np.clip(np.array([*values, 1.0][:4], dtype=np.float64), 0.0, 1.0)
    return np.append(decode_srgb(colour[:3]), colour[3])


def spell_colour(colour: FloatArray) -> str:
    """Return linear RGB as ``rgb(...)`` with more digits than a byte has, so that reading it gives the same colour."""
    encoded = 100.0 * encode_srgb(np.clip(np.asarray(colour, dtype=np.float64)[:3], 0.0, 1.0))
    return f"rgb({', '.join(f'{channel:.10f}%' for channel in encoded)})"

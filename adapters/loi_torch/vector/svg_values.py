"""Elements of SVG and the values of their attributes: numbers, lengths and colours."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Final, NoReturn

import numpy as np

from loi_core.errors import SvgError
from loi_core.renderers.validation import FloatArray
from loi_core.support.wording import printable, shown
from loi_torch.vector.coverage import MAX_COORDINATE_PX
from loi_torch.vector.svg_colours import read_colour

__all__ = ["NUMBER_PATTERN", "PIXELS", "Element", "fail"]

PIXELS: Final = {  # of each unit
    "px": 1.0,
    "mm": 96.0 / 25.4,
    "cm": 96.0 / 2.54,
    "in": 96.0,
    "pt": 96.0 / 72.0,
    "pc": 16.0,
}
# Possessive quantifiers, to avoid quadratic backtracking.
NUMBER_PATTERN: Final = r"[+-]?+(?:[0-9]++(?:\.[0-9]++)?+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?+"
LIST: Final = re.compile(rf"\s*+(?:{NUMBER_PATTERN}\s*+(?:,\s*+(?=[-+.0-9]))?)*+")
LENGTH: Final = re.compile(rf"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)({'|'.join(PIXELS)})?\s*")


def fail(path: pathlib.Path, message: str) -> NoReturn:
    """Raise :class:`SvgError`, which names the file."""
    raise SvgError(printable(f"{path}: {message}"))


@dataclass(frozen=True)
class Element:
    """An element of a file, with its attributes, its style with inherited properties, and its matrix to pixels.

    The errors of its methods name the file, the element and the attribute.
    """

    path: pathlib.Path
    tag: str
    attributes: Mapping[str, str]
    style: Mapping[str, str]
    matrix: FloatArray = field(default_factory=lambda: np.eye(3))

    def fail(self, message: str) -> NoReturn:
        """Raise :class:`SvgError`, which names the file and the element."""
        fail(self.path, f"<{self.tag}>: {message}")

    def text(self, key: str, default: str) -> str:
        """Return an attribute that is not inherited."""
        return self.attributes.get(key, default)

    def number(self, key: str, text: str, units: Collection[str] = ("px",)) -> float:
        """Return a number, alone or with one of `units`, in pixels at 96 per inch."""
        match = LENGTH.fullmatch(text)
        if (
            match is None
            or (match[2] or "px") not in units
            or not abs(result := float(match[1]) * PIXELS[match[2] or "px"]) <= MAX_COORDINATE_PX
        ):
            names = ", ".join(units)
            self.fail(f"`{key}` must be a number up to {MAX_COORDINATE_PX:g}, alone or in {names}, got {shown(text)}")
        return result

    def share(self, key: str, text: str) -> float:
        """Return a fraction such as an opacity, a number or a percentage, clipped to [0, 1]."""
        number = self.number(key, text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
        return min(max(number, 0.0), 1.0)

    def numbers(self, key: str, text: str) -> list[float]:
        """Return numbers separated by spaces, commas, or signs."""
        if LIST.fullmatch(text) is None:
            self.fail(f"`{key}` must be numbers, got {shown(text)}")
        return [self.number(key, number) for number in re.findall(NUMBER_PATTERN, text)]

    def colour(self, key: str, text: str) -> FloatArray:
        """Return a colour as linear RGB and opacity, shape (4,)."""
        colour = read_colour(text)
        if colour is None:
            explanation = ", a gradient or a pattern" if text.startswith("url(") else ""
            self.fail(f"`{key}` must be none, #rgb, #rrggbb, rgb(...) or a name, got {shown(text)}{explanation}")
        return colour

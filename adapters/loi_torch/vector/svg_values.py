"""Values of SVG attributes: numbers, lengths and colours."""

from __future__ import annotations

import pathlib
import re
from dataclasses import dataclass
from typing import Final, NoReturn

from loi_core.errors import SvgError
from loi_core.renderers.validation import FloatArray
from loi_core.support.wording import printable, shown
from loi_torch.vector.coverage import MAX_COORDINATE_PX
from loi_torch.vector.svg_colours import read_colour

__all__ = ["NUMBER_PATTERN", "PIXELS", "Values"]

DIGITS: Final = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
NUMBER: Final = re.compile(rf"\s*({DIGITS})(?:px)?\s*")
LENGTH: Final = re.compile(rf"\s*({DIGITS})(px|mm|cm|in|pt|pc)?\s*")
PIXELS: Final = {  # of each unit
    "px": 1.0,
    "mm": 96.0 / 25.4,
    "cm": 96.0 / 2.54,
    "in": 96.0,
    "pt": 96.0 / 72.0,
    "pc": 16.0,
}
# Possessive quantifiers, to avoid quadratic backtracking.
NUMBER_PATTERN: Final = r"[+-]?(?:[0-9]++(?:\.[0-9]++)?|\.[0-9]++)(?:[eE][+-]?[0-9]++)?"
LIST: Final = re.compile(rf"\s*+(?:{NUMBER_PATTERN}\s*+(?:,\s*+(?=[-+.0-9]))?)*+")


@dataclass(frozen=True)
class Values:
    """Reads values out of one file; its errors name the file, the element and the attribute."""

    path: pathlib.Path

    def fail(self, message: str) -> NoReturn:
        """Raise :class:`SvgError`, which names the file."""
        raise SvgError(printable(f"{self.path}: {message}"))

    def number(self, tag: str, key: str, text: str, *, percent: bool = False) -> float:
        """Return a number, alone or in px; with `percent` also a percentage, 0.5 for 50%."""
        share = percent and text.endswith("%")
        match = NUMBER.fullmatch(text[:-1] if share else text)
        if match is None or abs(float(match[1])) > MAX_COORDINATE_PX:
            self.fail(
                f"<{tag}>: `{key}` must be a number up to {MAX_COORDINATE_PX:g}, alone or in px, got {shown(text)}"
            )
        return float(match[1]) * (0.01 if share else 1.0)

    def share(self, tag: str, key: str, text: str) -> float:
        """Return a fraction such as an opacity, a number or a percentage, clipped to [0, 1]."""
        return min(max(self.number(tag, key, text, percent=True), 0.0), 1.0)

    def length(self, tag: str, key: str, text: str) -> float:
        """Return a length in pixels, at 96 per inch."""
        match = LENGTH.fullmatch(text)
        if match is None or not abs(result := float(match[1]) * PIXELS[match[2] or "px"]) <= MAX_COORDINATE_PX:
            units = ", ".join(PIXELS)
            self.fail(
                f"<{tag}>: `{key}` must be a number up to {MAX_COORDINATE_PX:g}, alone or in {units}, got {shown(text)}"
            )
        return result

    def numbers(self, tag: str, key: str, text: str) -> list[float]:
        """Return numbers separated by spaces, commas, or signs."""
        if LIST.fullmatch(text) is None:
            self.fail(f"<{tag}>: `{key}` must be numbers, got {shown(text)}")
        return [self.number(tag, key, number) for number in re.findall(NUMBER_PATTERN, text)]

    def colour(self, tag: str, key: str, text: str) -> FloatArray:
        """Return a colour as linear RGB and opacity, shape (4,)."""
        colour = read_colour(text)
        if colour is None:
            self.fail(f"<{tag}>: `{key}` must be none, #rgb, #rrggbb, rgb(...) or a name, got {shown(text)}")
        return colour

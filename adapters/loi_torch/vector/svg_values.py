"""What attributes of SVG say: numbers, colours and transforms."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NoReturn

import numpy as np
import svgelements as svg

from loi_core.errors import SvgError
from loi_core.renderers.checks import FloatArray
from loi_core.support.wording import printable, shown
from loi_torch.vector.coverage import FARTHEST
from loi_torch.vector.svg_colours import read_colour

__all__ = ["Values"]

NUMBER: Final = re.compile(r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?:px)?\s*")


@dataclass(frozen=True)
class Values:
    """Reads values out of one file; its errors name the file, the element and the attribute."""

    path: pathlib.Path

    def fail(self, message: str) -> NoReturn:
        """Raise :class:`SvgError`, which names the file."""
        raise SvgError(printable(f"{self.path}: {message}"))

    def number(self, tag: str, key: str, text: str, *, percent: bool = False) -> float:
        """A number, alone or in px; with `percent` also a share, 50% being 0.5."""
        share = percent and text.endswith("%")
        match = NUMBER.fullmatch(text[:-1] if share else text)
        if match is None or abs(float(match[1])) > FARTHEST:
            self.fail(f"<{tag}>: `{key}` must be a number up to {FARTHEST:g}, alone or in px, got {shown(text)}")
        return float(match[1]) * (0.01 if share else 1.0)

    def colour(self, tag: str, key: str, text: str) -> FloatArray:
        """A colour as linear RGB, shape (3,)."""
        colour = read_colour(text)
        if colour is None:
            self.fail(f"<{tag}>: `{key}` must be none, #rgb, #rrggbb, rgb(...) or a name, got {shown(text)}")
        return colour

    def transform(self, tag: str, own: Mapping[str, str]) -> FloatArray:
        """The element's own transform, shape (3, 3); the identity if it has none."""
        text = own.get("transform", "")
        try:
            matrix = svg.Matrix(text)
            values = [[matrix.a, matrix.c, matrix.e], [matrix.b, matrix.d, matrix.f], [0.0, 0.0, 1.0]]
            result = np.array(values, dtype=np.float64)
        except Exception:  # noqa: BLE001 - the library raises whatever its arithmetic does
            self.fail(f"<{tag}>: `transform` = {shown(text)} cannot be read")
        if not np.all(np.abs(result) <= FARTHEST):
            self.fail(f"<{tag}>: `transform` must stay within {FARTHEST:g}, got {shown(text)}")
        return result

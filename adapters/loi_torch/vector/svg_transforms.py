"""Transforms of SVG, as attributes or as CSS writes them; svgelements multiplies their matrices."""

from __future__ import annotations

import re
from typing import Final

import numpy as np
import svgelements as svg

from loi_core.renderers.validation import FloatArray
from loi_core.support.wording import shown
from loi_torch.vector.coverage import MAX_COORDINATE_PX
from loi_torch.vector.svg_values import NUMBER_PATTERN, PIXELS, Element

__all__ = ["read_transform"]

GAP: Final = r"\s*+(?:,\s*+)?+(?=[-+.0-9])"
UNITS: Final = f"(?:{'|'.join(PIXELS)})"
LENGTH: Final = f"{NUMBER_PATTERN}{UNITS}?+"
ANGLE: Final = f"{NUMBER_PATTERN}(?:deg|grad|rad|turn)?+"
ARGUMENTS: Final = {
    "matrix": GAP.join([NUMBER_PATTERN] * 4 + [LENGTH] * 2),
    "translate": f"{LENGTH}(?:{GAP}{LENGTH})?+",
    "translate[XY]": LENGTH,
    "scale": f"{NUMBER_PATTERN}(?:{GAP}{NUMBER_PATTERN})?+",
    "scale[XY]": NUMBER_PATTERN,
    "rotate": f"{ANGLE}(?:{GAP}{LENGTH}{GAP}{LENGTH})?+",
    "skew": f"{ANGLE}{GAP}{ANGLE}",
    "skew[XY]": ANGLE,
}
FUNCTION: Final = "|".join(rf"{name}\s*+\(\s*+{arguments}\s*+\)" for name, arguments in ARGUMENTS.items())
TRANSFORM: Final = re.compile(rf"none|(?:(?:{FUNCTION})\s*+(?:,\s*+(?=[A-Za-z]))?+)*+")
NUMBER: Final = re.compile(NUMBER_PATTERN)
LENGTH_WITH_UNIT: Final = re.compile(f"({NUMBER_PATTERN})({UNITS})")


def read_transform(element: Element) -> FloatArray:
    """Return the matrix of an element's ``transform``, shape (3, 3).

    Raises
    ------
    SvgError
        If it is no list of supported functions with the right number of arguments, or exceeds the limit.
    """
    text = element.text("transform", "")
    if not TRANSFORM.fullmatch(text):  # the library would skip unknown functions
        element.fail(f"`transform` = {shown(text)} cannot be read")
    # The library's millimetre is 5e-7 too long.
    pixels = LENGTH_WITH_UNIT.sub(lambda match: repr(float(match[1]) * PIXELS[match[2]]), text)
    matrix = svg.Matrix(pixels)
    result = np.array([[matrix.a, matrix.c, matrix.e], [matrix.b, matrix.d, matrix.f], [0.0, 0.0, 1.0]])
    numbers = [abs(float(number)) for number in NUMBER.findall(pixels)]
    if max(numbers, default=0.0) > MAX_COORDINATE_PX or not np.all(np.abs(result) <= MAX_COORDINATE_PX):
        element.fail(f"`transform` must stay within {MAX_COORDINATE_PX:g}, got {shown(text)}")
    return result

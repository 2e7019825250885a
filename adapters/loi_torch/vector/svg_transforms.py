"""Transforms of SVG, as attributes or as CSS writes them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Final

import numpy as np

from loi_core.renderers.validation import FloatArray
from loi_core.support.wording import shown
from loi_torch.vector.coverage import MAX_COORDINATE_PX
from loi_torch.vector.svg_values import NUMBER_PATTERN, PIXELS, Values

__all__ = ["read_transform"]

# Possessive quantifiers, to avoid quadratic backtracking.
FUNCTION: Final = re.compile(r"([A-Za-z]++)\s*+\(([^()]*+)\)\s*+")
NEXT: Final = re.compile(r",?\s*+(?=[A-Za-z])")
VALUE: Final = re.compile(rf"({NUMBER_PATTERN})([a-z]*+)\s*+")
COMMA: Final = re.compile(r"(?:,\s*+)?(?=[-+.0-9])")

PLAIN: Final = {"": 1.0}
LENGTH: Final = {**PLAIN, **PIXELS}
ANGLE: Final = {  # in radians
    "": math.tau / 360.0,
    "deg": math.tau / 360.0,
    "grad": math.tau / 400.0,
    "rad": 1.0,
    "turn": math.tau,
}


# A matrix is six numbers as SVG writes them. Arrays would take twenty times as long for so few.
_Matrix = tuple[float, float, float, float, float, float]


def _times(first: _Matrix, second: _Matrix) -> _Matrix:
    a, b, c, d, e, f = first
    g, h, i, j, k, m = second
    return a * g + c * h, b * g + d * h, a * i + c * j, b * i + d * j, a * k + c * m + e, b * k + d * m + f


def _translated(x: float, y: float = 0.0) -> _Matrix:
    return 1.0, 0.0, 0.0, 1.0, x, y


def _scaled(x: float, y: float | None = None) -> _Matrix:
    return x, 0.0, 0.0, x if y is None else y, 0.0, 0.0


def _rotated(angle: float, x: float = 0.0, y: float = 0.0) -> _Matrix:
    cos, sin = math.cos(angle), math.sin(angle)
    return cos, sin, -sin, cos, x - cos * x + sin * y, y - sin * x - cos * y


def _skewed(x: float, y: float = 0.0) -> _Matrix:
    return 1.0, math.tan(y), math.tan(x), 1.0, 0.0, 0.0


# Allowed numbers of arguments, their units, and the matrix of each function.
FUNCTIONS: Final[dict[str, tuple[tuple[int, ...], tuple[dict[str, float], ...], Callable[..., _Matrix]]]] = {
    "matrix": ((6,), (PLAIN,) * 4 + (LENGTH,) * 2, lambda *entries: entries),
    "translate": ((1, 2), (LENGTH,) * 2, _translated),
    "translateX": ((1,), (LENGTH,), _translated),
    "translateY": ((1,), (LENGTH,), lambda y: _translated(0.0, y)),
    "scale": ((1, 2), (PLAIN,) * 2, _scaled),
    "scaleX": ((1,), (PLAIN,), lambda x: _scaled(x, 1.0)),
    "scaleY": ((1,), (PLAIN,), lambda y: _scaled(1.0, y)),
    "rotate": ((1, 3), (ANGLE, LENGTH, LENGTH), _rotated),
    "skew": ((1, 2), (ANGLE,) * 2, _skewed),
    "skewX": ((1,), (ANGLE,), _skewed),
    "skewY": ((1,), (ANGLE,), lambda y: _skewed(0.0, y)),
}


def read_transform(values: Values, tag: str, text: str) -> FloatArray:
    """Return the matrix of a ``transform``, shape (3, 3).

    Raises
    ------
    SvgError
        If it is no list of supported functions with the right number of arguments, or exceeds the limit.
    """
    a, b, c, d, e, f = _product(values, tag, text.strip())
    return np.array([[a, c, e], [b, d, f], [0.0, 0.0, 1.0]])


def _product(values: Values, tag: str, text: str) -> _Matrix:
    result: _Matrix = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    if text in ("", "none"):
        return result
    at = 0
    while at < len(text):
        function = FUNCTION.match(text, at)
        matrix = None if function is None else _matrix_of(function[1], function[2].strip())
        if function is None or matrix is None:
            values.fail(f"<{tag}>: `transform` = {shown(text)} cannot be read")
        result = _times(result, matrix)
        if not all(abs(entry) <= MAX_COORDINATE_PX for entry in result):
            values.fail(f"<{tag}>: `transform` must stay within {MAX_COORDINATE_PX:g}, got {shown(text)}")
        at = function.end()
        following = NEXT.match(text, at)
        if following is None and at < len(text):
            values.fail(f"<{tag}>: `transform` = {shown(text)} cannot be read")
        at = following.end() if following else at
    return result


def _matrix_of(name: str, text: str) -> _Matrix | None:
    if name not in FUNCTIONS:
        return None
    counts, units, make = FUNCTIONS[name]
    arguments: list[float] = []
    at = 0
    while at < len(text):
        value = VALUE.match(text, at)
        if value is None or len(arguments) == counts[-1] or value[2] not in units[len(arguments)]:
            return None
        arguments.append(float(value[1]) * units[len(arguments)][value[2]])
        at = value.end()
        following = COMMA.match(text, at)
        if following is None and at < len(text):
            return None
        at = following.end() if following else at
    if len(arguments) not in counts or not all(math.isfinite(argument) for argument in arguments):
        return None
    return make(*arguments)

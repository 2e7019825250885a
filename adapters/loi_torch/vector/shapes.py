"""Shapes of vector graphics: circles, ellipses, rounded rectangles and Bezier paths, with their fills and strokes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from loi_core.errors import ParameterError
from loi_core.renderers.validation import FloatArray, check_floats
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown

__all__ = ["Cap", "Circle", "Ellipse", "Join", "Outline", "Paint", "Path", "Rectangle", "Rule", "Shape", "polygon"]

Cap = Literal["butt", "round", "square"]
Join = Literal["miter", "round", "bevel"]
Rule = Literal["nonzero", "evenodd"]
Numbers: TypeAlias = Sequence[float] | Sequence[Sequence[float]] | FloatArray


@suggest_keywords
@dataclass(frozen=True)
class Paint:
    """Fill and stroke of a shape.

    Attributes
    ----------
    fill : array, shape (4,) or (4, 4), optional
        Linear RGB and opacity: one colour, or one for each corner of the shape's bounding box before it is turned,
        in the order left top, right top, left bottom, right bottom; between them it is bilinear.
    stroke : array, shape (4,), optional
        Linear RGB and opacity. The stroke lies over the fill, half of its width inside the outline.
    width : float
        Width of the stroke in pixels.
    cap, join : str
        Ends and corners of the stroke, as in SVG. A miter longer than 4 times the width becomes a bevel.
    rule : {"nonzero", "evenodd"}
        Fill rule for an outline that winds around a point more than once.
    """

    fill: Numbers | None = None
    stroke: Numbers | None = None
    width: float = 1.0
    cap: Cap = "butt"
    join: Join = "miter"
    rule: Rule = "nonzero"

    def __post_init__(self) -> None:
        if self.fill is None and self.stroke is None:
            msg = "a shape needs a `fill`, a `stroke` or both"
            raise ParameterError(msg)
        if self.fill is not None:
            check_floats("fill", self.fill, (4, 4) if np.ndim(self.fill) == 2 else (4,))
        if self.stroke is not None:
            check_floats("stroke", self.stroke, (4,))
        _not_negative("width", self.width, ())
        for name, choices in (("cap", Cap), ("join", Join), ("rule", Rule)):
            if getattr(self, name) not in get_args(choices):
                msg = f"`{name}` must be one of {', '.join(get_args(choices))}, got {shown(getattr(self, name))}"
                raise ParameterError(msg)


@suggest_keywords
@dataclass(frozen=True)
class Circle:
    """A circle; it stays one in a fit.

    Attributes
    ----------
    centre : array, shape (2,)
        (x, y) in pixels, y down.
    radius : float
        In pixels.
    paint : Paint
    """

    centre: Numbers
    radius: float
    paint: Paint

    def __post_init__(self) -> None:
        check_floats("centre", self.centre, (2,))
        _not_negative("radius", self.radius, ())


@suggest_keywords
@dataclass(frozen=True)
class Ellipse:
    """An ellipse.

    Attributes
    ----------
    centre : array, shape (2,)
        (x, y) in pixels, y down.
    radii : array, shape (2,)
        In pixels, along x and y before it is turned.
    paint : Paint
    rotation : float
        In degrees, clockwise as seen.
    """

    centre: Numbers
    radii: Numbers
    paint: Paint
    rotation: float = 0.0

    def __post_init__(self) -> None:
        check_floats("centre", self.centre, (2,))
        _not_negative("radii", self.radii, (2,))
        check_floats("rotation", self.rotation, ())


@suggest_keywords
@dataclass(frozen=True)
class Rectangle:
    """A rectangle with rounded corners.

    Attributes
    ----------
    centre : array, shape (2,)
        (x, y) in pixels, y down.
    sides : array, shape (2,)
        Width and height in pixels, before it is turned.
    paint : Paint
    rounding : float
        Radius of the corners in pixels; half the shorter side at most.
    rotation : float
        In degrees, clockwise as seen.
    """

    centre: Numbers
    sides: Numbers
    paint: Paint
    rounding: float = 0.0
    rotation: float = 0.0

    def __post_init__(self) -> None:
        check_floats("centre", self.centre, (2,))
        _not_negative("sides", self.sides, (2,))
        _not_negative("rounding", self.rounding, ())
        check_floats("rotation", self.rotation, ())


@suggest_keywords
@dataclass(frozen=True)
class Outline:
    """One part of a path: lines and Bezier curves, end to end.

    Attributes
    ----------
    points : array, shape (m, 2)
        (x, y) in pixels, y down: where it starts, then for each segment its control points and its end. The last
        segment of a closed outline ends where it started, and that point is not repeated.
    degrees : tuple of int
        Of each segment: 1 for a line, 2 for a quadratic curve, 3 for a cubic one.
    closed : bool
    """

    points: Numbers
    degrees: tuple[int, ...]
    closed: bool = True

    def __post_init__(self) -> None:
        if not self.degrees or any(one not in (1, 2, 3) for one in self.degrees):
            msg = f"`degrees` must be 1, 2 or 3 for each segment, got {shown(self.degrees)}"
            raise ParameterError(msg)
        check_floats("points", self.points, (sum(self.degrees) + (0 if self.closed else 1), 2))


@suggest_keywords
@dataclass(frozen=True)
class Path:
    """Outlines that are filled together, so that one can be a hole in another, and stroked.

    Attributes
    ----------
    outlines : tuple of Outline
    paint : Paint
    """

    outlines: tuple[Outline, ...]
    paint: Paint

    def __post_init__(self) -> None:
        if not self.outlines:
            msg = "a path needs at least one outline"
            raise ParameterError(msg)


Shape: TypeAlias = Circle | Ellipse | Rectangle | Path
"""Any of the shapes that a drawing is made of."""


@suggest_keywords
def polygon(points: Numbers, paint: Paint, *, closed: bool = True) -> Path:
    """A path of straight lines through `points`, shape (m, 2); if it is not `closed`, it has two ends."""
    count = len(points) - (0 if closed else 1)
    return Path((Outline(points, tuple(itertools.repeat(1, count)), closed),), paint)


def _not_negative(name: str, value: object, shape: tuple[int, ...]) -> None:
    if np.any(check_floats(name, value, shape) < 0.0):
        msg = f"`{name}` must be 0 or more, got {shown(value)}"
        raise ParameterError(msg)

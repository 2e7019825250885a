"""From an element of SVG to the shape that it shows."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
import svgelements as svg

from loi_core.errors import LoiError, SvgError
from loi_core.renderers.validation import FloatArray
from loi_core.support.wording import described, shown
from loi_torch.vector.shapes import Circle, Ellipse, Paint, Path, Rectangle, Shape
from loi_torch.vector.svg_colours import CORNERS
from loi_torch.vector.svg_paths import Commands, has_dot, moved, path_outlines, without_arcs
from loi_torch.vector.svg_values import Values

__all__ = ["GEOMETRY", "MAX_POINTS", "element_shape"]

MAX_POINTS: Final = 200_000  # of all paths of a file

GEOMETRY: Final[dict[str, tuple[str, ...]]] = {
    "path": ("d",),
    "rect": ("x", "y", "width", "height", "rx", "ry"),
    "circle": ("cx", "cy", "r"),
    "ellipse": ("cx", "cy", "rx", "ry"),
    "line": ("x1", "y1", "x2", "y2"),
    "polyline": ("points",),
    "polygon": ("points",),
}
COMMANDS: Final = re.compile(  # possessive, to avoid exponential backtracking
    r"\s*+(?:[Mm](?>[MmZzLlHhVvCcSsQqTtAa, \t\n\r\f]|[+-]?(?:[0-9]++(?:\.[0-9]++)?|\.[0-9]++)(?:[eE][+-]?[0-9]++)?)*+)?"
)
LETTERS: Final = re.compile(r"[A-DF-Za-df-z]")  # each begins a segment; an e is part of a number
CLOSINGS: Final = re.compile(r"[zZ](?:[\s,]*+[zZ])++")
UNMOVED: Final = re.compile(r"[zZ][\s,]*+(?![MmZz\s,]|\Z)")
MAX_UNMOVED_PARTS: Final = 1000  # for each, the library goes back to the last move
COINCIDENCE_DISTANCE_PX: Final = 1e-9  # a stroke treats points closer together as a single point
WITHOUT_JOINS: Final = ("circle", "ellipse", "line")
SIZES: Final = ("width", "height", "r", "rx", "ry")


def element_shape(
    values: Values,
    tag: str,
    element: Mapping[str, str],
    style: Mapping[str, str],
    matrix: FloatArray,
    *,
    opacity: float,
    most_points: int,
) -> Shape | None:
    """Return the shape of an element in pixels, or None if it draws nothing.

    Parameters
    ----------
    values : Values
        Reader of the file's values.
    tag : str
        A key of ``GEOMETRY``.
    own, style : mapping of str
        The element's attributes, and its style with inherited properties.
    matrix : array, shape (3, 3)
        Transform from the element to pixels.
    opacity : float
        The element's opacity.
    most_points : int
        Remaining points of ``MAX_POINTS``.

    Raises
    ------
    SvgError
        If an attribute has a value that cannot be read or is not supported, or a path has more points.
    """
    try:
        paint = _paint(values, tag, element, style, matrix, opacity)
        if paint is None:
            return None
        number = _numbers(values, tag, element)
        if any(number.get(key, 1.0) == 0.0 for key in _extents(tag)):
            return None
        simple_shape = _plain(tag, element, number, matrix, paint)
        return (
            simple_shape
            if simple_shape is not None
            else _general(values, tag, element, number, matrix, paint, most_points)
        )
    except SvgError:
        raise
    except LoiError as error:
        values.fail(f"<{tag}>: {error}")


def _paint(
    values: Values, tag: str, element: Mapping[str, str], style: Mapping[str, str], matrix: FloatArray, opacity: float
) -> Paint | None:
    colours: dict[str, FloatArray | None] = {}
    for key in ("fill", "stroke"):
        text = style["color"] if style[key].lower() == "currentcolor" else style[key]
        share = opacity * values.share(tag, f"{key}-opacity", style[f"{key}-opacity"])
        colour = None if text.lower() in ("none", "transparent") else values.colour(tag, key, text)
        colours[key] = None if colour is None else colour * [1.0, 1.0, 1.0, share]
    if tag == "line":  # without an inside
        colours["fill"] = None
    if CORNERS in element:
        corners = [values.number(tag, CORNERS, text) for text in element[CORNERS].split()]
        if len(corners) != 16:
            values.fail(f"<{tag}>: `{CORNERS}` must be 16 numbers, got {len(corners)}")
        colours["fill"] = np.reshape(corners, (4, 4))
    linear = matrix[:2, :2]
    scale = abs(float(np.linalg.det(linear))) ** 0.5
    width = scale * values.number(tag, "stroke-width", style["stroke-width"])
    if width == 0.0:
        colours["stroke"] = None
    if colours["fill"] is None and colours["stroke"] is None:
        return None
    if colours["stroke"] is not None:
        if opacity != 1.0 and colours["fill"] is not None:
            values.fail(f"<{tag}> with `opacity`, fill and stroke is not supported; use fill- and stroke-opacity")
        if not np.allclose(linear.T @ linear, scale**2 * np.eye(2), rtol=0.0, atol=1e-9 * max(1.0, scale**2)):
            values.fail(f"<{tag}>: a stroke under a `transform` that is not a similarity is not supported")
        limit = values.number(tag, "stroke-miterlimit", style["stroke-miterlimit"])
        mitred = style["stroke-linejoin"] == "miter" and tag not in WITHOUT_JOINS
        if mitred and limit != 4.0 and not (tag == "rect" and limit >= 2.0):  # which a right angle does not reach
            values.fail(f"<{tag}>: `stroke-miterlimit` = {shown(style['stroke-miterlimit'])} is not supported")
    cap, join, rule = (style[key] for key in ("stroke-linecap", "stroke-linejoin", "fill-rule"))
    return Paint(colours["fill"], colours["stroke"], width if width else 1.0, cap, join, rule)  # type: ignore[arg-type]  # checked by it


def _extents(tag: str) -> tuple[str, ...]:
    """The lengths without which an element is not shown, also if it has a stroke."""
    return {"rect": ("width", "height"), "circle": ("r",), "ellipse": ("rx", "ry")}.get(tag, ())


def _numbers(values: Values, tag: str, element: Mapping[str, str]) -> dict[str, float]:
    """Return the numbers of an element without points, with SVG's defaults."""
    if tag in ("path", "polyline", "polygon"):
        return {}
    explicit_numbers = {
        key: values.number(tag, key, element[key]) for key in GEOMETRY[tag] if element.get(key, "auto") != "auto"
    }
    for key in SIZES:
        if explicit_numbers.get(key, 0.0) < 0.0:
            values.fail(f"<{tag}>: `{key}` must be 0 or more, got {shown(explicit_numbers[key])}")
    number = {key: explicit_numbers.get(key, 0.0) for key in GEOMETRY[tag]}
    if "rx" in number:  # one radius sets both
        number["rx"], number["ry"] = explicit_numbers.get("rx", number["ry"]), explicit_numbers.get("ry", number["rx"])
    if tag == "rect":
        number["rx"], number["ry"] = (
            min(number[f"r{axis}"], 0.5 * number[extent]) for axis, extent in (("x", "width"), ("y", "height"))
        )
    return number


def _plain(
    tag: str, element: Mapping[str, str], number: Mapping[str, float], matrix: FloatArray, paint: Paint
) -> Shape | None:
    """The element as a circle, ellipse or rectangle, if it is one that is at most scaled, turned and moved."""
    if tag not in ("circle", "ellipse", "rect"):
        return None
    x_axis, y_axis = matrix[:2, :2].T
    scale = np.array([np.linalg.norm(x_axis), np.linalg.norm(y_axis)])
    rotation = float(np.rad2deg(np.arctan2(x_axis[1], x_axis[0])))
    if abs(x_axis @ y_axis) > 1e-9 * scale.prod() or (CORNERS in element and np.linalg.det([x_axis, y_axis]) < 0.0):
        return None
    even = abs(scale[0] - scale[1]) <= 1e-9 * scale.max()
    if tag == "rect":
        extents = np.array([number["width"], number["height"]])
        rx, ry = number["rx"], number["ry"]
        if rx * ry > 0.0 and (rx != ry or not even):
            return None
        middle = np.array([number["x"], number["y"]]) + 0.5 * extents
        rounding = scale[0] * rx if rx * ry > 0.0 else 0.0
        return Rectangle(moved(middle, matrix), scale * extents, paint, float(rounding), rotation)
    centre = moved(np.array([number["cx"], number["cy"]]), matrix)
    if tag == "circle" and even:
        return Circle(centre, float(scale[0] * number["r"]), paint)
    radii = np.array([number["r"]] * 2 if tag == "circle" else [number["rx"], number["ry"]])
    return Ellipse(centre, scale * radii, paint, rotation)


def _general(
    values: Values,
    tag: str,
    element: Mapping[str, str],
    number: Mapping[str, float],
    matrix: FloatArray,
    paint: Paint,
    most_points: int,
) -> Path | None:
    if CORNERS in element and tag != "path":
        values.fail(f"<{tag}>: `{CORNERS}` under a skew or a reflection is not supported")
    try:
        if tag == "path":
            path = _commands(values, element.get("d", ""), most_points)
        elif tag in ("polyline", "polygon"):
            path = _corners(values, tag, element.get("points", ""))
        else:
            kinds = {"rect": svg.Rect, "circle": svg.Circle, "ellipse": svg.Ellipse, "line": svg.SimpleLine}
            path = svg.Path(kinds[tag](dict(number)))
        segments = list(without_arcs(path))
    except SvgError:
        raise
    except Exception as error:  # noqa: BLE001 - the library raises whatever its arithmetic does
        values.fail(f"<{tag}>: {GEOMETRY[tag][0]!r} cannot be read ({described(error)})")
    if 4 * len(segments) > most_points:
        values.fail(f"more than {MAX_POINTS} points")
    scale = max(float(np.abs(matrix[:2, :2]).max()), COINCIDENCE_DISTANCE_PX)
    if paint.stroke is not None and paint.cap != "butt" and has_dot(segments, COINCIDENCE_DISTANCE_PX / scale):
        values.fail(f"<{tag}>: a part without length, of which a {paint.cap} cap makes a dot, is not supported")
    outlines = tuple(path_outlines(segments, matrix))
    return Path(outlines, replace(paint)) if outlines else None


def _commands(values: Values, commands: str, most_points: int) -> Iterable[Any]:
    """The segments of a path."""
    if not COMMANDS.fullmatch(commands):  # the library would skip unknown characters
        values.fail(f"<path>: `d` must be commands and numbers, begun with M, got {shown(commands)}")
    if len(LETTERS.findall(commands)) > most_points:
        values.fail(f"more than {MAX_POINTS} points")
    commands = CLOSINGS.sub("Z", commands)
    if len(UNMOVED.findall(commands)) > MAX_UNMOVED_PARTS:
        values.fail(f"<path>: more than {MAX_UNMOVED_PARTS} closed parts that go on without a move")
    path: Iterable[Any] = Commands(commands)
    return path


def _corners(values: Values, tag: str, text: str) -> Iterable[Any]:
    """The segments of a polyline or polygon."""
    numbers = values.numbers(tag, "points", text)
    if len(numbers) % 2:
        values.fail(f"<{tag}>: `points` must be pairs of numbers, got {len(numbers)} numbers")
    points = list(zip(numbers[::2], numbers[1::2], strict=True))
    if not points:
        return []
    lines = [svg.Line(start, end) for start, end in itertools.pairwise(points)]
    return [svg.Move(None, points[0]), *lines, *([svg.Close(points[-1], points[0])] if tag == "polygon" else [])]

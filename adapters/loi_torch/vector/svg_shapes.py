"""From an element of SVG to the shape that it shows."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
import svgelements as svg

from loi_core.errors import LoiError, SvgError
from loi_core.renderers.validation import FloatArray
from loi_core.support.wording import described, shown
from loi_torch.vector.shapes import Circle, Ellipse, Paint, Path, Rectangle, Shape
from loi_torch.vector.svg_colours import CORNERS
from loi_torch.vector.svg_paths import Commands, moved, path_outlines, without_arcs
from loi_torch.vector.svg_values import NUMBER_PATTERN, Element

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
EXTENTS: Final = {"rect": ("width", "height"), "circle": ("r",), "ellipse": ("rx", "ry")}
"""The lengths without which an element is not shown, also if it has a stroke."""

COMMANDS: Final = re.compile(rf"\s*+(?:[Mm](?>[MmZzLlHhVvCcSsQqTtAa, \t\n\r\f]|{NUMBER_PATTERN})*+)?")
LETTERS: Final = re.compile(r"[A-DF-Za-df-z]")  # each begins a segment; an e is part of a number
CLOSINGS: Final = re.compile(r"[zZ](?:[\s,]*+[zZ])++")
UNMOVED: Final = re.compile(r"[zZ][\s,]*+(?![MmZz\s,]|\Z)")
MAX_UNMOVED_PARTS: Final = 1000  # for each, the library goes back to the last move
COINCIDENCE_DISTANCE_PX: Final = 1e-9  # a stroke treats points closer together as a single point
WITHOUT_JOINS: Final = ("circle", "ellipse", "line")
SIZES: Final = ("width", "height", "r", "rx", "ry")


def element_shape(element: Element, max_points: int) -> Shape | None:
    """Return the shape of an element in pixels, or None if it draws nothing.

    Raises
    ------
    SvgError
        If an attribute has a value that cannot be read or is not supported, or a path has more than `max_points`.
    """
    try:
        paint = _paint(element)
        if paint is None:
            return None
        number = _numbers(element)
        if any(number[key] == 0.0 for key in EXTENTS.get(element.tag, ())):
            return None
        return _plain(element, number, paint) or _general(element, number, paint, max_points)
    except SvgError:
        raise
    except LoiError as error:
        element.fail(str(error))


def _paint(element: Element) -> Paint | None:
    tag, style, matrix = element.tag, element.style, element.matrix
    opacity = element.share("opacity", element.text("opacity", "1"))
    fill, stroke = (_colour(element, key, opacity) for key in ("fill", "stroke"))
    if tag == "line":  # without an inside
        fill = None
    if CORNERS in element.attributes:
        corners = [element.number(CORNERS, text) for text in element.attributes[CORNERS].split()]
        if len(corners) != 16:
            element.fail(f"`{CORNERS}` must be 16 numbers, got {len(corners)}")
        fill = np.reshape(corners, (4, 4))
    linear = matrix[:2, :2]
    scale = abs(float(np.linalg.det(linear))) ** 0.5
    width = scale * element.number("stroke-width", style["stroke-width"])
    if width == 0.0:
        stroke = None
    if fill is None and stroke is None:
        return None
    if stroke is not None:
        if opacity != 1.0 and fill is not None:
            element.fail("`opacity` of a fill and a stroke is not supported; use fill- and stroke-opacity")
        if not np.allclose(linear.T @ linear, scale**2 * np.eye(2), rtol=0.0, atol=1e-9 * max(1.0, scale**2)):
            element.fail("a stroke under a `transform` that is not a similarity is not supported")
        limit = element.number("stroke-miterlimit", style["stroke-miterlimit"])
        mitred = style["stroke-linejoin"] == "miter" and tag not in WITHOUT_JOINS
        if mitred and limit != 4.0 and not (tag == "rect" and limit >= 2.0):  # which a right angle does not reach
            element.fail(f"`stroke-miterlimit` = {shown(style['stroke-miterlimit'])} is not supported")
    cap, join, rule = (style[key] for key in ("stroke-linecap", "stroke-linejoin", "fill-rule"))
    return Paint(fill, stroke, width if width else 1.0, cap, join, rule)  # type: ignore[arg-type]  # checked by it


def _colour(element: Element, key: str, opacity: float) -> FloatArray | None:
    """Return the colour of a fill or a stroke with its opacity, or None without one."""
    text = element.style["color"] if element.style[key].lower() == "currentcolor" else element.style[key]
    share = opacity * element.share(f"{key}-opacity", element.style[f"{key}-opacity"])
    return None if text.lower() in ("none", "transparent") else element.colour(key, text) * [1.0, 1.0, 1.0, share]


def _numbers(element: Element) -> dict[str, float]:
    """Return the numbers of an element without points, with SVG's defaults."""
    if element.tag in ("path", "polyline", "polygon"):
        return {}
    keys = GEOMETRY[element.tag]
    explicit_numbers = {
        key: element.number(key, element.attributes[key]) for key in keys if element.text(key, "auto") != "auto"
    }
    for key in SIZES:
        if explicit_numbers.get(key, 0.0) < 0.0:
            element.fail(f"`{key}` must be 0 or more, got {shown(explicit_numbers[key])}")
    number = {key: explicit_numbers.get(key, 0.0) for key in keys}
    if "rx" in number:  # one radius sets both
        number["rx"], number["ry"] = explicit_numbers.get("rx", number["ry"]), explicit_numbers.get("ry", number["rx"])
    if element.tag == "rect":
        number["rx"], number["ry"] = (
            min(number[f"r{axis}"], 0.5 * number[extent]) for axis, extent in (("x", "width"), ("y", "height"))
        )
    return number


def _plain(element: Element, number: Mapping[str, float], paint: Paint) -> Shape | None:
    """The element as a circle, ellipse or rectangle, if it is one that is at most scaled, turned and moved."""
    tag, matrix = element.tag, element.matrix
    if tag not in EXTENTS:
        return None
    x_axis, y_axis = matrix[:2, :2].T
    scale = np.array([np.linalg.norm(x_axis), np.linalg.norm(y_axis)])
    rotation = float(np.rad2deg(np.arctan2(x_axis[1], x_axis[0])))
    mirrored = np.linalg.det([x_axis, y_axis]) < 0.0
    if abs(x_axis @ y_axis) > 1e-9 * scale.prod() or (mirrored and CORNERS in element.attributes):
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


def _general(element: Element, number: Mapping[str, float], paint: Paint, max_points: int) -> Path | None:
    tag = element.tag
    if CORNERS in element.attributes and tag != "path":
        element.fail(f"`{CORNERS}` under a skew or a reflection is not supported")
    try:
        if tag == "path":
            path: Iterable[Any] = _commands(element, max_points)
        elif tag in ("polyline", "polygon"):
            corners = element.numbers("points", element.text("points", ""))
            if len(corners) % 2:
                element.fail(f"`points` must be pairs of numbers, got {len(corners)} numbers")
            path = svg.Path({"polyline": svg.Polyline, "polygon": svg.Polygon}[tag](*corners))
        else:
            kinds = {"rect": svg.Rect, "circle": svg.Circle, "ellipse": svg.Ellipse, "line": svg.SimpleLine}
            path = svg.Path(kinds[tag](dict(number)))
        segments = list(without_arcs(path))
    except SvgError:
        raise
    except Exception as error:  # noqa: BLE001 - the library raises whatever its arithmetic does
        element.fail(f"{GEOMETRY[tag][0]!r} cannot be read ({described(error)})")
    if 4 * len(segments) > max_points:
        element.fail(f"more than {MAX_POINTS} points")
    outlines, extent = path_outlines(segments, element.matrix)
    if paint.stroke is not None and paint.cap != "butt" and extent <= COINCIDENCE_DISTANCE_PX:
        element.fail(f"a part without length, of which a {paint.cap} cap makes a dot, is not supported")
    return Path(tuple(outlines), paint) if outlines else None


def _commands(element: Element, max_points: int) -> Iterable[Any]:
    """The segments of a path."""
    commands = element.text("d", "")
    if not COMMANDS.fullmatch(commands):  # the library would skip unknown characters
        element.fail(f"`d` must be commands and numbers, begun with M, got {shown(commands)}")
    if len(LETTERS.findall(commands)) > max_points:
        element.fail(f"more than {MAX_POINTS} points")
    commands = CLOSINGS.sub("Z", commands)
    if len(UNMOVED.findall(commands)) > MAX_UNMOVED_PARTS:
        element.fail(f"more than {MAX_UNMOVED_PARTS} closed parts that go on without a move")
    path: Iterable[Any] = Commands(commands)
    return path

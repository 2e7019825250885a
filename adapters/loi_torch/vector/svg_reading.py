"""Reading SVG: a subset that is stated, and for what is beyond it an error that names it."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, NoReturn
from xml.parsers import expat

import numpy as np
import svgelements as svg

from loi_core.errors import LoiError, SvgError
from loi_core.files import read_bytes
from loi_core.messages import printable, shown, told
from loi_core.renderers.checks import FloatArray
from loi_torch.vector.coverage import FARTHEST
from loi_torch.vector.shapes import Circle, Ellipse, Paint, Path, Rectangle, Shape
from loi_torch.vector.svg_colours import CORNERS, NAMESPACE, read_colour
from loi_torch.vector.svg_paths import moved, path_outlines

__all__ = ["Drawing", "read_svg"]

MOST_BYTES: Final = 8 * 1024 * 1024
MOST_POINTS: Final = 200_000
MOST_DEPTH: Final = 64

GEOMETRY: Final[dict[str, tuple[str, ...]]] = {
    "path": ("d",),
    "rect": ("x", "y", "width", "height", "rx", "ry"),
    "circle": ("cx", "cy", "r"),
    "ellipse": ("cx", "cy", "rx", "ry"),
    "line": ("x1", "y1", "x2", "y2"),
    "polyline": ("points",),
    "polygon": ("points",),
}
SILENT: Final = ("title", "desc", "metadata")
INHERITED: Final = {
    "fill": "black",
    "fill-opacity": "1",
    "fill-rule": "nonzero",
    "stroke": "none",
    "stroke-opacity": "1",
    "stroke-width": "1",
    "stroke-linecap": "butt",
    "stroke-linejoin": "miter",
}
HARMLESS: Final = {
    # Allowed with these values alone, which are what is done anyway; any other would change the picture.
    "stroke-dasharray": ("none",),
    "stroke-miterlimit": ("4",),
    "display": ("inline", "block"),
    "visibility": ("visible",),
    "paint-order": ("normal",),
    "overflow": ("visible", "hidden"),
    "color-interpolation": ("sRGB", "linearRGB", "auto"),
    "preserveAspectRatio": ("xMidYMid", "xMidYMid meet"),
    "mix-blend-mode": ("normal",),
}
UNSEEN: Final = re.compile(
    r"id|version|baseProfile|role|class|focusable|lang|xml:.*|xmlns.*|data-.*|aria-.*|enable-background"
    r"|shape-rendering|stroke-dashoffset|clip-rule|font-.*|text-.*|.*:.*"
)
COMMANDS: Final = re.compile(  # without going back over what has matched, which would take time without end
    r"\s*+(?:[Mm](?>[MmZzLlHhVvCcSsQqTtAa,\s]|[+-]?(?:[0-9]++\.?[0-9]*+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?)*+)?"
)
NUMBER: Final = re.compile(r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?:px)?\s*")


@dataclass(frozen=True)
class Drawing:
    """What an SVG file shows.

    Attributes
    ----------
    shapes : list of Shape
        In the order of painting, in pixels of the image.
    background : array, shape (3,)
        Linear RGB: the ``background-color`` of the root's style, or white.
    """

    shapes: list[Shape]
    background: FloatArray


@dataclass(frozen=True)
class _State:
    """What an element hands to those in it."""

    matrix: FloatArray
    style: Mapping[str, str]


def read_svg(path: pathlib.Path, height: int, width: int) -> Drawing:
    """Read shapes from an SVG file.

    Parameters
    ----------
    path : Path
    height, width : int
        Of the image in pixels. The view box is scaled to fit and centred.

    Raises
    ------
    SvgError
        If the file is missing, damaged, of more than 8 MiB or 200000 points, has a document type, or an element or
        attribute that is not supported. Nothing that it refers to is read.

    Notes
    -----
    Supported are svg, g, path, rect, circle, ellipse, line, polyline and polygon with transforms, plain fills and
    strokes, opacities, fill rules, caps and joins, as attributes or in ``style``. Arcs become cubic curves. Circles and
    rectangles that are skewed become paths.
    """
    try:
        content = read_bytes(path, MOST_BYTES)
    except (OSError, ValueError) as error:
        msg = f"{path}: cannot be read ({told(error)})"
        raise SvgError(msg) from None
    reader = _Reader(path, height, width)
    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartDoctypeDeclHandler = reader.document_type
    parser.StartElementHandler = reader.start
    parser.EndElementHandler = reader.end
    parser.CharacterDataHandler = None
    try:
        parser.Parse(content, True)  # noqa: FBT003 - it takes no keyword
    except expat.ExpatError as error:
        reader.fail(f"not well-formed XML ({told(error)})")
    if not reader.drawing.shapes:
        reader.fail("there is no shape in it")
    return reader.drawing


class _Reader:
    """Follows the elements of a document, and collects shapes."""

    def __init__(self, path: pathlib.Path, height: int, width: int) -> None:
        self.drawing = Drawing([], np.ones(3))
        self._path = path
        self._size = height, width
        self._states: list[_State] = []
        self._silent = 0
        self._points = 0

    def fail(self, message: str) -> NoReturn:
        raise SvgError(printable(f"{self._path}: {message}"))

    def document_type(self, *_: object) -> NoReturn:
        self.fail("has a document type declaration (<!DOCTYPE>), which is not read; delete it")

    def end(self, _: str) -> None:
        if self._silent:
            self._silent -= 1
        else:
            self._states.pop()

    def start(self, name: str, attributes: dict[str, str]) -> None:
        space, _, tag = name.rpartition(" ")
        if self._silent or (self._states and (tag in SILENT or space not in ("", NAMESPACE))):
            self._silent += 1
            return
        if len(self._states) >= MOST_DEPTH:
            self.fail(f"elements lie more than {MOST_DEPTH} deep")
        if (tag == "svg") == bool(self._states) or (tag not in ("svg", "g", *GEOMETRY)):
            known = f"svg (once, outermost), g, {', '.join(GEOMETRY)}"
            self.fail(f"<{tag[:40]}> is not supported here; known are {known}")
        own = self._attributes(tag, attributes)
        above = self._states[-1] if self._states else _State(np.eye(3), INHERITED)
        style = {**above.style, **{key: value for key, value in own.items() if key in INHERITED and value != "inherit"}}
        matrix = self._root(own) if tag == "svg" else above.matrix @ self._transform(tag, own)
        if not np.all(np.abs(matrix) <= FARTHEST):
            self.fail(f"<{tag}>: all transforms together must stay within {FARTHEST:g}")
        state = _State(matrix, style)
        self._states.append(state)
        opacity = self._number(tag, "opacity", own.get("opacity", "1"), percent=True)
        if tag in GEOMETRY:
            self._shape(tag, own, state, opacity)
        elif opacity != 1.0:
            self.fail(f"<{tag}> with an `opacity` is not supported; give it to each shape")

    def _attributes(self, tag: str, attributes: Mapping[str, str]) -> dict[str, str]:
        """Own attributes, those of ``style`` included, once they are known to be supported."""
        plain = {key.replace(" ", ":"): value.strip() for key, value in attributes.items()}
        styled = {}
        for part in plain.pop("style", "").split(";"):
            key, colon, value = part.partition(":")
            if colon:
                styled[key.strip()] = value.strip()
        both = plain | styled
        allowed = {*INHERITED, *GEOMETRY.get(tag, ()), "opacity", "transform"}
        if tag == "svg":
            allowed |= {"width", "height", "viewBox", "background-color", "x", "y"}
        for key, value in both.items():
            if key in allowed or key == CORNERS or UNSEEN.fullmatch(key) or value in HARMLESS.get(key, ()):
                continue
            self.fail(f"<{tag}>: `{key[:40]}` = {shown(value)} is not supported")
        return both

    def _root(self, own: Mapping[str, str]) -> FloatArray:
        height, width = self._size
        if "background-color" in own:
            self.drawing.background[:] = self._colour("svg", "background-color", own["background-color"])
        if "transform" in own:
            self.fail("<svg>: `transform` is not supported here; give it to a <g>")
        if "viewBox" in own:
            box = [self._number("svg", "viewBox", one) for one in own["viewBox"].replace(",", " ").split()]
        else:
            sides = [own.get(key, str(most)) for key, most in (("width", width), ("height", height))]
            box = [0.0, 0.0, *(self._number("svg", "width or height", one) for one in sides)]
        if len(box) != 4 or min(box[2:]) <= 0.0:
            self.fail(f"<svg>: `viewBox` must be four numbers, the last two more than 0, got {shown(own['viewBox'])}")
        scale = min(width / box[2], height / box[3])
        left, top = 0.5 * (width - scale * box[2]), 0.5 * (height - scale * box[3])
        return np.array([[scale, 0.0, left - scale * box[0]], [0.0, scale, top - scale * box[1]], [0.0, 0.0, 1.0]])

    def _transform(self, tag: str, own: Mapping[str, str]) -> FloatArray:
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

    def _number(self, tag: str, key: str, text: str, *, percent: bool = False) -> float:
        share = percent and text.endswith("%")
        match = NUMBER.fullmatch(text[:-1] if share else text)
        if match is None or abs(float(match[1])) > FARTHEST:
            self.fail(f"<{tag}>: `{key}` must be a number up to {FARTHEST:g}, alone or in px, got {shown(text)}")
        return float(match[1]) * (0.01 if share else 1.0)

    def _colour(self, tag: str, key: str, text: str) -> FloatArray:
        colour = read_colour(text)
        if colour is None:
            self.fail(f"<{tag}>: `{key}` must be none, #rgb, #rrggbb, rgb(...) or a name, got {shown(text)}")
        return colour

    def _shape(self, tag: str, own: Mapping[str, str], state: _State, opacity: float) -> None:
        try:
            paint = self._paint(tag, own, state, opacity)
            if paint is None:
                return
            plain = self._plain(tag, own, state.matrix, paint)
            shape = plain if plain is not None else self._general(tag, own, state.matrix, paint)
        except SvgError:
            raise
        except LoiError as error:
            self.fail(f"<{tag}>: {error}")
        if shape is not None:
            self.drawing.shapes.append(shape)

    def _paint(self, tag: str, own: Mapping[str, str], state: _State, opacity: float) -> Paint | None:
        colours: dict[str, FloatArray | None] = {}
        for key in ("fill", "stroke"):
            text = state.style[key]
            share = opacity * self._number(tag, f"{key}-opacity", state.style[f"{key}-opacity"], percent=True)
            plain = None if text in ("none", "transparent") else self._colour(tag, key, text)
            colours[key] = None if plain is None else np.append(plain, np.clip(share, 0.0, 1.0))
        if tag == "line":  # without an inside
            colours["fill"] = None
        if CORNERS in own:
            corners = [self._number(tag, CORNERS, one) for one in own[CORNERS].split()]
            if len(corners) != 16:
                self.fail(f"<{tag}>: `{CORNERS}` must be 16 numbers, got {len(corners)}")
            colours["fill"] = np.reshape(corners, (4, 4))
        linear = state.matrix[:2, :2]
        scale = abs(float(np.linalg.det(linear))) ** 0.5
        width = scale * self._number(tag, "stroke-width", state.style["stroke-width"])
        if width == 0.0:
            colours["stroke"] = None
        if colours["fill"] is None and colours["stroke"] is None:
            return None
        if colours["stroke"] is not None:
            if opacity != 1.0 and colours["fill"] is not None:
                self.fail(f"<{tag}> with `opacity`, fill and stroke is not supported; use fill- and stroke-opacity")
            if not np.allclose(linear.T @ linear, scale**2 * np.eye(2), rtol=0.0, atol=1e-9 * max(1.0, scale**2)):
                self.fail(f"<{tag}>: a stroke under a `transform` that is not a similarity is not supported")
        cap, join, rule = (state.style[key] for key in ("stroke-linecap", "stroke-linejoin", "fill-rule"))
        return Paint(colours["fill"], colours["stroke"], width if width else 1.0, cap, join, rule)  # type: ignore[arg-type]  # checked by it

    def _plain(self, tag: str, own: Mapping[str, str], matrix: FloatArray, paint: Paint) -> Shape | None:
        """The element as a circle, ellipse or rectangle, if it is one that is at most scaled, turned and moved."""
        if tag not in ("circle", "ellipse", "rect"):
            return None
        number = {key: self._number(tag, key, own[key]) for key in GEOMETRY[tag] if own.get(key, "auto") != "auto"}
        across, down = matrix[:2, :2].T
        scale = np.array([np.linalg.norm(across), np.linalg.norm(down)])
        rotation = float(np.rad2deg(np.arctan2(across[1], across[0])))
        if abs(across @ down) > 1e-9 * scale.prod() or (CORNERS in own and np.linalg.det([across, down]) < 0.0):
            return None
        even = abs(scale[0] - scale[1]) <= 1e-9 * scale.max()
        if tag == "rect":
            sides = np.array([number.get("width", 0.0), number.get("height", 0.0)])
            rx, ry = number.get("rx", number.get("ry", 0.0)), number.get("ry", number.get("rx", 0.0))
            rx, ry = min(rx, 0.5 * sides[0]), min(ry, 0.5 * sides[1])
            if min(*sides, rx, ry) < 0.0:
                self.fail(f"<rect>: sides and radii must be 0 or more, got {shown(dict(number))}")
            if rx * ry > 0.0 and (rx != ry or not even):
                return None
            middle = np.array([number.get("x", 0.0), number.get("y", 0.0)]) + 0.5 * sides
            rounding = scale[0] * rx if rx * ry > 0.0 else 0.0
            return Rectangle(moved(middle, matrix), scale * sides, paint, float(rounding), rotation)
        centre = moved(np.array([number.get("cx", 0.0), number.get("cy", 0.0)]), matrix)
        if tag == "circle" and even:
            return Circle(centre, float(scale[0] * number.get("r", 0.0)), paint)
        radius = number.get("r", 0.0)
        radii = np.array([number.get("rx", radius), number.get("ry", radius)])
        return Ellipse(centre, scale * radii, paint, rotation)

    def _general(self, tag: str, own: Mapping[str, str], matrix: FloatArray, paint: Paint) -> Path | None:
        if CORNERS in own and tag != "path":
            self.fail(f"<{tag}>: `{CORNERS}` under a skew or a reflection is not supported")
        try:
            if tag == "path":
                commands = own.get("d", "")
                if not COMMANDS.fullmatch(commands):  # the library would leave out what it does not know
                    self.fail(f"<path>: `d` must be commands and numbers, begun with M, got {shown(commands)}")
                path = svg.Path(commands)
            elif tag in ("polyline", "polygon"):
                values = [self._number(tag, "points", one) for one in own.get("points", "").replace(",", " ").split()]
                kind = svg.Polygon if tag == "polygon" else svg.Polyline
                path = svg.Path(kind(*zip(values[::2], values[1::2], strict=True)))
            else:
                keys = {key: self._number(tag, key, own.get(key, "0")) for key in GEOMETRY[tag] if key in own}
                kinds = {"rect": svg.Rect, "circle": svg.Circle, "ellipse": svg.Ellipse, "line": svg.SimpleLine}
                path = svg.Path(kinds[tag](keys))
            path.approximate_arcs_with_cubics()
        except SvgError:
            raise
        except Exception as error:  # noqa: BLE001 - the library raises whatever its arithmetic does
            self.fail(f"<{tag}>: {GEOMETRY[tag][0]!r} cannot be read ({told(error)})")
        self._points += 4 * len(path)
        if self._points > MOST_POINTS:
            self.fail(f"more than {MOST_POINTS} points")
        outlines = tuple(path_outlines(path, matrix))
        return Path(outlines, replace(paint)) if outlines else None

"""Reading of a documented subset of SVG; anything else is an error that names it."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, NoReturn
from xml.parsers import expat

import numpy as np

from loi_core.errors import SvgError
from loi_core.io.files import read_bytes
from loi_core.renderers.validation import FloatArray
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import described, shown
from loi_torch.vector.coverage import MAX_COORDINATE_PX
from loi_torch.vector.shapes import Path, Shape
from loi_torch.vector.svg_colours import CORNERS, NAMESPACE
from loi_torch.vector.svg_shapes import GEOMETRY, MAX_POINTS, element_shape
from loi_torch.vector.svg_transforms import read_transform
from loi_torch.vector.svg_values import PIXELS, Element, fail

__all__ = ["Drawing", "read_svg"]

MAX_FILE_BYTES: Final = 8 * 1024 * 1024
MAX_DEPTH: Final = 64

SILENT: Final = (  # not drawn where they stand; references to them are refused
    *("title", "desc", "metadata", "defs", "symbol", "clipPath", "mask", "marker", "filter"),
    *("pattern", "linearGradient", "radialGradient"),
)
INHERITED: Final = {
    "color": "black",
    "fill": "black",
    "fill-opacity": "1",
    "fill-rule": "nonzero",
    "stroke": "none",
    "stroke-opacity": "1",
    "stroke-width": "1",
    "stroke-linecap": "butt",
    "stroke-linejoin": "miter",
    "stroke-miterlimit": "4",
}
HARMLESS: Final = {
    # Allowed with these default values only; others would change the picture.
    "stroke-dasharray": ("none",),
    "display": ("inline", "block"),
    "visibility": ("visible",),
    "paint-order": ("normal",),
    "overflow": ("visible", "hidden"),
    "color-interpolation": ("sRGB", "linearRGB", "auto"),
    "preserveAspectRatio": ("xMidYMid", "xMidYMid meet"),
    "mix-blend-mode": ("normal",),
    "clip-path": ("none",),
    "mask": ("none",),
    "filter": ("none",),
    "isolation": ("auto",),
    "vector-effect": ("none",),
    **dict.fromkeys(("marker", "marker-start", "marker-mid", "marker-end"), ("none",)),
}
UNSEEN: Final = re.compile(
    r"id|version|baseProfile|role|class|focusable|lang|xml:.*|xmlns.*|data-.*|aria-.*|enable-background"
    r"|.*-rendering|stroke-dashoffset|clip-rule|font-.*|text-.*|stop-.*|solid-.*|color-interpolation-filters"
    r"|line-height|letter-spacing|word-spacing|writing-mode|direction|white-space|inline-size|shape-(padding|margin)"
    r"|(dominant-|alignment-)baseline|baseline-shift|-inkscape-.*|.*:.*"
)
COMMENT: Final = re.compile(r"/\*.*?(?:\*/|\Z)", re.DOTALL)
IMPORTANT: Final = re.compile(r"!\s*important", re.IGNORECASE)


@dataclass(frozen=True)
class Drawing:
    """Contents of an SVG file.

    Attributes
    ----------
    shapes : list of Shape
        In the order of painting, in pixels of the image.
    background : array, shape (3,)
        Linear RGB: the ``background-color`` of the root's style, or white.
    """

    shapes: list[Shape]
    background: FloatArray


@suggest_keywords
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
    rectangles that are skewed become paths. Elements that SVG does not show, such as the definitions of gradients in
    ``defs``, are left out; references to them are errors.
    """
    try:
        content = read_bytes(path, MAX_FILE_BYTES)
    except (OSError, ValueError) as error:
        fail(path, f"cannot be read ({described(error)})")
    reader = _Reader(path, height, width)
    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartDoctypeDeclHandler = reader.document_type
    parser.StartElementHandler = reader.start
    parser.EndElementHandler = reader.end
    try:
        parser.Parse(content, True)  # noqa: FBT003 - it takes no keyword
    except SvgError:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:  # the last two for encodings that expat cannot read
        fail(path, f"not well-formed XML ({described(error)})")
    if not reader.drawing.shapes:
        fail(path, "there is no shape in it")
    return reader.drawing


class _Reader:
    """Collects shapes from the elements of a document."""

    def __init__(self, path: pathlib.Path, height: int, width: int) -> None:
        self.drawing = Drawing([], np.ones(3))
        self._path = path
        self._size = height, width
        self._open: list[Element] = []
        self._silent = 0
        self._points_left = MAX_POINTS

    def document_type(self, *_: object) -> NoReturn:
        fail(self._path, "has a document type declaration (<!DOCTYPE>), which is not read; delete it")

    def end(self, _: str) -> None:
        if self._silent:
            self._silent -= 1
        else:
            self._open.pop()

    def start(self, name: str, attributes: dict[str, str]) -> None:
        space, _, tag = name.rpartition(" ")
        in_svg_namespace = space in ("", NAMESPACE)
        if self._silent and in_svg_namespace and tag == "style":
            fail(self._path, "<style> is not supported here, since it also holds outside of what is not shown")
        if self._silent or (self._open and (tag in SILENT or not in_svg_namespace)):
            self._silent += 1
            return
        if len(self._open) >= MAX_DEPTH:
            fail(self._path, f"elements lie more than {MAX_DEPTH} deep")
        if (tag == "svg") == bool(self._open) or tag not in ("svg", "g", *GEOMETRY):
            names = f"svg (once, outermost), g, {', '.join(GEOMETRY)}"
            fail(self._path, f"<{tag[:40]}> is not supported here; known are {names}")
        above = self._open[-1] if self._open else Element(self._path, "", {}, INHERITED)
        if above.tag in GEOMETRY:
            fail(self._path, f"<{tag}> in a <{above.tag}> is not supported; SVG does not show it")
        plain = _attributes(attributes)
        if tag != "svg" and plain.get("display", "").lower() == "none":
            self._silent += 1
            return
        style = {**above.style, **{key: value for key, value in plain.items() if _changes(key, value)}}
        element = Element(self._path, tag, plain, style)
        _check(element)
        matrix = self._root(element) if tag == "svg" else above.matrix @ read_transform(element)
        if not np.all(np.abs(matrix) <= MAX_COORDINATE_PX):
            element.fail(f"all transforms together must stay within {MAX_COORDINATE_PX:g}")
        element = replace(element, matrix=matrix)
        self._open.append(element)
        if tag in GEOMETRY:
            shape = element_shape(element, self._points_left)
            if isinstance(shape, Path):
                self._points_left -= sum(len(outline.points) for outline in shape.outlines)
            self.drawing.shapes.extend([shape] if shape else [])
        elif element.share("opacity", element.text("opacity", "1")) != 1.0:
            fail(self._path, f"<{tag}> with an `opacity` is not supported; give it to each shape")

    def _root(self, element: Element) -> FloatArray:
        height, width = self._size
        background = element.text("background-color", "transparent")
        if background.lower() != "transparent":
            colour = element.colour("background-color", background)
            if colour[3] != 1.0:
                element.fail(f"`background-color` must be opaque, got {shown(background)}")
            self.drawing.background[:] = colour[:3]
        if "transform" in element.attributes:
            element.fail("`transform` is not supported here; give it to a <g>")
        if "viewBox" in element.attributes:
            box = [element.number("viewBox", text) for text in element.attributes["viewBox"].replace(",", " ").split()]
            allowed = "`viewBox` must be four numbers, the last two more than 0"
        else:
            canvas = {"width": width, "height": height}
            box = [0.0, 0.0]
            box += [element.number(key, element.text(key, str(length)), PIXELS) for key, length in canvas.items()]
            allowed = "`width` and `height` must be more than 0"
        if len(box) != 4 or min(box[2:]) <= 0.0:
            element.fail(f"{allowed}, got {shown(element.attributes.get('viewBox', box[2:]))}")
        scale = min(width / box[2], height / box[3])
        left, top = 0.5 * (width - scale * box[2]), 0.5 * (height - scale * box[3])
        return np.array([[scale, 0.0, left - scale * box[0]], [0.0, scale, top - scale * box[1]], [0.0, 0.0, 1.0]])


def _check(element: Element) -> None:
    """Refuse attributes that are not supported."""
    allowed = {*INHERITED, *GEOMETRY.get(element.tag, ()), "opacity", "transform", CORNERS}
    if element.tag == "svg":
        allowed |= {"width", "height", "viewBox", "background-color", "x", "y"}
    for key, value in element.attributes.items():
        if key not in allowed and not UNSEEN.fullmatch(key) and value not in HARMLESS.get(key, ()):
            element.fail(f"`{key[:40]}` = {shown(value)} is not supported")


def _attributes(attributes: Mapping[str, str]) -> dict[str, str]:
    """Return attributes and declarations of ``style``, where important ones take precedence."""
    plain = {key.replace(" ", ":"): value.strip() for key, value in attributes.items()}
    styled, important = {}, {}
    for declaration in COMMENT.sub(" ", plain.pop("style", "")).split(";"):
        key, colon, value = declaration.partition(":")
        if colon:
            text, mark, suffix = value.rpartition("!")
            if mark and IMPORTANT.fullmatch(mark + suffix.strip()):
                important[key.strip()] = text.strip()
            else:
                styled[key.strip()] = value.strip()
    return plain | styled | important


def _changes(key: str, value: str) -> bool:
    """Return whether an attribute changes the inherited style; ``currentColor`` of a colour is inherited."""
    same = ("inherit", "currentcolor") if key == "color" else ("inherit",)
    return key in INHERITED and value.lower() not in same

"""Writing of shapes as SVG that is read back as the same shapes."""

from __future__ import annotations

import pathlib
from collections.abc import Iterable, Sequence

import numpy as np

from loi_core.io.files import write_text
from loi_core.renderers.validation import FloatArray, check_floats, check_size
from loi_core.support.keywords import suggest_keywords
from loi_torch.vector.shapes import Circle, Ellipse, Outline, Paint, Path, Shape
from loi_torch.vector.svg_colours import CORNERS, NAMESPACE, spell_colour

__all__ = ["write_svg"]


@suggest_keywords
def write_svg(
    path: pathlib.Path,
    shapes: Iterable[Shape],
    height: int,
    width: int,
    background: Sequence[float] | FloatArray = (1.0, 1.0, 1.0),
) -> None:
    """Write shapes to an SVG file, whole or not at all.

    Parameters
    ----------
    path : Path
    shapes : iterable of Shape
        In the order of painting.
    height, width : int
        Size of the image in pixels.
    background : array, shape (3,)
        Linear RGB; a style of the root, which browsers show.

    Notes
    -----
    Colours outside [0, 1] are clipped. Bilinear fills are written as their mean colour, and their corners in an
    attribute that only :func:`read_svg` reads. Browsers mix colours as sRGB, so transparent shapes look there as in a
    renderer with that encoding.
    """
    rows, columns = check_size("height", height), check_size("width", width)
    style = f"background-color: {spell_colour(check_floats('background', background, (3,)))}"
    lines = [
        f'<svg xmlns="{NAMESPACE}" width="{columns}" height="{rows}" viewBox="0 0 {columns} {rows}" style="{style}">',
        *(f"  <{_element(shape)} {_painted(shape.paint)}/>" for shape in shapes),
        "</svg>",
    ]
    write_text(pathlib.Path(path), "\n".join(lines) + "\n")


def _element(shape: Shape) -> str:
    if isinstance(shape, Path):
        return f'path d="{" ".join(_outline(outline) for outline in shape.outlines)}"'
    x, y = (float(coordinate) for coordinate in np.asarray(shape.centre))
    if isinstance(shape, Circle):
        return f'circle cx="{_spell(x)}" cy="{_spell(y)}" r="{_spell(shape.radius)}"'
    rotation = f' transform="rotate({_spell(shape.rotation)} {_spell(x)} {_spell(y)})"' if shape.rotation else ""
    if isinstance(shape, Ellipse):
        rx, ry = (_spell(radius) for radius in np.asarray(shape.radii))
        return f'ellipse cx="{_spell(x)}" cy="{_spell(y)}" rx="{rx}" ry="{ry}"{rotation}'
    width, height = (float(length) for length in np.asarray(shape.sides))
    corner = f'x="{_spell(x - 0.5 * width)}" y="{_spell(y - 0.5 * height)}"'
    sides = f'width="{_spell(width)}" height="{_spell(height)}"'
    return f'rect {corner} {sides} rx="{_spell(shape.rounding)}"{rotation}'


def _outline(outline: Outline) -> str:
    points = [f"{_spell(x)},{_spell(y)}" for x, y in np.asarray(outline.points, dtype=np.float64)]
    words, at = [f"M{points[0]}"], 1
    if outline.closed:
        points.append(points[0])
    for degree in outline.degrees:
        words.append("LQC"[degree - 1] + " ".join(points[at : at + degree]))
        at += degree
    return " ".join(words) + (" Z" if outline.closed else "")


def _painted(paint: Paint) -> str:
    attributes = []
    if paint.fill is None:
        attributes.append('fill="none"')
    else:
        fill = np.asarray(paint.fill, dtype=np.float64)
        mean = fill if fill.ndim == 1 else fill.mean(axis=0)
        attributes.append(f'fill="{spell_colour(mean)}" fill-opacity="{_spell(np.clip(mean[3], 0.0, 1.0))}"')
        if fill.ndim == 2:
            attributes.append(f'{CORNERS}="{" ".join(_spell(entry) for entry in fill.ravel())}"')
        if paint.rule != "nonzero":
            attributes.append(f'fill-rule="{paint.rule}"')
    if paint.stroke is not None:
        stroke = np.asarray(paint.stroke, dtype=np.float64)
        attributes.append(f'stroke="{spell_colour(stroke)}" stroke-opacity="{_spell(np.clip(stroke[3], 0.0, 1.0))}"')
        attributes.append(f'stroke-width="{_spell(paint.width)}"')
        attributes.append(f'stroke-linecap="{paint.cap}" stroke-linejoin="{paint.join}"')
    return " ".join(attributes)


def _spell(number: float) -> str:
    """Return the shortest text that is read back as the same number."""
    return repr(float(number))

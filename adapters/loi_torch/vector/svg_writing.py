"""Writing shapes as SVG, so that reading it gives the same shapes."""

from __future__ import annotations

import pathlib
from collections.abc import Iterable, Sequence

import numpy as np

from loi_core.io.files import write_text
from loi_core.renderers.validation import FloatArray, check_floats, check_size
from loi_torch.vector.shapes import Circle, Ellipse, Outline, Paint, Path, Shape
from loi_torch.vector.svg_colours import CORNERS, NAMESPACE, spell_colour

__all__ = ["write_svg"]


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
        Of the image in pixels.
    background : array, shape (3,)
        Linear RGB; a style of the root, which browsers show.

    Notes
    -----
    Colours outside [0, 1] are clipped. Bilinear fills are written as their mean colour, and their corners in an
    attribute that only :func:`read_svg` knows. Browsers mix colours as sRGB: what is not opaque looks there as a
    renderer with that encoding shows it.
    """
    rows, columns = check_size("height", height), check_size("width", width)
    style = f"background-color: {spell_colour(check_floats('background', background, (3,)))}"
    lines = [
        f'<svg xmlns="{NAMESPACE}" width="{columns}" height="{rows}" viewBox="0 0 {columns} {rows}" style="{style}">',
        *(f"  <{_element(one)} {_painted(one.paint)}/>" for one in shapes),
        "</svg>",
    ]
    write_text(pathlib.Path(path), "\n".join(lines) + "\n")


def _element(shape: Shape) -> str:
    if isinstance(shape, Path):
        return f'path d="{" ".join(_outline(one) for one in shape.outlines)}"'
    x, y = (float(one) for one in np.asarray(shape.centre))
    if isinstance(shape, Circle):
        return f'circle cx="{_spell(x)}" cy="{_spell(y)}" r="{_spell(shape.radius)}"'
    turned = f' transform="rotate({_spell(shape.rotation)} {_spell(x)} {_spell(y)})"' if shape.rotation else ""
    if isinstance(shape, Ellipse):
        rx, ry = (_spell(one) for one in np.asarray(shape.radii))
        return f'ellipse cx="{_spell(x)}" cy="{_spell(y)}" rx="{rx}" ry="{ry}"{turned}'
    across, down = (float(one) for one in np.asarray(shape.sides))
    corner = f'x="{_spell(x - 0.5 * across)}" y="{_spell(y - 0.5 * down)}"'
    sides = f'width="{_spell(across)}" height="{_spell(down)}"'
    return f'rect {corner} {sides} rx="{_spell(shape.rounding)}"{turned}'


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
    parts = []
    if paint.fill is None:
        parts.append('fill="none"')
    else:
        fill = np.asarray(paint.fill, dtype=np.float64)
        mean = fill if fill.ndim == 1 else fill.mean(axis=0)
        parts.append(f'fill="{spell_colour(mean)}" fill-opacity="{_spell(np.clip(mean[3], 0.0, 1.0))}"')
        if fill.ndim == 2:
            parts.append(f'{CORNERS}="{" ".join(_spell(one) for one in fill.ravel())}"')
        if paint.rule != "nonzero":
            parts.append(f'fill-rule="{paint.rule}"')
    if paint.stroke is not None:
        stroke = np.asarray(paint.stroke, dtype=np.float64)
        parts.append(f'stroke="{spell_colour(stroke)}" stroke-opacity="{_spell(np.clip(stroke[3], 0.0, 1.0))}"')
        parts.append(f'stroke-width="{_spell(paint.width)}"')
        parts.append(f'stroke-linecap="{paint.cap}" stroke-linejoin="{paint.join}"')
    return " ".join(parts)


def _spell(number: float) -> str:
    """With the digits that make it the same number again, since tools that read SVG know exponents."""
    return repr(float(number))

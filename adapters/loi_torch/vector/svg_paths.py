"""Paths of SVG, as svgelements parses them, turned into outlines."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, Final

import numpy as np
import svgelements as svg

from loi_core.renderers.checks import FloatArray
from loi_torch.vector.shapes import Outline

__all__ = ["moved", "path_outlines", "without_arcs"]

ARC: Final = math.tau / 10  # radians that one cubic stands for, at the most


def moved(point: FloatArray, matrix: FloatArray) -> FloatArray:
    """`point`, shape (2,), under the affine `matrix`, shape (3, 3)."""
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused where it is put into a shape
        result: FloatArray = matrix[:2, :2] @ point + matrix[:2, 2]
    return result


def without_arcs(path: Iterable[Any]) -> Iterator[Any]:
    """The segments of a path that svgelements has parsed, with cubics for its arcs.

    The library does so in place, and then takes time that grows with the square of how many there are.
    """
    for segment in path:
        if isinstance(segment, svg.Arc):
            yield from segment.as_cubic_curves(math.ceil(abs(segment.sweep) / ARC))
        else:
            yield segment


def path_outlines(path: Iterable[Any], matrix: FloatArray) -> list[Outline]:
    """The parts of a path of moves, lines and curves, under the affine `matrix`, shape (3, 3)."""
    outlines: list[Outline] = []
    points: list[FloatArray] = []
    degrees: list[int] = []

    def finish(*, closed: bool) -> None:
        if closed and degrees:
            if len(degrees) > 1 and np.allclose(points[-1], points[0], rtol=0.0, atol=1e-9):
                points.pop()  # it came back by itself
            else:
                degrees.append(1)
        if degrees:
            outlines.append(Outline(np.array(points), tuple(degrees), closed))

    for segment in path:
        if isinstance(segment, svg.Move):
            finish(closed=False)
            points, degrees = [_point(segment.end, matrix)], []
            continue
        if isinstance(segment, svg.Close):
            finish(closed=True)
            points, degrees = [_point(segment.end, matrix)] if segment.end is not None else points[:1], []
            continue
        if not points:
            points = [_point(segment.start, matrix)]
        inner = {svg.CubicBezier: ("control1", "control2"), svg.QuadraticBezier: ("control",)}.get(type(segment), ())
        points += [_point(getattr(segment, one), matrix) for one in (*inner, "end")]
        degrees.append(len(inner) + 1)
    finish(closed=False)
    return outlines


def _point(point: Any, matrix: FloatArray) -> FloatArray:
    return moved(np.array([float(point.x), float(point.y)]), matrix)

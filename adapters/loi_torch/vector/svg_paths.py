"""Paths of SVG, as svgelements parses them, turned into outlines."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, Final

import numpy as np
import svgelements as svg

from loi_core.renderers.validation import FloatArray
from loi_torch.vector.shapes import Outline

__all__ = ["Commands", "has_dot", "moved", "path_outlines", "without_arcs"]

ARC: Final = math.tau / 10  # radians that one cubic stands for, at the most


class Commands(svg.Path):  # type: ignore[misc]  # which has no types
    """The path that commands draw, with what the library does in another way than SVG.

    Smooth curves go on from a curve of their own kind alone. Arcs with a radius of 0 are lines, and radii that are too
    small for their ends are made larger here, since the squares of small ones would be 0.
    """

    def smooth_cubic(self, *points: Any, relative: bool = False, **_: Any) -> None:
        """Append a cubic curve that goes on from a cubic curve, or else begins with its start as control point."""
        if isinstance(self[-1], svg.CubicBezier):
            super().smooth_cubic(*points, relative=relative)
        else:
            self.cubic(self._here(), *points, relative=relative)

    def smooth_quad(self, *points: Any, relative: bool = False, **_: Any) -> None:
        """Append a quadratic curve that goes on from a quadratic curve, or else is a line."""
        if isinstance(self[-1], svg.QuadraticBezier):
            super().smooth_quad(*points, relative=relative)
        else:
            self.quad(self._here(), *points, relative=relative)

    def arc(self, *arguments: Any, relative: bool = False, **_: Any) -> None:
        """Append an arc, or a line if one of its radii is 0."""
        rx, ry, rotation, *flags, end = arguments
        rx, ry = abs(rx), abs(ry)
        if rx == 0.0 or ry == 0.0:
            self.line(end, relative=relative)
            return
        if not isinstance(end, str):  # which stands for where the path began
            x, y = (0.5 * (one - other) for one, other in zip(self._here(), end, strict=True))
            cos, sin = math.cos(math.radians(rotation)), math.sin(math.radians(rotation))
            largest = max(rx, ry)
            across, down = rx / largest, ry / largest
            least = math.hypot((cos * x + sin * y) / across, (cos * y - sin * x) / down)
            if least > largest:
                rx, ry = least * across, least * down
        super().arc(rx, ry, rotation, *flags, end, relative=relative)

    def _here(self) -> tuple[float, float]:
        point = self.current_point
        return float(point.x), float(point.y)


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
            # A line that is alone stays, since an outline needs more than one point.
            if len(points) > 2 and np.allclose(points[-1], points[0], rtol=0.0, atol=1e-9):
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


def has_dot(path: Iterable[Any], near: float) -> bool:
    """Whether a part of a path of moves, lines and curves stays as `near`, so that of its stroke only caps are seen."""
    drawn, first = False, None
    for segment in path:
        if isinstance(segment, svg.Move):
            if drawn and first is not None:
                return True
            drawn, first = False, segment.end
        elif first is not None:
            drawn = True
            if any(math.hypot(one.x - first.x, one.y - first.y) > near for one in segment if one is not None):
                first = None  # it goes somewhere
        if isinstance(segment, svg.Close):
            if drawn and first is not None:
                return True
            drawn, first = False, segment.end
    return drawn and first is not None


def _point(point: Any, matrix: FloatArray) -> FloatArray:
    return moved(np.array([float(point.x), float(point.y)]), matrix)

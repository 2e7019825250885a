"""Paths of SVG, as svgelements parses them, turned into outlines."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, Final

import numpy as np
import svgelements as svg

from loi_core.renderers.validation import FloatArray
from loi_torch.vector.shapes import Outline

__all__ = ["Commands", "moved", "path_outlines", "without_arcs"]

MAX_CUBIC_ARC_RADIANS: Final = math.tau / 10


class Commands(svg.Path):  # type: ignore[misc]  # untyped
    """The path drawn by commands, where svgelements deviates from SVG.

    A smooth curve continues only a curve of the same degree. Arcs with a radius of 0 are lines, and too small radii are
    enlarged here, because the squares of small radii underflow.
    """

    def smooth_cubic(self, *points: Any, relative: bool = False, **_: Any) -> None:
        """Append a cubic curve that continues a cubic curve; otherwise its start is the control point."""
        if isinstance(self[-1], svg.CubicBezier):
            super().smooth_cubic(*points, relative=relative)
        else:
            self.cubic(self._here(), *points, relative=relative)

    def smooth_quad(self, *points: Any, relative: bool = False, **_: Any) -> None:
        """Append a quadratic curve that continues a quadratic curve; otherwise a line."""
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
        if not isinstance(end, str):  # "z": the start of the path
            x, y = (0.5 * (origin - target) for origin, target in zip(self._here(), end, strict=True))
            cos, sin = math.cos(math.radians(rotation)), math.sin(math.radians(rotation))
            largest = max(rx, ry)
            unit_rx, unit_ry = rx / largest, ry / largest
            scale = math.hypot((cos * x + sin * y) / unit_rx, (cos * y - sin * x) / unit_ry)
            if scale > largest:
                rx, ry = scale * unit_rx, scale * unit_ry
        super().arc(rx, ry, rotation, *flags, end, relative=relative)

    def _here(self) -> tuple[float, float]:
        point = self.current_point
        return float(point.x), float(point.y)


def moved(point: FloatArray, matrix: FloatArray) -> FloatArray:
    """Return `point`, shape (2,), under the affine `matrix`, shape (3, 3)."""
    with np.errstate(over="ignore", invalid="ignore"):  # shapes reject non-finite points
        result: FloatArray = matrix[:2, :2] @ point + matrix[:2, 2]
    return result


def without_arcs(path: Iterable[Any]) -> Iterator[Any]:
    """Yield the segments of a path with cubics for its arcs; svgelements takes quadratic time for that."""
    for segment in path:
        if isinstance(segment, svg.Arc):
            yield from segment.as_cubic_curves(math.ceil(abs(segment.sweep) / MAX_CUBIC_ARC_RADIANS))
        else:
            yield segment


def path_outlines(path: Iterable[Any], matrix: FloatArray) -> tuple[list[Outline], float]:
    """Return the outlines of a path of moves, lines and curves under the affine `matrix`, shape (3, 3).

    Also returns the extent of its smallest part, which is 0 for a part whose points coincide.
    """
    outlines: list[Outline] = []
    points: list[FloatArray] = []
    degrees: list[int] = []
    extents = [math.inf]

    def finish(*, closed: bool) -> None:
        if closed and degrees:
            # A line that is alone stays, since an outline needs more than one point.
            if len(points) > 2 and np.allclose(points[-1], points[0], rtol=0.0, atol=1e-9):
                points.pop()  # already closed
            else:
                degrees.append(1)
        if degrees:
            outlines.append(Outline(np.array(points), tuple(degrees), closed))
        if degrees or closed:
            extents.append(float(np.ptp(points, axis=0).max()))

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
        points += [_point(getattr(segment, name), matrix) for name in (*inner, "end")]
        degrees.append(len(inner) + 1)
    finish(closed=False)
    return outlines, min(extents)


def _point(point: Any, matrix: FloatArray) -> FloatArray:
    return moved(np.array([float(point.x), float(point.y)]), matrix)

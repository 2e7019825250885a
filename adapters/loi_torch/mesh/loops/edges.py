"""Edges at which the image may jump, cut where they leave the frame and its pixels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.loops.growing import grown
from loi_torch.mesh.loops.triangles import Triangles

__all__ = ["active_edges", "edge_in_frame", "walk"]


@compiled_as_written
def active_edges(triangles: Triangles, between: Any, always: Any) -> Any:
    """Numbers of the edges at which the image may jump: of outlines, rims and creases."""
    found = np.empty(len(between), np.int32)
    count = 0
    for k in range(len(between)):
        one, other = between[k, 0], between[k, 1]
        shown = triangles.drawn[one] or (other >= 0 and triangles.drawn[other])
        facing = other >= 0 and triangles.facing[one] * triangles.facing[other] > 0
        if shown and (always[k] or not facing):
            found[count] = k
            count += 1
    return found[:count]


@compiled_as_written
def edge_in_frame(
    a: Any, b: Any, near: float, height: int, width: int
) -> tuple[bool, float, float, float, float, float, float, float, float]:
    """The visible part of an edge: its ends in pixels, their w, and what of it (0 to 1) lies in the frame."""
    nothing = (False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    start, end = 0.0, 1.0
    if a[2] < near:
        if b[2] < near:
            return nothing
        start = (near - a[2]) / (b[2] - a[2])
    elif b[2] < near:
        end = (near - a[2]) / (b[2] - a[2])
    wa, wb = a[2] + start * (b[2] - a[2]), a[2] + end * (b[2] - a[2])
    xa, ya = (a[0] + start * (b[0] - a[0])) / wa, (a[1] + start * (b[1] - a[1])) / wa
    xb, yb = (a[0] + end * (b[0] - a[0])) / wb, (a[1] + end * (b[1] - a[1])) / wb
    low, high = 0.0, 1.0
    for p, q, size in ((xa, xb, width), (ya, yb, height)):
        if p == q:
            if p < 0.0 or p >= size:
                return nothing
            continue
        s0, s1 = -p / (q - p), (size - p) / (q - p)
        low, high = max(low, min(s0, s1)), min(high, max(s0, s1))
    if not high - low > 0.0:
        return nothing
    return True, xa, ya, xb, yb, start, end, low, high


@compiled_as_written
def walk(corners: Any, edges: Any, height: int, width: int, near: float) -> tuple[Any, Any, Any]:
    """Cut edges where they leave pixels: of each part its edge, its pixel, and what of the edge it is on the screen."""
    edge, pixel, part = np.empty(1024, np.int32), np.empty(1024, np.int32), np.empty((1024, 2))
    count = 0
    for k in range(len(edges)):
        inside, xa, ya, xb, yb, _, _, low, high = edge_in_frame(
            corners[edges[k, 0]], corners[edges[k, 1]], near, height, width
        )
        if not inside:
            continue
        dx, dy = xb - xa, yb - ya
        s = low
        while s < high:
            x, y = xa + s * dx, ya + s * dy
            nearest = high
            if dx != 0.0:
                line = math.floor(x) + 1.0 if dx > 0.0 else math.ceil(x) - 1.0
                nearest = min(nearest, max((line - xa) / dx, s))
            if dy != 0.0:
                line = math.floor(y) + 1.0 if dy > 0.0 else math.ceil(y) - 1.0
                nearest = min(nearest, max((line - ya) / dy, s))
            if nearest <= s:
                nearest = min(high, s + max(1e-12, 1e-9 / max(abs(dx), abs(dy))))
            middle = 0.5 * (s + nearest)
            column, row = math.floor(xa + middle * dx), math.floor(ya + middle * dy)
            if 0 <= column < width and 0 <= row < height:
                edge, pixel, part = grown(edge, count + 1), grown(pixel, count + 1), grown(part, count + 1)
                edge[count], pixel[count] = k, row * width + column
                part[count, 0], part[count, 1] = s, nearest
                count += 1
            s = nearest
    return edge[:count], pixel[:count], part[:count]

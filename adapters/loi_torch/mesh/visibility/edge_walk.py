"""Discontinuity edges, clipped to the frame and cut at pixel borders."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.visibility.edge_functions import Triangles
from loi_torch.mesh.visibility.types import Viewport

__all__ = ["clip_edge", "discontinuity_edges", "grow", "walk_edges"]


@compiled_as_written
def grow(array: Any, size: int) -> Any:
    """Return the array if it has `size` rows, or else a copy with at least twice as many rows."""
    if size <= len(array):
        return array
    longer = np.empty((max(size, 2 * len(array)), *array.shape[1:]), array.dtype)
    # Entry by entry: Numba takes seconds to compile an assignment of arrays, with its errors for other shapes.
    target, source = longer.reshape(-1), array.reshape(-1)
    for index in range(len(source)):
        target[index] = source[index]
    return longer


@compiled_as_written
def discontinuity_edges(triangles: Triangles, adjacent_faces: Any, discontinuous: Any) -> Any:
    """Return the indices of silhouette, boundary and crease edges with a triangle in the frame."""
    edges = np.empty(len(adjacent_faces), np.int32)
    count = 0
    for k in range(len(adjacent_faces)):
        first, second = adjacent_faces[k, 0], adjacent_faces[k, 1]
        in_frame = triangles.in_frame[first] or (second >= 0 and triangles.in_frame[second])
        same_facing = second >= 0 and triangles.facing[first] * triangles.facing[second] > 0
        if in_frame and (discontinuous[k] or not same_facing):
            edges[count] = k
            count += 1
    return edges[:count]


@compiled_as_written
def clip_edge(
    a: Any, b: Any, min_w: float, height: int, width: int
) -> tuple[bool, float, float, float, float, float, float, float, float]:
    """Clip the edge between homogeneous points `a` and `b` to the near plane and the frame.

    Returns whether it is visible; its ends (xa, ya, xb, yb) in pixels after clipping to the near plane; the same ends
    as positions on the whole edge, 0 to 1 in world space; and the interval within the frame, 0 to 1 on the screen.
    """
    outside = (False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    start, end = 0.0, 1.0
    if a[2] < min_w:
        if b[2] < min_w:
            return outside
        start = (min_w - a[2]) / (b[2] - a[2])
    elif b[2] < min_w:
        end = (min_w - a[2]) / (b[2] - a[2])
    wa, wb = a[2] + start * (b[2] - a[2]), a[2] + end * (b[2] - a[2])
    xa, ya = (a[0] + start * (b[0] - a[0])) / wa, (a[1] + start * (b[1] - a[1])) / wa
    xb, yb = (a[0] + end * (b[0] - a[0])) / wb, (a[1] + end * (b[1] - a[1])) / wb
    lower, upper = 0.0, 1.0
    for p, q, size in ((xa, xb, width), (ya, yb, height)):
        if p == q:
            if p < 0.0 or p >= size:
                return outside
            continue
        s0, s1 = -p / (q - p), (size - p) / (q - p)
        lower, upper = max(lower, min(s0, s1)), min(upper, max(s0, s1))
    if not upper - lower > 0.0:
        return outside
    return True, xa, ya, xb, yb, start, end, lower, upper


@compiled_as_written
def walk_edges(corners: Any, edges: Any, viewport: Viewport) -> tuple[Any, Any, Any]:
    """Cut edges at pixel borders; return the edge, the pixel and the interval on the screen of each segment."""
    height, width = viewport.height, viewport.width
    edge, pixel, interval = np.empty(1024, np.int32), np.empty(1024, np.int32), np.empty((1024, 2))
    count = 0
    for k in range(len(edges)):
        is_visible, xa, ya, xb, yb, _, _, lower, upper = clip_edge(
            corners[edges[k, 0]], corners[edges[k, 1]], viewport.min_w, height, width
        )
        if not is_visible:
            continue
        dx, dy = xb - xa, yb - ya
        s = lower
        while s < upper:
            x, y = xa + s * dx, ya + s * dy
            border = upper
            if dx != 0.0:
                line = math.floor(x) + 1.0 if dx > 0.0 else math.ceil(x) - 1.0
                border = min(border, max((line - xa) / dx, s))
            if dy != 0.0:
                line = math.floor(y) + 1.0 if dy > 0.0 else math.ceil(y) - 1.0
                border = min(border, max((line - ya) / dy, s))
            if border <= s:
                border = min(upper, s + max(1e-12, 1e-9 / max(abs(dx), abs(dy))))
            middle = 0.5 * (s + border)
            column, row = math.floor(xa + middle * dx), math.floor(ya + middle * dy)
            if 0 <= column < width and 0 <= row < height:
                edge, pixel, interval = grow(edge, count + 1), grow(pixel, count + 1), grow(interval, count + 1)
                edge[count], pixel[count] = k, row * width + column
                interval[count, 0], interval[count, 1] = s, border
                count += 1
            s = border
    return edge[:count], pixel[:count], interval[:count]

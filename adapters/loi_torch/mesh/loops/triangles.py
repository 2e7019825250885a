"""Triangles as edge functions, and the depth buffer at the pixels' centres.

Corners are homogeneous, (x w, y w, w) in pixels, so that triangles through the camera's plane need no clipping (Olano
and Greer 1997): of a triangle's three edge functions, each linear in the pixel, all are positive where it is seen. The
arithmetic is as written, without fused products: the edge that two triangles share then has exactly opposite values in
the two, and no pixel falls between them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.tolerances import EDGE_ON, MARGIN, SAME_PLACE

__all__ = ["Triangles", "depth_buffer", "ends_at", "nearness_at", "prepare"]


class Triangles(NamedTuple):
    """Of each triangle: whether it is drawn, its edge functions and nearness a x + b y + c, and its box of pixels."""

    drawn: Any  # (m,) bool
    edges: Any  # (m, 3, 3): function, coefficient
    nearness: Any  # (m, 3)
    facing: Any  # (m,) int8, 1 for counterclockwise corners as numbers, -1 for clockwise ones
    box: Any  # (m, 4) int32: first and last column, first and last row, of pixels that it may touch
    most: float  # nearness of the near plane


@compiled_as_written
def _cross(corners: Any, i: int, j: int) -> tuple[float, float, float]:
    # Entry by entry, here and elsewhere: each row that is taken out takes longer than what is done with it.
    x, y, w = corners[i, 0], corners[i, 1], corners[i, 2]
    u, v, s = corners[j, 0], corners[j, 1], corners[j, 2]
    return y * s - w * v, w * u - x * s, x * v - y * u


@compiled_as_written
def _largest(corners: Any, faces: Any, k: int, near: float) -> float:
    """The square of a triangle's longest side, times its corners' w: its volume is at most about this.

    Rounding would decide which way a triangle faces that is seen edge-on. 0 for triangles through the near plane.
    """
    longest, depth = 0.0, 1.0
    for j in range(3):
        a, b = faces[k, j], faces[k, (j + 1) % 3]
        wa, wb = corners[a, 2], corners[b, 2]
        if wa < near:
            return 0.0
        if wb >= near:
            x, y = corners[a, 0] / wa - corners[b, 0] / wb, corners[a, 1] / wa - corners[b, 1] / wb
            longest = max(longest, x * x + y * y)
        depth *= wa
    return float(longest * depth)


@compiled_as_written
def prepare(corners: Any, depth: Any, faces: Any, height: int, width: int, near: float, most: float) -> Triangles:
    """The triangles of (m, 3) `faces`, between the planes at w = `near` and at the nearness `most`."""
    count = len(faces)
    drawn = np.zeros(count, np.bool_)
    edges = np.empty((count, 3, 3))
    nearness = np.zeros((count, 3))
    facing = np.zeros(count, np.int8)
    box = np.zeros((count, 4), np.int32)
    for k in range(count):
        i0, i1, i2 = faces[k, 0], faces[k, 1], faces[k, 2]
        if corners[i0, 2] < near and corners[i1, 2] < near and corners[i2, 2] < near:
            continue
        edges[k, 0, 0], edges[k, 0, 1], edges[k, 0, 2] = _cross(corners, i1, i2)
        edges[k, 1, 0], edges[k, 1, 1], edges[k, 1, 2] = _cross(corners, i2, i0)
        edges[k, 2, 0], edges[k, 2, 1], edges[k, 2, 2] = _cross(corners, i0, i1)
        det = corners[i0, 0] * edges[k, 0, 0] + corners[i0, 1] * edges[k, 0, 1] + corners[i0, 2] * edges[k, 0, 2]
        if not abs(det) > EDGE_ON * _largest(corners, faces, k, near):
            continue
        if det < 0.0:
            for j in range(3):
                for axis in range(3):
                    edges[k, j, axis] = -edges[k, j, axis]
        facing[k] = 1 if det > 0.0 else -1
        volume = abs(det)
        for axis in range(3):
            sums = depth[i0] * edges[k, 0, axis] + depth[i1] * edges[k, 1, axis] + depth[i2] * edges[k, 2, axis]
            nearness[k, axis] = sums / volume
        left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
        for j in range(3):
            a, b = faces[k, j], faces[k, (j + 1) % 3]
            wa, wb = corners[a, 2], corners[b, 2]
            if wa >= near:
                x, y = corners[a, 0] / wa, corners[a, 1] / wa
                left, right, top, bottom = min(left, x), max(right, x), min(top, y), max(bottom, y)
            if (wa >= near) != (wb >= near):
                t = (near - wa) / (wb - wa)
                x = (corners[a, 0] + t * (corners[b, 0] - corners[a, 0])) / near
                y = (corners[a, 1] + t * (corners[b, 1] - corners[a, 1])) / near
                left, right, top, bottom = min(left, x), max(right, x), min(top, y), max(bottom, y)
        left, right, top, bottom = left - MARGIN, right + MARGIN, top - MARGIN, bottom + MARGIN
        if not (right > 0.0 and left < width and bottom > 0.0 and top < height):
            continue
        box[k, 0], box[k, 1] = int(max(left, 0.0)), int(min(right, width - 0.5))
        box[k, 2], box[k, 3] = int(max(top, 0.0)), int(min(bottom, height - 0.5))
        drawn[k] = True
    return Triangles(drawn, edges, nearness, facing, box, most)


@compiled_as_written
def _columns(edges: Any, k: int, y: float, first: int, last: int) -> tuple[int, int]:
    """The columns of a row in which all edge functions may be positive; rounding may add one at either end."""
    for j in range(3):
        slope, at_zero = edges[k, j, 0], edges[k, j, 1] * y + edges[k, j, 2]
        if slope > 0.0:
            first = max(first, int(min(max(-at_zero / slope - 1.5, -1.0), 2.0e9)))
        elif slope < 0.0:
            last = min(last, int(min(max(-at_zero / slope + 0.5, -1.0), 2.0e9)))
        elif at_zero < 0.0:
            return 0, -1
    return max(first, 0), last


@compiled_as_written
def depth_buffer(triangles: Triangles, height: int, width: int) -> Any:
    """The triangle that is nearest at the centre of each pixel, or -1; of several equally near ones, the first."""
    found = np.full(height * width, -1, np.int32)
    nearest = np.full(height * width, -math.inf)
    drawn, edges, planes, box = triangles.drawn, triangles.edges, triangles.nearness, triangles.box
    for k in range(len(drawn)):
        if not drawn[k]:
            continue
        for row in range(box[k, 2], box[k, 3] + 1):
            y = row + 0.5
            first, last = _columns(edges, k, y, box[k, 0], box[k, 1])
            for column in range(first, last + 1):
                x = column + 0.5
                if (
                    edges[k, 0, 0] * x + edges[k, 0, 1] * y + edges[k, 0, 2] >= 0.0
                    and edges[k, 1, 0] * x + edges[k, 1, 1] * y + edges[k, 1, 2] >= 0.0
                    and edges[k, 2, 0] * x + edges[k, 2, 1] * y + edges[k, 2, 2] >= 0.0
                ):
                    near = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2]
                    pixel = row * width + column
                    if near > nearest[pixel] and near <= triangles.most:
                        nearest[pixel] = near
                        found[pixel] = k
    return found


@compiled_as_written
def nearness_at(triangles: Triangles, k: int, x: float, y: float) -> float:
    """Of the plane of triangle `k`, at a point."""
    planes = triangles.nearness
    return float(planes[k, 0] * x + planes[k, 1] * y + planes[k, 2])


@compiled_as_written
def ends_at(triangles: Triangles, k: int, x: float, y: float) -> bool:
    """Whether triangle `k` has an edge at a point."""
    edges = triangles.edges
    found = False
    for j in range(3):
        a, b = edges[k, j, 0], edges[k, j, 1]
        found |= abs(a * x + b * y + edges[k, j, 2]) <= SAME_PLACE * math.hypot(a, b)
    return found

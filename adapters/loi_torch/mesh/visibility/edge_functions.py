"""Edge functions of triangles, and the depth buffer at the centres of pixels.

Corners are homogeneous, (x w, y w, w) in pixels, so triangles through the camera's plane need no clipping (Olano and
Greer 1997): a triangle's three edge functions are linear in the pixel and all positive where it is visible. The
arithmetic is as written, without fused products: the edge that two triangles share then has exactly opposite values in
the two, and no pixel falls between them.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.visibility.types import ProjectedScene

__all__ = ["BIN_MARGIN_PX", "Triangles", "covers", "depth_at", "depth_buffer", "has_edge_at", "set_up_triangles"]

BIN_MARGIN_PX: Final = 2e-3  # distance from a pixel of the farthest triangles that are binned to it
DEGENERATE_AREA_RATIO: Final = 1e-9  # largest volume of a triangle seen edge-on, over its bound
SAME_POSITION_PX: Final = 1e-5


class Triangles(NamedTuple):
    """Edge functions and depth planes a x + b y + c of triangles, and their bounding boxes in pixels."""

    in_frame: Any  # (m,) bool
    edges: Any  # (m, 3, 3): function, coefficient
    planes: Any  # (m, 3): reversed depth, larger for nearer surfaces
    facing: (
        Any  # (m,) int8: 1 for counterclockwise corners in (x, y), -1 for clockwise ones, 0 for degenerate triangles
    )
    box: Any  # (m, 4) int32: first and last column, first and last row
    max_depth: float  # reversed depth of the near plane


@compiled_as_written
def _cross(corners: Any, i: int, j: int) -> tuple[float, float, float]:
    # Indexed entry by entry, here and elsewhere: a view of each row costs more than the arithmetic on it.
    x, y, w = corners[i, 0], corners[i, 1], corners[i, 2]
    u, v, s = corners[j, 0], corners[j, 1], corners[j, 2]
    return y * s - w * v, w * u - x * s, x * v - y * u


@compiled_as_written
def _volume_bound(corners: Any, faces: Any, k: int, min_w: float) -> float:
    """Return the square of a triangle's longest side times the `w` of its corners, about the largest possible volume.

    Below a small fraction of this bound, rounding would decide the facing of a triangle seen edge-on. The bound is 0
    for triangles through the near plane.
    """
    longest, product = 0.0, 1.0
    for j in range(3):
        a, b = faces[k, j], faces[k, (j + 1) % 3]
        wa, wb = corners[a, 2], corners[b, 2]
        if wa < min_w:
            return 0.0
        if wb >= min_w:
            x, y = corners[a, 0] / wa - corners[b, 0] / wb, corners[a, 1] / wa - corners[b, 1] / wb
            longest = max(longest, x * x + y * y)
        product *= wa
    return float(longest * product)


@compiled_as_written
def set_up_triangles(scene: ProjectedScene) -> Triangles:
    """Return the edge functions, depth planes and bounding boxes of all triangles."""
    corners, depth, faces = scene.corners, scene.depth, scene.topology.faces
    height, width, min_w = scene.viewport.height, scene.viewport.width, scene.viewport.min_w
    count = len(faces)
    in_frame = np.zeros(count, np.bool_)
    edges = np.empty((count, 3, 3))
    planes = np.zeros((count, 3))
    facing = np.zeros(count, np.int8)
    box = np.zeros((count, 4), np.int32)
    for k in range(count):
        i0, i1, i2 = faces[k, 0], faces[k, 1], faces[k, 2]
        if corners[i0, 2] < min_w and corners[i1, 2] < min_w and corners[i2, 2] < min_w:
            continue
        edges[k, 0, 0], edges[k, 0, 1], edges[k, 0, 2] = _cross(corners, i1, i2)
        edges[k, 1, 0], edges[k, 1, 1], edges[k, 1, 2] = _cross(corners, i2, i0)
        edges[k, 2, 0], edges[k, 2, 1], edges[k, 2, 2] = _cross(corners, i0, i1)
        det = corners[i0, 0] * edges[k, 0, 0] + corners[i0, 1] * edges[k, 0, 1] + corners[i0, 2] * edges[k, 0, 2]
        if not abs(det) > DEGENERATE_AREA_RATIO * _volume_bound(corners, faces, k, min_w):
            continue
        if det < 0.0:
            for j in range(3):
                for axis in range(3):
                    edges[k, j, axis] = -edges[k, j, axis]
        facing[k] = 1 if det > 0.0 else -1
        volume = abs(det)
        for axis in range(3):
            sums = depth[i0] * edges[k, 0, axis] + depth[i1] * edges[k, 1, axis] + depth[i2] * edges[k, 2, axis]
            planes[k, axis] = sums / volume
        left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
        for j in range(3):
            a, b = faces[k, j], faces[k, (j + 1) % 3]
            wa, wb = corners[a, 2], corners[b, 2]
            if wa >= min_w:
                x, y = corners[a, 0] / wa, corners[a, 1] / wa
                left, right, top, bottom = min(left, x), max(right, x), min(top, y), max(bottom, y)
            if (wa >= min_w) != (wb >= min_w):
                t = (min_w - wa) / (wb - wa)
                x = (corners[a, 0] + t * (corners[b, 0] - corners[a, 0])) / min_w
                y = (corners[a, 1] + t * (corners[b, 1] - corners[a, 1])) / min_w
                left, right, top, bottom = min(left, x), max(right, x), min(top, y), max(bottom, y)
        left, right = left - BIN_MARGIN_PX, right + BIN_MARGIN_PX
        top, bottom = top - BIN_MARGIN_PX, bottom + BIN_MARGIN_PX
        if not (right > 0.0 and left < width and bottom > 0.0 and top < height):
            continue
        box[k, 0], box[k, 1] = int(max(left, 0.0)), int(min(right, width - 0.5))
        box[k, 2], box[k, 3] = int(max(top, 0.0)), int(min(bottom, height - 0.5))
        in_frame[k] = True
    return Triangles(in_frame, edges, planes, facing, box, scene.viewport.max_depth)


@compiled_as_written
def _column_range(edges: Any, k: int, y: float, first: int, last: int) -> tuple[int, int]:
    """Return the range of columns with positive edge functions in a row; rounding may add one column at either end."""
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
def covers(triangles: Triangles, k: int, x: float, y: float) -> bool:
    """Return whether (x, y) lies within triangle `k`, or on its outline."""
    edges = triangles.edges
    return bool(
        edges[k, 0, 0] * x + edges[k, 0, 1] * y + edges[k, 0, 2] >= 0.0
        and edges[k, 1, 0] * x + edges[k, 1, 1] * y + edges[k, 1, 2] >= 0.0
        and edges[k, 2, 0] * x + edges[k, 2, 1] * y + edges[k, 2, 2] >= 0.0
    )


@compiled_as_written
def depth_at(triangles: Triangles, k: int, x: float, y: float) -> float:
    """Return the reversed depth of the plane of triangle `k` at (x, y)."""
    planes = triangles.planes
    return float(planes[k, 0] * x + planes[k, 1] * y + planes[k, 2])


@compiled_as_written
def depth_buffer(triangles: Triangles, height: int, width: int) -> Any:
    """Return the nearest triangle at the centre of each pixel, the first of equally near ones, or -1."""
    nearest = np.full(height * width, -1, np.int32)
    buffer = np.full(height * width, -math.inf)
    in_frame, edges, box = triangles.in_frame, triangles.edges, triangles.box
    for k in range(len(in_frame)):
        if not in_frame[k]:
            continue
        for row in range(box[k, 2], box[k, 3] + 1):
            y = row + 0.5
            first, last = _column_range(edges, k, y, box[k, 0], box[k, 1])
            for column in range(first, last + 1):
                x = column + 0.5
                if covers(triangles, k, x, y):
                    depth = depth_at(triangles, k, x, y)
                    pixel = row * width + column
                    if depth > buffer[pixel] and depth <= triangles.max_depth:
                        buffer[pixel] = depth
                        nearest[pixel] = k
    return nearest


@compiled_as_written
def has_edge_at(triangles: Triangles, k: int, x: float, y: float) -> bool:
    """Return whether an edge of triangle `k` passes through (x, y)."""
    edges = triangles.edges
    on_edge = False
    for j in range(3):
        a, b = edges[k, j, 0], edges[k, j, 1]
        on_edge |= abs(a * x + b * y + edges[k, j, 2]) <= SAME_POSITION_PX * math.hypot(a, b)
    return on_edge

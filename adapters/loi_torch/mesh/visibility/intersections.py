"""Visible segments of the intersection of two connected components."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.coverage import END_MARGIN
from loi_torch.mesh.visibility.bins import QUERY_OFFSET_PX, Bins, nearest_triangle
from loi_torch.mesh.visibility.edge_functions import has_edge_at
from loi_torch.mesh.visibility.edge_walk import grow

__all__ = ["intersection_segments", "pixels_between_components"]

MAX_INTERSECTING_TRIANGLES: Final = 24  # nearest triangles of a pixel that are tested for intersection


@compiled_as_written
def pixels_between_components(centre_triangle: Any, component: Any, height: int, width: int) -> Any:
    """Return a mask of the pixels around neighbouring pixels of two components; others show no intersection."""
    selected = np.zeros(height * width, np.bool_)
    for row in range(height):
        for column in range(width):
            triangle = centre_triangle[row * width + column]
            for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
                y, x = row + down, column + right
                if y >= height or x < 0 or x >= width or triangle < 0:
                    continue
                neighbour = centre_triangle[y * width + x]
                if neighbour >= 0 and component[triangle] != component[neighbour]:
                    for i in range(max(row - 1, 0), min(y + 2, height)):
                        for j in range(max(min(column, x) - 1, 0), min(max(column, x) + 2, width)):
                            selected[i * width + j] = True
    return selected


@compiled_as_written
def _clip_to_triangle(
    edges: Any, x: float, y: float, dx: float, dy: float, lower: float, upper: float
) -> tuple[float, float]:
    """Clip the interval (lower, upper) of a line through (x, y) along (dx, dy) to a triangle's edge functions."""
    for j in range(3):
        value, slope = edges[j, 0] * x + edges[j, 1] * y + edges[j, 2], edges[j, 0] * dx + edges[j, 1] * dy
        if slope == 0.0:
            if value < 0.0:
                return 1.0, 0.0
        elif slope > 0.0:
            lower = max(lower, -value / slope)
        else:
            upper = min(upper, -value / slope)
    return lower, upper


@compiled_as_written
def intersection_segments(bins: Bins, component: Any, selected: Any, width: int) -> tuple[Any, Any, Any]:
    """Return the pixel, triangles and points of the intersections of :class:`VisibleSegments`."""
    triangles = bins.triangles
    pixels, pairs, points = np.empty(64, np.int32), np.empty((64, 2), np.int32), np.empty((64, 4))
    count = 0
    for pixel in range(len(selected)):
        bin_index = bins.bin_of_pixel[pixel]
        if not selected[pixel] or bin_index < 0:
            continue
        x, y = pixel % width + 0.5, pixel // width + 0.5
        last = min(bins.first[bin_index + 1], bins.first[bin_index] + MAX_INTERSECTING_TRIANGLES)
        for i in range(bins.first[bin_index], last):
            for j in range(i + 1, last):
                t, u = bins.members[i], bins.members[j]
                if component[t] == component[u]:
                    continue
                difference = triangles.planes[t] - triangles.planes[u]
                length = math.hypot(difference[0], difference[1])
                if not length > 0.0:
                    continue
                nx, ny = difference[0] / length, difference[1] / length
                distance = (difference[0] * x + difference[1] * y + difference[2]) / length
                if abs(distance) > 0.75:  # more than half the diagonal of a pixel
                    continue
                px, py, dx, dy = x - distance * nx, y - distance * ny, ny, -nx
                lower, upper = -2.0, 2.0
                for p, d, middle in ((px, dx, x), (py, dy, y)):
                    if d == 0.0:
                        if abs(p - middle) > 0.5:
                            upper = -3.0
                        continue
                    s0, s1 = (middle - 0.5 - p) / d, (middle + 0.5 - p) / d
                    lower, upper = max(lower, min(s0, s1)), min(upper, max(s0, s1))
                lower, upper = _clip_to_triangle(triangles.edges[t], px, py, dx, dy, lower, upper)
                lower, upper = _clip_to_triangle(triangles.edges[u], px, py, dx, dy, lower, upper)
                if not upper - lower > 1e-9:
                    continue
                margin = END_MARGIN * (upper - lower)
                nearest = min(max(0.0, lower + margin), upper - margin)
                qx, qy = px + nearest * dx, py + nearest * dy
                # Triangles that only meet at an edge of either do not intersect.
                if has_edge_at(triangles, t, qx, qy) or has_edge_at(triangles, u, qx, qy):
                    continue
                # Left of the direction (dx, dy) is (-dy, dx) = (nx, ny), where t is nearer.
                offset_x, offset_y = QUERY_OFFSET_PX * nx, QUERY_OFFSET_PX * ny
                if nearest_triangle(bins, bin_index, qx + offset_x, qy + offset_y) != t:
                    continue
                if nearest_triangle(bins, bin_index, qx - offset_x, qy - offset_y) != u:
                    continue
                pixels, pairs, points = grow(pixels, count + 1), grow(pairs, count + 1), grow(points, count + 1)
                pixels[count], pairs[count, 0], pairs[count, 1] = pixel, t, u
                points[count, 0], points[count, 1] = px + lower * dx, py + lower * dy
                points[count, 2], points[count, 3] = px + upper * dx, py + upper * dy
                count += 1
    return pixels[:count], pairs[:count], points[:count]

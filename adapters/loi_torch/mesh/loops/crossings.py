"""Where triangles of two pieces cut into each other, and it shows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.coverage import ENDS
from loi_torch.mesh.loops.growing import grown
from loi_torch.mesh.loops.lists import Lists, nearest_at
from loi_torch.mesh.loops.triangles import Triangles, ends_at
from loi_torch.mesh.tolerances import ASIDE, PAIRED

__all__ = ["crossings", "near_crossings"]


@compiled_as_written
def near_crossings(found: Any, piece: Any, height: int, width: int) -> Any:
    """The pixels near to which two pieces meet; others cannot show where they cut into each other."""
    wanted = np.zeros(height * width, np.bool_)
    for row in range(height):
        for column in range(width):
            here = found[row * width + column]
            for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
                y, x = row + down, column + right
                if y >= height or x < 0 or x >= width or here < 0:
                    continue
                there = found[y * width + x]
                if there >= 0 and piece[here] != piece[there]:
                    for i in range(max(row - 1, 0), min(y + 2, height)):
                        for j in range(max(min(column, x) - 1, 0), min(max(column, x) + 2, width)):
                            wanted[i * width + j] = True
    return wanted


@compiled_as_written
def _cut(e: Any, x: float, y: float, dx: float, dy: float, low: float, high: float) -> tuple[float, float]:
    """What of a line lies in a triangle."""
    for j in range(3):
        at, slope = e[j, 0] * x + e[j, 1] * y + e[j, 2], e[j, 0] * dx + e[j, 1] * dy
        if slope == 0.0:
            if at < 0.0:
                return 1.0, 0.0
        elif slope > 0.0:
            low = max(low, -at / slope)
        else:
            high = min(high, -at / slope)
    return low, high


@compiled_as_written
def crossings(triangles: Triangles, lists: Lists, piece: Any, wanted: Any, width: int) -> tuple[Any, Any, Any, int]:
    """Where triangles of two pieces cut into each other, and it shows: pixel, the two sides, and the ends in pixels."""
    pixels, sides, ends = np.empty(64, np.int32), np.empty((64, 2), np.int32), np.empty((64, 4))
    count = 0
    for pixel in range(len(wanted)):
        one = lists.slot[pixel]
        if not wanted[pixel] or one < 0:
            continue
        x, y = pixel % width + 0.5, pixel // width + 0.5
        last = min(lists.first[one + 1], lists.first[one] + PAIRED)
        for i in range(lists.first[one], last):
            for j in range(i + 1, last):
                t, u = lists.triangle[i], lists.triangle[j]
                if piece[t] == piece[u]:
                    continue
                difference = triangles.nearness[t] - triangles.nearness[u]
                length = math.hypot(difference[0], difference[1])
                if not length > 0.0:
                    continue
                nx, ny = difference[0] / length, difference[1] / length
                away = (difference[0] * x + difference[1] * y + difference[2]) / length
                if abs(away) > 0.75:
                    continue
                px, py, dx, dy = x - away * nx, y - away * ny, ny, -nx
                low, high = -2.0, 2.0
                for p, d, middle in ((px, dx, x), (py, dy, y)):
                    if d == 0.0:
                        if abs(p - middle) > 0.5:
                            high = -3.0
                        continue
                    s0, s1 = (middle - 0.5 - p) / d, (middle + 0.5 - p) / d
                    low, high = max(low, min(s0, s1)), min(high, max(s0, s1))
                low, high = _cut(triangles.edges[t], px, py, dx, dy, low, high)
                low, high = _cut(triangles.edges[u], px, py, dx, dy, low, high)
                if not high - low > 1e-9:
                    continue
                ends_of = ENDS * (high - low)
                nearest = min(max(0.0, low + ends_of), high - ends_of)
                qx, qy = px + nearest * dx, py + nearest * dy
                # Triangles that only meet at an edge of one of them do not cut into each other.
                if ends_at(triangles, t, qx, qy) or ends_at(triangles, u, qx, qy):
                    continue
                # Left of the direction (dx, dy) is (-dy, dx) = (nx, ny), where t is nearer.
                if nearest_at(triangles, lists, one, qx + ASIDE * nx, qy + ASIDE * ny) != t:
                    continue
                if nearest_at(triangles, lists, one, qx - ASIDE * nx, qy - ASIDE * ny) != u:
                    continue
                pixels, sides, ends = grown(pixels, count + 1), grown(sides, count + 1), grown(ends, count + 1)
                pixels[count], sides[count, 0], sides[count, 1] = pixel, t, u
                ends[count, 0], ends[count, 1] = px + low * dx, py + low * dy
                ends[count, 2], ends[count, 3] = px + high * dx, py + high * dy
                count += 1
    return pixels, sides, ends, count

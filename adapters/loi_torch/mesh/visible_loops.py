"""What is visible where, compiled by Numba: a depth buffer at the pixels' centres, and the edges that show.

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
from loi_torch.mesh.coverage import ENDS
from loi_torch.mesh.projected import FloatArray, IndexArray, Projected, Seen
from loi_torch.mesh.tolerances import ASIDE, EDGE_ON, HALVINGS, MARGIN, PAIRED, SAME_DEPTH, SAME_PLACE

__all__ = ["look"]


class Triangles(NamedTuple):
    """Of each triangle: whether it is drawn, its edge functions and nearness a x + b y + c, and its box of pixels."""

    drawn: Any  # (m,) bool
    edges: Any  # (m, 3, 3): function, coefficient
    nearness: Any  # (m, 3)
    facing: Any  # (m,) int8, 1 for counterclockwise corners as numbers, -1 for clockwise ones
    box: Any  # (m, 4) int32: first and last column, first and last row, of pixels that it may touch
    most: float  # nearness of the near plane


class Lists(NamedTuple):
    """The triangles that may show in each pixel that has a list."""

    slot: Any  # (H * W,) int32: the pixel's list, or -1
    first: Any  # (k + 1,) int64
    triangle: Any  # int32; of each list those that may be nearest come first
    pixel: Any  # of each list, int32
    width: int  # of the image


class Line(NamedTuple):
    """An edge on the screen: a point and the way to its end, its normal, its corners, and what of it is in front."""

    x: float
    y: float
    dx: float
    dy: float
    nx: float
    ny: float
    a: Any  # int32
    b: Any
    start: float
    end: float
    wa: float
    wb: float


class Shown(NamedTuple):
    """Parts of edges that show, as in :class:`loi_torch.mesh.projected.Seen`."""

    edge: Any
    span: Any
    pixel: Any
    sides: Any
    beyond: Any


@compiled_as_written
def _cross(u: Any, v: Any, out: Any) -> None:
    out[0] = u[1] * v[2] - u[2] * v[1]
    out[1] = u[2] * v[0] - u[0] * v[2]
    out[2] = u[0] * v[1] - u[1] * v[0]


@compiled_as_written
def _largest(corners: Any, face: Any, near: float) -> float:
    """The square of a triangle's longest side, times its corners' w: its volume is at most about this.

    Rounding would decide which way a triangle faces that is seen edge-on. 0 for triangles through the near plane.
    """
    longest = 0.0
    for j in range(3):
        a, b = corners[face[j]], corners[face[(j + 1) % 3]]
        if a[2] < near:
            return 0.0
        if b[2] >= near:
            longest = max(longest, (a[0] / a[2] - b[0] / b[2]) ** 2 + (a[1] / a[2] - b[1] / b[2]) ** 2)
    return float(longest * corners[face[0], 2] * corners[face[1], 2] * corners[face[2], 2])


@compiled_as_written
def _prepare(corners: Any, depth: Any, faces: Any, height: int, width: int, near: float, most: float) -> Triangles:
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
        _cross(corners[i1], corners[i2], edges[k, 0])
        _cross(corners[i2], corners[i0], edges[k, 1])
        _cross(corners[i0], corners[i1], edges[k, 2])
        det = corners[i0, 0] * edges[k, 0, 0] + corners[i0, 1] * edges[k, 0, 1] + corners[i0, 2] * edges[k, 0, 2]
        if not abs(det) > EDGE_ON * _largest(corners, faces[k], near):
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
def _columns(edges: Any, y: float, first: int, last: int) -> tuple[int, int]:
    """The columns of a row in which all edge functions may be positive; rounding may add one at either end."""
    for j in range(3):
        slope, at_zero = edges[j, 0], edges[j, 1] * y + edges[j, 2]
        if slope > 0.0:
            first = max(first, int(min(max(-at_zero / slope - 1.5, -1.0), 2.0e9)))
        elif slope < 0.0:
            last = min(last, int(min(max(-at_zero / slope + 0.5, -1.0), 2.0e9)))
        elif at_zero < 0.0:
            return 0, -1
    return max(first, 0), last


@compiled_as_written
def _depth_buffer(triangles: Triangles, height: int, width: int) -> Any:
    """The triangle that is nearest at the centre of each pixel, or -1; of several equally near ones, the first."""
    found = np.full(height * width, -1, np.int32)
    nearest = np.full(height * width, -math.inf)
    for k in range(len(triangles.drawn)):
        if not triangles.drawn[k]:
            continue
        e, n = triangles.edges[k], triangles.nearness[k]
        for row in range(triangles.box[k, 2], triangles.box[k, 3] + 1):
            y = row + 0.5
            first, last = _columns(e, y, triangles.box[k, 0], triangles.box[k, 1])
            for column in range(first, last + 1):
                x = column + 0.5
                if (
                    e[0, 0] * x + e[0, 1] * y + e[0, 2] >= 0.0
                    and e[1, 0] * x + e[1, 1] * y + e[1, 2] >= 0.0
                    and e[2, 0] * x + e[2, 1] * y + e[2, 2] >= 0.0
                ):
                    near = n[0] * x + n[1] * y + n[2]
                    pixel = row * width + column
                    if near > nearest[pixel] and near <= triangles.most:
                        nearest[pixel] = near
                        found[pixel] = k
    return found


@compiled_as_written
def _edge_in_frame(
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
def _grown(array: Any, size: int) -> Any:
    if size <= len(array):
        return array
    longer = np.empty((max(size, 2 * len(array)), *array.shape[1:]), array.dtype)
    # Entry by entry: where Numba assigns arrays, it compiles for seconds what it would say of other shapes.
    new, old = longer.reshape(-1), array.reshape(-1)
    for index in range(len(old)):
        new[index] = old[index]
    return longer


@compiled_as_written
def _walk(corners: Any, edges: Any, height: int, width: int, near: float) -> tuple[Any, Any, Any]:
    """Cut edges where they leave pixels: of each part its edge, its pixel, and what of the edge it is on the screen."""
    edge, pixel, part = np.empty(1024, np.int32), np.empty(1024, np.int32), np.empty((1024, 2))
    count = 0
    for k in range(len(edges)):
        inside, xa, ya, xb, yb, _, _, low, high = _edge_in_frame(
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
                edge, pixel, part = _grown(edge, count + 1), _grown(pixel, count + 1), _grown(part, count + 1)
                edge[count], pixel[count] = k, row * width + column
                part[count, 0], part[count, 1] = s, nearest
                count += 1
            s = nearest
    return edge[:count], pixel[:count], part[:count]


@compiled_as_written
def _touches(e: Any, x: float, y: float) -> bool:
    """Whether a triangle may touch the pixel with its centre at (x, y)."""
    half = 0.5 + MARGIN
    reached = True
    for j in range(3):
        reached &= e[j, 0] * x + e[j, 1] * y + e[j, 2] + half * (abs(e[j, 0]) + abs(e[j, 1])) >= 0.0
    return reached


@compiled_as_written
def _most_near(plane: Any, x: float, y: float) -> float:
    """At least the most nearness of a triangle's plane within the pixel with its centre at (x, y)."""
    half = 0.5 + MARGIN
    most = plane[0] * x + plane[1] * y + plane[2] + half * (abs(plane[0]) + abs(plane[1]))
    return float(most + 1e-12 * abs(most))


@compiled_as_written
def _list(triangles: Triangles, wanted: Any, height: int, width: int) -> Lists:
    """Lists of the triangles in the wanted pixels."""
    slot = np.full(height * width, -1, np.int32)
    pixel_of = np.empty(height * width, np.int32)
    # Of each row, how many wanted pixels lie before each column: boxes without any are skipped.
    before = np.zeros((height, width + 1), np.int32)
    count = 0
    for pixel in range(height * width):
        row, column = pixel // width, pixel % width
        before[row, column + 1] = before[row, column]
        if wanted[pixel]:
            slot[pixel] = count
            pixel_of[count] = pixel
            count += 1
            before[row, column + 1] += 1
    first = np.zeros(count + 1, np.int64)
    listed = np.empty(0, np.int32)
    for filling in range(2):
        if filling:
            for k in range(count):
                first[k + 1] += first[k]
            listed = np.empty(first[count], np.int32)
            place = first[:-1].copy()
        for k in range(len(triangles.drawn)):
            if not triangles.drawn[k]:
                continue
            left, right = triangles.box[k, 0], triangles.box[k, 1]
            for row in range(triangles.box[k, 2], triangles.box[k, 3] + 1):
                if before[row, right + 1] == before[row, left]:
                    continue
                for column in range(left, right + 1):
                    one = slot[row * width + column]
                    if one >= 0 and _touches(triangles.edges[k], column + 0.5, row + 0.5):
                        if filling:
                            listed[place[one]] = k
                            place[one] += 1
                        else:
                            first[one + 1] += 1
    for k in range(count):
        own = listed[first[k] : first[k + 1]]
        bound = np.empty(len(own))
        pixel = pixel_of[k]
        for j in range(len(own)):
            bound[j] = -_most_near(triangles.nearness[own[j]], pixel % width + 0.5, pixel // width + 0.5)
        kept, order = own.copy(), np.argsort(bound, kind="mergesort")
        for j in range(len(own)):
            own[j] = kept[order[j]]  # which is a part of `listed`
    return Lists(slot, first, listed, pixel_of, width)


@compiled_as_written
def _nearest(triangles: Triangles, lists: Lists, one: int, x: float, y: float) -> int:
    """The triangle that is nearest at a point of the pixel with list `one`, or -1."""
    found, nearest = -1, -math.inf
    middle_x, middle_y = lists.pixel[one] % lists.width + 0.5, lists.pixel[one] // lists.width + 0.5
    for place in range(lists.first[one], lists.first[one + 1]):
        k = lists.triangle[place]
        e, n = triangles.edges[k], triangles.nearness[k]
        if _most_near(n, middle_x, middle_y) < nearest:
            break  # as are all that follow
        if (
            e[0, 0] * x + e[0, 1] * y + e[0, 2] >= 0.0
            and e[1, 0] * x + e[1, 1] * y + e[1, 2] >= 0.0
            and e[2, 0] * x + e[2, 1] * y + e[2, 2] >= 0.0
        ):
            near = n[0] * x + n[1] * y + n[2]
            if near <= triangles.most and (near > nearest or (near == nearest and k < found)):
                found, nearest = k, near
    return found


@compiled_as_written
def _touching(triangles: Triangles, left: int, right: int, x: float, y: float) -> bool:
    """Whether two triangles are equally near at a point."""
    near, far = _near(triangles, left, x, y), _near(triangles, right, x, y)
    return bool(abs(near - far) <= SAME_DEPTH * max(abs(near), abs(far)))


@compiled_as_written
def _near(triangles: Triangles, k: int, x: float, y: float) -> float:
    plane = triangles.nearness[k]
    return float(plane[0] * x + plane[1] * y + plane[2])


@compiled_as_written
def _front(triangles: Triangles, left: int, right: int, x: float, y: float) -> int:
    """Which of the triangles on the two sides of a point of an edge is in front there."""
    if left < 0 or right < 0:
        return max(left, right)
    return left if _near(triangles, left, x, y) > _near(triangles, right, x, y) else right


@compiled_as_written
def _ends_at(e: Any, x: float, y: float) -> bool:
    """Whether a triangle has an edge at a point."""
    found = False
    for j in range(3):
        found |= abs(e[j, 0] * x + e[j, 1] * y + e[j, 2]) <= SAME_PLACE * math.hypot(e[j, 0], e[j, 1])
    return found


@compiled_as_written
def _has(face: Any, a: int, b: int) -> bool:
    return bool((face[0] == a or face[1] == a or face[2] == a) and (face[0] == b or face[1] == b or face[2] == b))


@compiled_as_written
def _sides(triangles: Triangles, lists: Lists, one: int, joined: Any, line: Line, s: float) -> tuple[bool, int, int]:
    """Whether an edge shows at a point of it, and the triangles on its left and right there.

    It does if it is of the triangle in front. Where one only touches the other, as a box does the floor that it stands
    on, it is enough to be of either; but if the other ends there as well, each with its own edge, only one edge counts.
    """
    x, y = line.x + s * line.dx, line.y + s * line.dy
    left = _nearest(triangles, lists, one, x + ASIDE * line.nx, y + ASIDE * line.ny)
    right = _nearest(triangles, lists, one, x - ASIDE * line.nx, y - ASIDE * line.ny)
    if left == right:
        return False, left, right
    if left < 0 or right < 0 or not _touching(triangles, left, right, x, y):
        return _has(joined[_front(triangles, left, right, x, y)], line.a, line.b), left, right
    of_left, of_right = _has(joined[left], line.a, line.b), _has(joined[right], line.a, line.b)
    if of_left == of_right:
        return of_left, left, right
    own, other = (left, right) if of_left else (right, left)
    return own < other or not _ends_at(triangles.edges[other], x, y), left, right


@compiled_as_written
def _beside(line: Line, pixel: int, width: int, low: float, high: float) -> float:
    """Where a part of an edge is looked at: see :func:`loi_torch.mesh.coverage.nearest_point`."""
    x, y = pixel % width + 0.5 - line.x, pixel // width + 0.5 - line.y
    nearest = (x * line.dx + y * line.dy) / (line.dx * line.dx + line.dy * line.dy)
    ends = ENDS * (high - low)
    return min(max(nearest, low + ends), high - ends)


@compiled_as_written
def _in_space(line: Line, s: float) -> float:
    """From the share of an edge on the screen to that of the whole edge in space."""
    return line.start + (line.end - line.start) * (s * line.wa / (line.wb - s * (line.wb - line.wa)))


@compiled_as_written
def _active(triangles: Triangles, between: Any, always: Any) -> Any:
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
def _crossed(found: Any, piece: Any, height: int, width: int) -> Any:
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
def _crossings(triangles: Triangles, lists: Lists, piece: Any, wanted: Any, width: int) -> tuple[Any, Any, Any, int]:
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
                if _ends_at(triangles.edges[t], qx, qy) or _ends_at(triangles.edges[u], qx, qy):
                    continue
                # Left of the direction (dx, dy) is (-dy, dx) = (nx, ny), where t is nearer.
                if _nearest(triangles, lists, one, qx + ASIDE * nx, qy + ASIDE * ny) != t:
                    continue
                if _nearest(triangles, lists, one, qx - ASIDE * nx, qy - ASIDE * ny) != u:
                    continue
                pixels, sides, ends = _grown(pixels, count + 1), _grown(sides, count + 1), _grown(ends, count + 1)
                pixels[count], sides[count, 0], sides[count, 1] = pixel, t, u
                ends[count, 0], ends[count, 1] = px + low * dx, py + low * dy
                ends[count, 2], ends[count, 3] = px + high * dx, py + high * dy
                count += 1
    return pixels, sides, ends, count


@compiled_as_written
def _look(
    corners: Any,
    depth: Any,
    faces: Any,
    joined: Any,
    piece: Any,
    ends: Any,
    joined_ends: Any,
    between: Any,
    always: Any,
    height: int,
    width: int,
    near: float,
    most: float,
    several: bool,
) -> Any:
    triangles = _prepare(corners, depth, faces, height, width, near, most)
    found = _depth_buffer(triangles, height, width)
    active = _active(triangles, between, always)
    part_edge, part_pixel, part = _walk(corners, ends[active], height, width, near)
    crossed = _crossed(found, piece, height, width) if several else np.zeros(height * width, np.bool_)
    wanted = crossed.copy()
    for pixel in part_pixel:
        wanted[pixel] = True
    lists = _list(triangles, wanted, height, width)
    total = len(part_pixel)
    shown = Shown(
        np.empty(2 * total, np.int32),
        np.empty((2 * total, 2)),
        np.empty(2 * total, np.int32),
        np.empty((2 * total, 2), np.int32),
        np.full((2 * total, 2), -1, np.int32),
    )
    count = 0
    last_edge = -1
    line = Line(0.0, 0.0, 1.0, 1.0, 1.0, 0.0, np.int32(0), np.int32(0), 0.0, 1.0, 1.0, 1.0)
    for k in range(total):
        number = active[part_edge[k]]
        if number != last_edge:
            last_edge = number
            first, second = corners[ends[number, 0]], corners[ends[number, 1]]
            _, xa, ya, xb, yb, start, end, _, _ = _edge_in_frame(first, second, near, height, width)
            length = math.hypot(xb - xa, yb - ya)
            nx, ny = -(yb - ya) / length, (xb - xa) / length
            wa, wb = first[2] + start * (second[2] - first[2]), first[2] + end * (second[2] - first[2])
            a, b = joined_ends[number, 0], joined_ends[number, 1]
            line = Line(xa, ya, xb - xa, yb - ya, nx, ny, a, b, start, end, wa, wb)
        one = lists.slot[part_pixel[k]]
        low, high = part[k, 0], part[k, 1]
        middle = _beside(line, part_pixel[k], width, low, high)
        lit, left, right = _sides(triangles, lists, one, joined, line, middle)
        bounds = np.array([low, high])
        hidden = np.full(2, -1, np.int32)
        for side in range(2):
            limit = bounds[side]
            shows, at_left, at_right = _sides(triangles, lists, one, joined, line, limit + 1e-4 * (middle - limit))
            if shows == lit:
                continue
            light, dark = (middle, limit) if lit else (limit, middle)
            for _ in range(HALVINGS):
                between_both = 0.5 * (light + dark)
                if _sides(triangles, lists, one, joined, line, between_both)[0]:
                    light = between_both
                else:
                    dark = between_both
            _, dark_left, dark_right = _sides(triangles, lists, one, joined, line, dark)
            hider = _front(triangles, dark_left, dark_right, line.x + dark * line.dx, line.y + dark * line.dy)
            if lit:
                bounds[side], hidden[side] = 0.5 * (light + dark), hider
            else:
                away = 1 - side
                shown.beyond[count, away] = hider
                shown.span[count, side] = _in_space(line, limit)
                shown.span[count, away] = _in_space(line, 0.5 * (light + dark))
                shown.sides[count, 0], shown.sides[count, 1] = at_left, at_right
                shown.edge[count], shown.pixel[count] = number, part_pixel[k]
                count += 1
        if lit:
            shown.beyond[count] = hidden
            shown.span[count, 0], shown.span[count, 1] = _in_space(line, bounds[0]), _in_space(line, bounds[1])
            shown.sides[count, 0], shown.sides[count, 1] = left, right
            shown.edge[count], shown.pixel[count] = number, part_pixel[k]
            count += 1
    cross_pixels, cross_sides, cross_ends, crosses = _crossings(triangles, lists, piece, crossed, width)
    return (
        found,
        shown.edge[:count],
        shown.span[:count],
        shown.pixel[:count],
        shown.sides[:count],
        shown.beyond[:count],
        cross_pixels[:crosses],
        cross_sides[:crosses],
        cross_ends[:crosses],
        triangles,
        lists,
    )


@compiled_as_written
def _beside_edges(corners: Any, ends: Any, triangles: Triangles, lists: Lists, edge: Any, pixel: Any, at: Any) -> Any:
    found = np.full((len(edge), 2), -1, np.int32)
    for k in range(len(edge)):
        one = lists.slot[pixel[k]]
        a, b = corners[ends[edge[k], 0]], corners[ends[edge[k], 1]]
        w = a[2] + at[k] * (b[2] - a[2])
        x, y = (a[0] + at[k] * (b[0] - a[0])) / w, (a[1] + at[k] * (b[1] - a[1])) / w
        # The edge's direction on the screen, whatever the sign of w at its ends.
        dx, dy = b[0] * a[2] - a[0] * b[2], b[1] * a[2] - a[1] * b[2]
        length = math.hypot(dx, dy)
        if one < 0 or not length > 0.0:
            continue
        nx, ny = -ASIDE * dy / length, ASIDE * dx / length
        found[k, 0] = _nearest(triangles, lists, one, x + nx, y + ny)
        found[k, 1] = _nearest(triangles, lists, one, x - nx, y - ny)
    return found


def look(scene: Projected) -> Seen:
    """What is seen of a projected scene."""
    shape, view = scene.topology, scene.view
    found = _look(
        scene.corners,
        scene.depth,
        shape.faces,
        shape.joined,
        shape.piece,
        shape.ends,
        shape.joined_ends,
        shape.between,
        shape.always,
        view.height,
        view.width,
        view.near,
        view.most,
        shape.several,
    )

    triangles, lists = found[-2:]

    def beside(edge: IndexArray, pixel: IndexArray, at: FloatArray) -> IndexArray:
        sides: IndexArray = _beside_edges(scene.corners, shape.ends, triangles, lists, edge, pixel, at)
        return sides

    columns: list[Any] = [*found[:-2], beside]
    return Seen(*columns)

"""What is visible where: the depth buffer, and the edges that show."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.coverage import ENDS
from loi_torch.mesh.loops.crossings import crossings, near_crossings
from loi_torch.mesh.loops.edges import active_edges, edge_in_frame, walk
from loi_torch.mesh.loops.lists import Lists, lists_of, nearest_at
from loi_torch.mesh.loops.triangles import Triangles, depth_buffer, ends_at, nearness_at, prepare
from loi_torch.mesh.projected import FloatArray, IndexArray, Projected, Seen
from loi_torch.mesh.tolerances import ASIDE, HALVINGS, SAME_DEPTH

__all__ = ["look"]


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
def _touching(triangles: Triangles, left: int, right: int, x: float, y: float) -> bool:
    """Whether two triangles are equally near at a point."""
    near, far = nearness_at(triangles, left, x, y), nearness_at(triangles, right, x, y)
    return bool(abs(near - far) <= SAME_DEPTH * max(abs(near), abs(far)))


@compiled_as_written
def _front(triangles: Triangles, left: int, right: int, x: float, y: float) -> int:
    """Which of the triangles on the two sides of a point of an edge is in front there."""
    if left < 0 or right < 0:
        return max(left, right)
    return left if nearness_at(triangles, left, x, y) > nearness_at(triangles, right, x, y) else right


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
    left = nearest_at(triangles, lists, one, x + ASIDE * line.nx, y + ASIDE * line.ny)
    right = nearest_at(triangles, lists, one, x - ASIDE * line.nx, y - ASIDE * line.ny)
    if left == right:
        return False, left, right
    if left < 0 or right < 0 or not _touching(triangles, left, right, x, y):
        return _has(joined[_front(triangles, left, right, x, y)], line.a, line.b), left, right
    of_left, of_right = _has(joined[left], line.a, line.b), _has(joined[right], line.a, line.b)
    if of_left == of_right:
        return of_left, left, right
    own, other = (left, right) if of_left else (right, left)
    return own < other or not ends_at(triangles.edges[other], x, y), left, right


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
    triangles = prepare(corners, depth, faces, height, width, near, most)
    found = depth_buffer(triangles, height, width)
    active = active_edges(triangles, between, always)
    part_edge, part_pixel, part = walk(corners, ends[active], height, width, near)
    crossed = near_crossings(found, piece, height, width) if several else np.zeros(height * width, np.bool_)
    wanted = crossed.copy()
    for pixel in part_pixel:
        wanted[pixel] = True
    lists = lists_of(triangles, wanted, height, width)
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
            _, xa, ya, xb, yb, start, end, _, _ = edge_in_frame(first, second, near, height, width)
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
    cross_pixels, cross_sides, cross_ends, crosses = crossings(triangles, lists, piece, crossed, width)
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
        found[k, 0] = nearest_at(triangles, lists, one, x + nx, y + ny)
        found[k, 1] = nearest_at(triangles, lists, one, x - nx, y - ny)
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

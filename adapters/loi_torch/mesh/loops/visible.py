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


class Scene(NamedTuple):
    """Edges in space, as in :class:`loi_torch.mesh.projected.Projected`."""

    corners: Any
    ends: Any
    joined: Any
    joined_ends: Any
    height: int
    width: int
    near: float


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
def _has(joined: Any, k: int, a: int, b: int) -> bool:
    # Entry by entry, here and elsewhere: each row that is taken out costs as much as looking at a triangle.
    one, two, three = joined[k, 0], joined[k, 1], joined[k, 2]
    return bool((one == a or two == a or three == a) and (one == b or two == b or three == b))


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
        return _has(joined, _front(triangles, left, right, x, y), line.a, line.b), left, right
    of_left, of_right = _has(joined, left, line.a, line.b), _has(joined, right, line.a, line.b)
    if of_left == of_right:
        return of_left, left, right
    own, other = (left, right) if of_left else (right, left)
    return own < other or not ends_at(triangles, other, x, y), left, right


@compiled_as_written
def _comes_to_light(
    triangles: Triangles, lists: Lists, one: int, joined: Any, line: Line, light: float, dark: float
) -> tuple[float, int]:
    """Where between two points, of which it shows at one, an edge comes to light, and what hides it there."""
    for _ in range(HALVINGS):
        middle = 0.5 * (light + dark)
        if _sides(triangles, lists, one, joined, line, middle)[0]:
            light = middle
        else:
            dark = middle
    _, left, right = _sides(triangles, lists, one, joined, line, dark)
    hider = _front(triangles, left, right, line.x + dark * line.dx, line.y + dark * line.dy)
    return 0.5 * (light + dark), hider


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
def _line_of(scene: Scene, number: int) -> Line:
    """An edge on the screen, of which a part is in the frame."""
    one, other = scene.ends[number, 0], scene.ends[number, 1]
    _, xa, ya, xb, yb, start, end, _, _ = edge_in_frame(
        scene.corners[one], scene.corners[other], scene.near, scene.height, scene.width
    )
    length = math.hypot(xb - xa, yb - ya)
    w, deeper = scene.corners[one, 2], scene.corners[other, 2] - scene.corners[one, 2]
    return Line(
        xa,
        ya,
        xb - xa,
        yb - ya,
        -(yb - ya) / length,
        (xb - xa) / length,
        scene.joined_ends[number, 0],
        scene.joined_ends[number, 1],
        start,
        end,
        w + start * deeper,
        w + end * deeper,
    )


@compiled_as_written
def _shown(
    scene: Scene, triangles: Triangles, lists: Lists, active: Any, part_edge: Any, part_pixel: Any, part: Any
) -> tuple[Any, Any, Any, Any, Any]:
    """The parts of edges that show, as in :class:`loi_torch.mesh.projected.Seen`."""
    total = len(part_pixel)
    edge, span, pixels = np.empty(2 * total, np.int32), np.empty((2 * total, 2)), np.empty(2 * total, np.int32)
    sides, beyond = np.empty((2 * total, 2), np.int32), np.full((2 * total, 2), -1, np.int32)
    joined, slot = scene.joined, lists.slot
    count = 0
    for k in range(total):
        number, pixel = active[part_edge[k]], part_pixel[k]
        if k == 0 or part_edge[k] != part_edge[k - 1]:
            line = _line_of(scene, number)
        one = slot[pixel]
        middle = _beside(line, pixel, scene.width, part[k, 0], part[k, 1])
        lit, left, right = _sides(triangles, lists, one, joined, line, middle)
        for side in range(2):
            limit = part[k, side]
            shows, at_left, at_right = _sides(triangles, lists, one, joined, line, limit + 1e-4 * (middle - limit))
            if shows == lit:
                if lit:
                    span[count, side] = _in_space(line, limit)
                continue
            light, dark = (middle, limit) if lit else (limit, middle)
            border, hider = _comes_to_light(triangles, lists, one, joined, line, light, dark)
            away = side if lit else 1 - side
            span[count, away], beyond[count, away] = _in_space(line, border), hider
            if not lit:
                span[count, side] = _in_space(line, limit)
                sides[count, 0], sides[count, 1] = at_left, at_right
                edge[count], pixels[count] = number, pixel
                count += 1
        if lit:
            sides[count, 0], sides[count, 1] = left, right
            edge[count], pixels[count] = number, pixel
            count += 1
    return edge[:count], span[:count], pixels[:count], sides[:count], beyond[:count]


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
    scene = Scene(corners, ends, joined, joined_ends, height, width, near)
    edge, span, pixels, sides, beyond = _shown(scene, triangles, lists, active, part_edge, part_pixel, part)
    cross_pixels, cross_sides, cross_ends, crosses = crossings(triangles, lists, piece, crossed, width)
    return (
        found,
        edge,
        span,
        pixels,
        sides,
        beyond,
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

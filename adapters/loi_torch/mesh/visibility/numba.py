"""Visible edge segments: visibility queries on both sides of edges, and bisection where the result changes."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.coverage import END_MARGIN
from loi_torch.mesh.topology import FloatArray, IndexArray
from loi_torch.mesh.visibility.bins import QUERY_OFFSET_PX, Bins, bin_triangles, nearest_triangle
from loi_torch.mesh.visibility.edge_functions import Triangles, depth_at, depth_buffer, has_edge_at, set_up_triangles
from loi_torch.mesh.visibility.edge_walk import clip_edge, discontinuity_edges, walk_edges
from loi_torch.mesh.visibility.intersections import intersection_segments, pixels_between_components
from loi_torch.mesh.visibility.types import ProjectedScene, VisibleSegments

__all__ = ["find_visible"]

MAX_RELATIVE_CONTACT_DEPTH: Final = 1e-9  # relative difference in depth between touching surfaces
N_BISECTIONS: Final = 14  # of an edge within a pixel


class ScreenEdge(NamedTuple):
    """An edge in pixels, clipped to the near plane."""

    x: float  # start
    y: float
    dx: float  # start to end
    dy: float
    nx: float  # unit normal
    ny: float
    a: Any  # int32: welded vertices
    b: Any
    start: float  # positions on the whole edge, 0 to 1 in world space
    end: float
    wa: float
    wb: float


@compiled_as_written
def _are_touching(triangles: Triangles, left: int, right: int, x: float, y: float) -> bool:
    """Return whether two triangles have the same depth at a point."""
    left_depth, right_depth = depth_at(triangles, left, x, y), depth_at(triangles, right, x, y)
    tolerance = MAX_RELATIVE_CONTACT_DEPTH * max(abs(left_depth), abs(right_depth))
    return bool(abs(left_depth - right_depth) <= tolerance)


@compiled_as_written
def _front_triangle(triangles: Triangles, left: int, right: int, x: float, y: float) -> int:
    """Return the nearer of the triangles on the two sides of an edge point."""
    if left < 0 or right < 0:
        return max(left, right)
    return left if depth_at(triangles, left, x, y) > depth_at(triangles, right, x, y) else right


@compiled_as_written
def _has_edge(welded_faces: Any, k: int, a: int, b: int) -> bool:
    # Entry by entry, here and elsewhere: a view of the row costs as much as a test of a triangle.
    i, j, l = welded_faces[k, 0], welded_faces[k, 1], welded_faces[k, 2]  # noqa: E741
    return bool((i == a or j == a or l == a) and (i == b or j == b or l == b))


@compiled_as_written
def _query(bins: Bins, bin_index: int, welded_faces: Any, edge: ScreenEdge, s: float) -> tuple[bool, int, int]:
    """Return whether an edge is visible at `s`, and the triangles on its left and right there.

    It is visible if it belongs to the triangle in front. Where the two triangles touch, as a box touches the floor, it
    may belong to either; but if both end there with different edges, only one of these edges is counted.
    """
    triangles = bins.triangles
    x, y = edge.x + s * edge.dx, edge.y + s * edge.dy
    offset_x, offset_y = QUERY_OFFSET_PX * edge.nx, QUERY_OFFSET_PX * edge.ny
    left = nearest_triangle(bins, bin_index, x + offset_x, y + offset_y)
    right = nearest_triangle(bins, bin_index, x - offset_x, y - offset_y)
    if left == right:
        return False, left, right
    if left < 0 or right < 0 or not _are_touching(triangles, left, right, x, y):
        return _has_edge(welded_faces, _front_triangle(triangles, left, right, x, y), edge.a, edge.b), left, right
    on_left, on_right = _has_edge(welded_faces, left, edge.a, edge.b), _has_edge(welded_faces, right, edge.a, edge.b)
    if on_left == on_right:
        return on_left, left, right
    owner, neighbour = (left, right) if on_left else (right, left)
    return owner < neighbour or not has_edge_at(triangles, neighbour, x, y), left, right


@compiled_as_written
def _bisect_visibility(
    bins: Bins, bin_index: int, welded_faces: Any, edge: ScreenEdge, visible: float, hidden: float
) -> tuple[float, int]:
    """Return the position between a visible and a hidden one where an edge disappears, and its occluder there."""
    for _ in range(N_BISECTIONS):
        middle = 0.5 * (visible + hidden)
        if _query(bins, bin_index, welded_faces, edge, middle)[0]:
            visible = middle
        else:
            hidden = middle
    _, left, right = _query(bins, bin_index, welded_faces, edge, hidden)
    x, y = edge.x + hidden * edge.dx, edge.y + hidden * edge.dy
    return 0.5 * (visible + hidden), _front_triangle(bins.triangles, left, right, x, y)


@compiled_as_written
def _query_position(edge: ScreenEdge, pixel: int, width: int, lower: float, upper: float) -> float:
    """Return the position of a segment's visibility query, see :func:`loi_torch.mesh.coverage.nearest_point`."""
    x, y = pixel % width + 0.5 - edge.x, pixel // width + 0.5 - edge.y
    nearest = (x * edge.dx + y * edge.dy) / (edge.dx * edge.dx + edge.dy * edge.dy)
    margin = END_MARGIN * (upper - lower)
    return min(max(nearest, lower + margin), upper - margin)


@compiled_as_written
def _to_world(edge: ScreenEdge, s: float) -> float:
    """Convert a position on the edge on the screen to one on the whole edge in world space."""
    return edge.start + (edge.end - edge.start) * (s * edge.wa / (edge.wb - s * (edge.wb - edge.wa)))


@compiled_as_written
def _screen_edge(scene: ProjectedScene, index: int) -> ScreenEdge:
    corners, view = scene.corners, scene.viewport
    i, j = scene.topology.edges[index, 0], scene.topology.edges[index, 1]
    _, x, y, end_x, end_y, start, end, _, _ = clip_edge(corners[i], corners[j], view.min_w, view.height, view.width)
    dx, dy = end_x - x, end_y - y
    length = math.hypot(dx, dy)
    w, w_change = corners[i, 2], corners[j, 2] - corners[i, 2]
    wa, wb = w + start * w_change, w + end * w_change
    a, b = scene.topology.welded_edges[index, 0], scene.topology.welded_edges[index, 1]
    return ScreenEdge(x, y, dx, dy, -dy / length, dx / length, a, b, start, end, wa, wb)


@compiled_as_written
def _visible_segments(
    scene: ProjectedScene, bins: Bins, candidates: Any, segment_edge: Any, segment_pixel: Any, interval: Any
) -> tuple[Any, Any, Any, Any, Any]:
    """Return the edge, span, pixel, triangles and occluder of :class:`VisibleSegments`."""
    total = len(segment_pixel)
    edges, span, pixels = np.empty(2 * total, np.int32), np.empty((2 * total, 2)), np.empty(2 * total, np.int32)
    pairs, occluders = np.empty((2 * total, 2), np.int32), np.full((2 * total, 2), -1, np.int32)
    welded_faces = scene.topology.welded_faces
    count = 0
    for k in range(total):
        index, pixel = candidates[segment_edge[k]], segment_pixel[k]
        if k == 0 or segment_edge[k] != segment_edge[k - 1]:
            edge = _screen_edge(scene, index)
        bin_index = bins.bin_of_pixel[pixel]
        middle = _query_position(edge, pixel, scene.viewport.width, interval[k, 0], interval[k, 1])
        is_visible, left, right = _query(bins, bin_index, welded_faces, edge, middle)
        for j in range(2):
            limit = interval[k, j]
            inside = limit + 1e-4 * (middle - limit)
            at_limit, limit_left, limit_right = _query(bins, bin_index, welded_faces, edge, inside)
            if at_limit == is_visible:
                if is_visible:
                    span[count, j] = _to_world(edge, limit)
                continue
            visible, hidden = (middle, limit) if is_visible else (limit, middle)
            border, occluder = _bisect_visibility(bins, bin_index, welded_faces, edge, visible, hidden)
            occluded_end = j if is_visible else 1 - j
            span[count, occluded_end], occluders[count, occluded_end] = _to_world(edge, border), occluder
            if not is_visible:
                span[count, j] = _to_world(edge, limit)
                pairs[count, 0], pairs[count, 1] = limit_left, limit_right
                edges[count], pixels[count] = index, pixel
                count += 1
        if is_visible:
            pairs[count, 0], pairs[count, 1] = left, right
            edges[count], pixels[count] = index, pixel
            count += 1
    return edges[:count], span[:count], pixels[:count], pairs[:count], occluders[:count]


@compiled_as_written
def _find_visible(scene: ProjectedScene) -> Any:
    topology, view = scene.topology, scene.viewport
    triangles = set_up_triangles(scene)
    centre_triangle = depth_buffer(triangles, view.height, view.width)
    candidates = discontinuity_edges(triangles, topology.adjacent_faces, topology.discontinuous)
    segment_edge, segment_pixel, interval = walk_edges(scene.corners, topology.edges[candidates], view)
    intersecting = np.zeros(view.height * view.width, np.bool_)
    if topology.has_several_components:
        intersecting = pixels_between_components(centre_triangle, topology.component, view.height, view.width)
    selected = intersecting.copy()
    for pixel in segment_pixel:
        selected[pixel] = True
    bins = bin_triangles(triangles, selected, view.height, view.width)
    segments = _visible_segments(scene, bins, candidates, segment_edge, segment_pixel, interval)
    intersections = intersection_segments(bins, topology.component, intersecting, view.width)
    return centre_triangle, segments, intersections, bins


@compiled_as_written
def _triangles_beside(corners: Any, edges: Any, bins: Bins, edge: Any, pixel: Any, position: Any) -> Any:
    pairs = np.full((len(edge), 2), -1, np.int32)
    for k in range(len(edge)):
        bin_index = bins.bin_of_pixel[pixel[k]]
        a, b = corners[edges[edge[k], 0]], corners[edges[edge[k], 1]]
        w = a[2] + position[k] * (b[2] - a[2])
        x, y = (a[0] + position[k] * (b[0] - a[0])) / w, (a[1] + position[k] * (b[1] - a[1])) / w
        # The edge's direction on the screen, whatever the sign of w at its ends.
        dx, dy = b[0] * a[2] - a[0] * b[2], b[1] * a[2] - a[1] * b[2]
        length = math.hypot(dx, dy)
        if bin_index < 0 or not length > 0.0:
            continue
        offset_x, offset_y = -QUERY_OFFSET_PX * dy / length, QUERY_OFFSET_PX * dx / length
        pairs[k, 0] = nearest_triangle(bins, bin_index, x + offset_x, y + offset_y)
        pairs[k, 1] = nearest_triangle(bins, bin_index, x - offset_x, y - offset_y)
    return pairs


def find_visible(scene: ProjectedScene) -> VisibleSegments:
    """Return the visible triangles and edge segments of a projected scene."""
    centre_triangle, segments, intersections, bins = _find_visible(scene)

    def query(edge: IndexArray, pixel: IndexArray, position: FloatArray) -> IndexArray:
        pairs: IndexArray = _triangles_beside(scene.corners, scene.topology.edges, bins, edge, pixel, position)
        return pairs

    columns: list[Any] = [centre_triangle, *segments, *intersections, query]
    return VisibleSegments(*columns)

"""Visible edge segments: visibility queries on both sides of edges, and bisection of their changes."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.coverage import END_MARGIN
from loi_torch.mesh.topology import FloatArray, IndexArray
from loi_torch.mesh.visibility.bins import Bins, bin_triangles, nearest_triangle
from loi_torch.mesh.visibility.edge_functions import (
    Triangles,
    depth_at,
    depth_buffer,
    has_edge_at,
    set_up_triangles,
)
from loi_torch.mesh.visibility.edge_walk import clip_edge, discontinuity_edges, walk_edges
from loi_torch.mesh.visibility.intersections import intersection_segments, pixels_between_components
from loi_torch.mesh.visibility.tolerances import MAX_RELATIVE_CONTACT_DEPTH, N_BISECTIONS, QUERY_OFFSET_PX
from loi_torch.mesh.visibility.types import ProjectedScene, VisibleSegments

__all__ = ["find_visible"]


class ScreenEdge(NamedTuple):
    """An edge in pixels, clipped to the near plane."""

    x: float
    y: float
    dx: float  # to the end
    dy: float
    nx: float  # unit normal
    ny: float
    a: Any  # int32: welded vertices
    b: Any
    start: float  # positions on the whole edge, 0 to 1 in world space
    end: float
    wa: float
    wb: float


class EdgeGeometry(NamedTuple):
    """Edges in space, as in :class:`loi_torch.mesh.visibility.types.ProjectedScene`."""

    corners: Any
    edges: Any
    welded_faces: Any
    welded_edges: Any
    height: int
    width: int
    min_w: float


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
def _query(
    triangles: Triangles, bins: Bins, bin_index: int, welded_faces: Any, edge: ScreenEdge, s: float
) -> tuple[bool, int, int]:
    """Return whether an edge is visible at `s`, and the triangles on its left and right there.

    It is visible if it belongs to the triangle in front. Where the two triangles touch, as a box touches the floor, it
    may belong to either; but if both end there with an edge of their own, only one of these edges is counted.
    """
    x, y = edge.x + s * edge.dx, edge.y + s * edge.dy
    offset_x, offset_y = QUERY_OFFSET_PX * edge.nx, QUERY_OFFSET_PX * edge.ny
    left = nearest_triangle(triangles, bins, bin_index, x + offset_x, y + offset_y)
    right = nearest_triangle(triangles, bins, bin_index, x - offset_x, y - offset_y)
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
    triangles: Triangles,
    bins: Bins,
    bin_index: int,
    welded_faces: Any,
    edge: ScreenEdge,
    visible: float,
    hidden: float,
) -> tuple[float, int]:
    """Return where between a visible and a hidden position an edge disappears, and the triangle that occludes it."""
    for _ in range(N_BISECTIONS):
        middle = 0.5 * (visible + hidden)
        if _query(triangles, bins, bin_index, welded_faces, edge, middle)[0]:
            visible = middle
        else:
            hidden = middle
    _, left, right = _query(triangles, bins, bin_index, welded_faces, edge, hidden)
    occluder = _front_triangle(triangles, left, right, edge.x + hidden * edge.dx, edge.y + hidden * edge.dy)
    return 0.5 * (visible + hidden), occluder


@compiled_as_written
def _query_position(edge: ScreenEdge, pixel: int, width: int, low: float, high: float) -> float:
    """Return the position on a segment at which it is queried: see :func:`loi_torch.mesh.coverage.nearest_point`."""
    x, y = pixel % width + 0.5 - edge.x, pixel // width + 0.5 - edge.y
    nearest = (x * edge.dx + y * edge.dy) / (edge.dx * edge.dx + edge.dy * edge.dy)
    margin = END_MARGIN * (high - low)
    return min(max(nearest, low + margin), high - margin)


@compiled_as_written
def _to_world(edge: ScreenEdge, s: float) -> float:
    """Convert a position on the edge on the screen to one on the whole edge in world space."""
    return edge.start + (edge.end - edge.start) * (s * edge.wa / (edge.wb - s * (edge.wb - edge.wa)))


@compiled_as_written
def _screen_edge(scene: EdgeGeometry, index: int) -> ScreenEdge:
    a, b = scene.edges[index, 0], scene.edges[index, 1]
    _, xa, ya, xb, yb, start, end, _, _ = clip_edge(
        scene.corners[a], scene.corners[b], scene.min_w, scene.height, scene.width
    )
    length = math.hypot(xb - xa, yb - ya)
    w, w_change = scene.corners[a, 2], scene.corners[b, 2] - scene.corners[a, 2]
    return ScreenEdge(
        xa,
        ya,
        xb - xa,
        yb - ya,
        -(yb - ya) / length,
        (xb - xa) / length,
        scene.welded_edges[index, 0],
        scene.welded_edges[index, 1],
        start,
        end,
        w + start * w_change,
        w + end * w_change,
    )


@compiled_as_written
def _visible_segments(
    scene: EdgeGeometry,
    triangles: Triangles,
    bins: Bins,
    candidates: Any,
    segment_edge: Any,
    segment_pixel: Any,
    interval: Any,
) -> tuple[Any, Any, Any, Any, Any]:
    """Return the edge, span, pixel, triangles and occluder of :class:`VisibleSegments`."""
    total = len(segment_pixel)
    edges, span, pixels = np.empty(2 * total, np.int32), np.empty((2 * total, 2)), np.empty(2 * total, np.int32)
    pairs, occluders = np.empty((2 * total, 2), np.int32), np.full((2 * total, 2), -1, np.int32)
    welded_faces, bin_of_pixel = scene.welded_faces, bins.bin_of_pixel
    count = 0
    for k in range(total):
        index, pixel = candidates[segment_edge[k]], segment_pixel[k]
        if k == 0 or segment_edge[k] != segment_edge[k - 1]:
            edge = _screen_edge(scene, index)
        bin_index = bin_of_pixel[pixel]
        middle = _query_position(edge, pixel, scene.width, interval[k, 0], interval[k, 1])
        is_visible, left, right = _query(triangles, bins, bin_index, welded_faces, edge, middle)
        for j in range(2):
            limit = interval[k, j]
            at_limit, limit_left, limit_right = _query(
                triangles, bins, bin_index, welded_faces, edge, limit + 1e-4 * (middle - limit)
            )
            if at_limit == is_visible:
                if is_visible:
                    span[count, j] = _to_world(edge, limit)
                continue
            visible, hidden = (middle, limit) if is_visible else (limit, middle)
            border, occluder = _bisect_visibility(triangles, bins, bin_index, welded_faces, edge, visible, hidden)
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
def _find_visible(
    corners: Any,
    depth: Any,
    faces: Any,
    welded_faces: Any,
    component: Any,
    edges: Any,
    welded_edges: Any,
    adjacent_faces: Any,
    discontinuous: Any,
    height: int,
    width: int,
    min_w: float,
    max_depth: float,
    has_several_components: bool,
) -> Any:
    triangles = set_up_triangles(corners, depth, faces, height, width, min_w, max_depth)
    centre_triangle = depth_buffer(triangles, height, width)
    candidates = discontinuity_edges(triangles, adjacent_faces, discontinuous)
    segment_edge, segment_pixel, interval = walk_edges(corners, edges[candidates], height, width, min_w)
    if has_several_components:
        intersecting = pixels_between_components(centre_triangle, component, height, width)
    else:
        intersecting = np.zeros(height * width, np.bool_)
    selected = intersecting.copy()
    for pixel in segment_pixel:
        selected[pixel] = True
    bins = bin_triangles(triangles, selected, height, width)
    scene = EdgeGeometry(corners, edges, welded_faces, welded_edges, height, width, min_w)
    edge, span, pixels, pairs, occluder = _visible_segments(
        scene, triangles, bins, candidates, segment_edge, segment_pixel, interval
    )
    intersection_pixel, intersection_pair, intersection_points, count = intersection_segments(
        triangles, bins, component, intersecting, width
    )
    return (
        centre_triangle,
        edge,
        span,
        pixels,
        pairs,
        occluder,
        intersection_pixel[:count],
        intersection_pair[:count],
        intersection_points[:count],
        triangles,
        bins,
    )


@compiled_as_written
def _triangles_beside(
    corners: Any, edges: Any, triangles: Triangles, bins: Bins, edge: Any, pixel: Any, position: Any
) -> Any:
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
        pairs[k, 0] = nearest_triangle(triangles, bins, bin_index, x + offset_x, y + offset_y)
        pairs[k, 1] = nearest_triangle(triangles, bins, bin_index, x - offset_x, y - offset_y)
    return pairs


def find_visible(scene: ProjectedScene) -> VisibleSegments:
    """Return the visible triangles and edge segments of a projected scene."""
    topology, viewport = scene.topology, scene.viewport
    result = _find_visible(
        scene.corners,
        scene.depth,
        topology.faces,
        topology.welded_faces,
        topology.component,
        topology.edges,
        topology.welded_edges,
        topology.adjacent_faces,
        topology.discontinuous,
        viewport.height,
        viewport.width,
        viewport.min_w,
        viewport.max_depth,
        topology.has_several_components,
    )
    triangles, bins = result[-2:]

    def query(edge: IndexArray, pixel: IndexArray, position: FloatArray) -> IndexArray:
        pairs: IndexArray = _triangles_beside(scene.corners, topology.edges, triangles, bins, edge, pixel, position)
        return pairs

    columns: list[Any] = [*result[:-2], query]
    return VisibleSegments(*columns)

"""End points of visible edge segments: pixel borders, vertices, occluding edges (T-junctions) and intersections.

The kind of an end point decides how it moves. A segment that leaves its pixel slides along the pixel's border; one that
disappears behind an outline ends at the crossing of the two, however both move. With that, image and gradient agree
where outlines meet. The occluding edge is split at the crossing, because the surface behind it changes there.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
import torch

from loi_torch.mesh.coverage import nearest_fraction
from loi_torch.mesh.topology import FloatArray, IndexArray
from loi_torch.mesh.visibility.types import ProjectedScene, VisibleSegments

__all__ = ["EdgeSegments", "EndpointKind", "classify_endpoints", "intersection_endpoints"]

MAX_SNAP_PX: Final = 1e-3  # distance from the queried end of a segment to the edge or surface that hides it
SAME_POINT_PX: Final = 1e-6
PIXEL_CORNER_PX: Final = 1e-9  # distance from both borders below which a point is a corner of its pixel


class EndpointKind(IntEnum):
    """The geometry that ends a segment."""

    VERTEX = 0  # of the edge itself
    VERTICAL_BORDER = 1  # of the pixel, x constant
    HORIZONTAL_BORDER = 2  # of the pixel, y constant
    EDGE = 3  # between two vertices
    INTERSECTION = 4  # line of equal depth of two triangles


class EdgeSegments(NamedTuple):
    """Visible edge segments, see :class:`loi_torch.mesh.visibility.types.VisibleSegments`, with classified end points.

    For the start and the end, `endpoints` has the :class:`EndpointKind`, and the two vertices of the edge or the two
    triangles of the intersection.
    """

    edge: IndexArray
    span: FloatArray
    pixel: IndexArray
    triangles: IndexArray
    endpoints: IndexArray  # (f, 2, 3)


def classify_endpoints(scene: ProjectedScene, visible: VisibleSegments) -> EdgeSegments:
    """Classify the end points of visible segments, and split the segments that occlude others."""
    topology = scene.topology
    span, endpoints = visible.span.copy(), np.zeros((len(visible.edge), 2, 3), np.int32)
    start, end = (scene.corners[topology.edges[visible.edge, k]] for k in (0, 1))
    for k in (0, 1):
        endpoints[:, k, 0] = _border_kind(start, end, span[:, k])
    segments = EdgeSegments(visible.edge, span, visible.pixel, visible.triangles, endpoints)
    segment, which_end = np.nonzero(visible.occluder >= 0)
    if not len(segment):
        return segments
    occluder = visible.occluder[segment, which_end]
    a, b = start[segment], end[segment]
    edges = topology.edges[segments.edge[segment]]
    t = [_meeting_position(a, b, _line_through(scene, topology.faces[occluder], k)[0]) for k in range(3)]
    left = topology.welded_faces[visible.triangles[segment, 0].clip(0)]
    is_on_left = _have_edges(left, topology.welded_edges[visible.edge[segment]])
    owner = visible.triangles[segment, np.where(is_on_left, 0, 1)]
    plane = _depth_planes(scene, occluder)
    rise = scene.depth[edges[:, 1]] - scene.depth[edges[:, 0]]
    with np.errstate(divide="ignore", invalid="ignore"):
        entry = (scene.depth[edges[:, 0]] - np.sum(plane * a, axis=1)) / (np.sum(plane * (b - a), axis=1) - rise)
    # Close to a vertex another triangle of the same mesh may be in front; the segment then ends at the vertex.
    t += [entry, np.zeros_like(entry), np.ones_like(entry)]
    distance = np.stack([_distance_px(a, b, position, span[segment, which_end]) for position in t], axis=1)
    distance[:, 4:] -= SAME_POINT_PX  # prefer a vertex to the edges that meet there
    best = np.argmin(distance, axis=1)
    rows = np.arange(len(segment))
    is_found = distance[rows, best] < MAX_SNAP_PX
    kinds = [EndpointKind.EDGE] * 3 + [EndpointKind.INTERSECTION, EndpointKind.VERTEX, EndpointKind.VERTEX]
    endpoint_kind = np.where(is_found, np.array(kinds)[best], EndpointKind.VERTEX)
    corner = np.minimum(best, 2)
    first = np.where(best < 3, topology.faces[occluder, (corner + 1) % 3], owner)
    second = np.where(best < 3, topology.faces[occluder, (corner + 2) % 3], occluder)
    span[segment[is_found], which_end[is_found]] = np.stack(t, axis=1)[rows, best][is_found]
    endpoints[segment, which_end] = np.stack([endpoint_kind, first, second], axis=1)
    at_edge = is_found & (best < 3)
    welded = [topology.welded_faces[occluder, (corner + k) % 3] for k in (1, 2)]
    occluding_edges = np.sort(np.stack(welded, axis=1), axis=1)
    segments = _split_occluders(scene, segments, segment[at_edge], occluding_edges[at_edge])
    # Segments that have become shorter are queried at another point.
    rows = np.flatnonzero(np.any(segments.endpoints[:, :, 0] > EndpointKind.HORIZONTAL_BORDER, axis=1))
    pairs = visible.query(segments.edge[rows], segments.pixel[rows], _query_positions(scene, segments, rows))
    is_edge = pairs[:, 0] != pairs[:, 1]
    triangles = segments.triangles.copy()
    triangles[rows[is_edge]] = pairs[is_edge]
    return segments._replace(triangles=triangles)


def intersection_endpoints(scene: ProjectedScene, visible: VisibleSegments) -> IndexArray:
    """Return the end points of intersection segments, shape (g, 2, 3), as in :class:`EdgeSegments`."""
    count = len(visible.intersection_pixel)
    endpoints = np.zeros((count, 2, 3), np.int32)
    none = np.zeros(count, np.int32)
    for k in (0, 1):
        point = visible.intersection_points[:, 2 * k : 2 * k + 2]
        to_border = np.abs(point - np.rint(point))
        distances: list[Any] = [to_border[:, 0], to_border[:, 1]]
        candidates = [(EndpointKind.VERTICAL_BORDER, none, none), (EndpointKind.HORIZONTAL_BORDER, none, none)]
        for triangle in visible.intersection_triangles.T:
            for corner in range(3):
                line, a, b = _line_through(scene, scene.topology.faces[triangle], corner)
                with np.errstate(divide="ignore", invalid="ignore"):
                    value = (np.sum(line[:, :2] * point, axis=1) + line[:, 2]) / np.hypot(line[:, 0], line[:, 1])
                distances.append(np.abs(value))
                candidates.append((EndpointKind.EDGE, a, b))
        best = np.argmin(np.nan_to_num(np.stack(distances, axis=1), nan=np.inf), axis=1)
        for number, (endpoint_kind, first, second) in enumerate(candidates):
            is_best = best == number
            endpoints[is_best, k] = np.stack([np.full(count, endpoint_kind), first, second], axis=1)[is_best]
    return endpoints


def _query_positions(scene: ProjectedScene, segments: EdgeSegments, rows: Any) -> FloatArray:
    """Return the edge positions, 0 to 1 in world space, of :func:`loi_torch.mesh.coverage.nearest_point`."""
    a, b = (scene.corners[scene.topology.edges[segments.edge[rows], k]] for k in (0, 1))
    first, last = segments.span[rows].T
    start, end = (a + position[:, None] * (b - a) for position in (first, last))
    width = scene.viewport.width
    centre = np.stack([segments.pixel[rows] % width + 0.5, segments.pixel[rows] // width + 0.5], axis=1)
    on_screen = (start[:, :2] / start[:, 2:], end[:, :2] / end[:, 2:], centre)
    fraction = nearest_fraction(*map(torch.from_numpy, on_screen)).numpy()
    in_world = fraction * start[:, 2] / (end[:, 2] - fraction * (end[:, 2] - start[:, 2]))
    positions: FloatArray = first + (last - first) * in_world
    return positions


def _border_kind(start: FloatArray, end: FloatArray, t: FloatArray) -> IndexArray:
    """Return which pixel border, or vertex, the points at `t` of edges lie on."""
    point = start + t[:, None] * (end - start)
    point = point[:, :2] / point[:, 2:]
    to_border = np.abs(point - np.rint(point))
    p, q = start[:, :2] / start[:, 2:], end[:, :2] / end[:, 2:]
    is_steep = np.abs(q[:, 1] - p[:, 1]) > np.abs(q[:, 0] - p[:, 0])
    # A corner of the pixel lies on both borders; choose the one that the edge crosses at the greater angle.
    is_corner = np.max(to_border, axis=1) < PIXEL_CORNER_PX
    is_vertical = np.where(is_corner, ~is_steep, to_border[:, 0] < to_border[:, 1])
    border_kind = np.where(is_vertical, EndpointKind.VERTICAL_BORDER, EndpointKind.HORIZONTAL_BORDER)
    is_inside = np.min(to_border, axis=1) > SAME_POINT_PX  # an end without a known occluder, which is not followed
    return np.where((t <= 0.0) | (t >= 1.0) | is_inside, EndpointKind.VERTEX, border_kind).astype(np.int32)


def _line_through(scene: ProjectedScene, faces: IndexArray, corner: int) -> tuple[FloatArray, IndexArray, IndexArray]:
    """Return the line through the edge of each triangle opposite a corner, and the edge's vertices."""
    a, b = faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
    return _cross(scene.corners[a], scene.corners[b]), a, b


def _meeting_position(a: FloatArray, b: FloatArray, line: FloatArray) -> FloatArray:
    """Return where edges from `a` to `b` meet lines, 0 to 1 on the edge."""
    with np.errstate(divide="ignore", invalid="ignore"):
        position: FloatArray = -np.sum(a * line, axis=1) / np.sum((b - a) * line, axis=1)
    return position


def _distance_px(a: FloatArray, b: FloatArray, t: FloatArray, other_t: FloatArray) -> FloatArray:
    """Return the distance in pixels of two points of edges, infinite if `t` is not on the edge."""
    with np.errstate(all="ignore"):
        p, q = (a + position[:, None] * (b - a) for position in (t, other_t))
        distance = np.linalg.norm(p[:, :2] / p[:, 2:] - q[:, :2] / q[:, 2:], axis=1)
        is_on_edge = (t >= 0.0) & (t <= 1.0)
    return np.where(is_on_edge & np.isfinite(distance), distance, np.inf)


def _depth_planes(scene: ProjectedScene, triangle: IndexArray) -> FloatArray:
    """Return the reversed depth of triangles as a x + b y + c, shape (s, 3)."""
    faces = scene.topology.faces[triangle]
    corners, depth = scene.corners[faces], scene.depth[faces]
    functions = np.stack([_cross(corners[:, (k + 1) % 3], corners[:, (k + 2) % 3]) for k in range(3)], axis=1)
    volume = np.sum(corners[:, 0] * functions[:, 0], axis=1)
    planes: FloatArray = np.sum(functions * depth[..., None], axis=1) / volume[:, None]
    return planes


def _have_edges(welded_faces: IndexArray, welded_edges: IndexArray) -> Any:
    """Return whether triangles have both vertices of edges, row by row."""
    return np.any(welded_faces == welded_edges[:, :1], axis=1) & np.any(welded_faces == welded_edges[:, 1:], axis=1)


def _split_occluders(
    scene: ProjectedScene, segments: EdgeSegments, occluded: Any, occluding_edges: IndexArray
) -> EdgeSegments:
    """Split the segments of the `occluding_edges` where the `occluded` segments disappear behind them."""
    topology = scene.topology
    corners = scene.corners[topology.edges[segments.edge]]
    lines = dict(zip(occluded.tolist(), _cross(*corners[occluded].swapaxes(0, 1)), strict=True))
    cuts = _cut_positions(topology.welded_edges, segments, occluded, occluding_edges, corners, lines)
    if not cuts:
        return segments
    split = np.array(list(cuts))
    left = topology.welded_faces[segments.triangles[split, 0]]
    left_is_front = _have_edges(left, topology.welded_edges[segments.edge[split]])
    is_whole = np.ones(len(segments.edge), bool)
    is_whole[split] = False
    sources, spans, triangles, endpoints = [], [], [], []
    for (source, positions), is_left in zip(cuts.items(), left_is_front, strict=True):
        positions.sort()
        c, d = corners[source]
        limits = [segments.span[source, 0], *(t for t, _ in positions), segments.span[source, 1]]
        crossed = [(EndpointKind.EDGE, *topology.edges[segments.edge[e]]) for _, e in positions]
        kinds = [segments.endpoints[source, 0], *crossed, segments.endpoints[source, 1]]
        for k in range(len(limits) - 1):
            e = positions[min(k, len(positions) - 1)][1]
            on_left = lines[e] @ (c + 0.5 * (limits[k] + limits[k + 1]) * (d - c)) > 0.0
            pair = segments.triangles[source].copy()
            pair[1 if is_left else 0] = segments.triangles[e, 0 if on_left else 1]
            sources.append(source)
            spans.append(limits[k : k + 2])
            triangles.append(pair)
            endpoints.append(kinds[k : k + 2])
    halves = (segments.edge[sources], spans, segments.pixel[sources], triangles, endpoints)
    columns: Any = zip(segments, halves, strict=True)
    return EdgeSegments(*(np.concatenate([column[is_whole], np.array(new, column.dtype)]) for column, new in columns))


def _cut_positions(
    welded_edges: IndexArray,
    segments: EdgeSegments,
    occluded: Any,
    occluding_edges: IndexArray,
    corners: FloatArray,
    lines: dict[int, FloatArray],
) -> dict[int, list[tuple[float, int]]]:
    """Return the positions to split each segment at, and the occluded segment that ends there."""
    ending: dict[tuple[int, int, int], list[int]] = {}
    pixels = segments.pixel[occluded]
    for e, pixel, (a, b) in zip(occluded.tolist(), pixels.tolist(), occluding_edges.tolist(), strict=True):
        ending.setdefault((pixel, a, b), []).append(e)
    candidates = np.flatnonzero(np.isin(segments.pixel, pixels))
    edges = np.sort(welded_edges[segments.edge[candidates]], axis=1)
    cuts: dict[int, list[tuple[float, int]]] = {}
    pixels = segments.pixel[candidates]
    for source, pixel, (a, b) in zip(candidates.tolist(), pixels.tolist(), edges.tolist(), strict=True):
        for e in ending.get((pixel, a, b), ()):
            c, d = corners[source]
            slope = float(lines[e] @ (d - c))
            t = -float(lines[e] @ c) / slope if slope != 0.0 else np.nan
            if segments.span[source, 0] < t < segments.span[source, 1]:
                cuts.setdefault(source, []).append((t, e))
    return cuts


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross products of vectors, shape (n, 3), with less overhead than :func:`numpy.cross`."""
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )

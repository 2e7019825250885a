"""Analytic anti-aliasing: the area and the two sides of every visible edge and intersection segment.

End points move with the geometry that ends their segment, so that the areas of :mod:`loi_torch.mesh.coverage` carry
the gradient of the motion.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from loi_core.support.arrays import to_numpy
from loi_torch.mesh.barycentric import gather_corners
from loi_torch.mesh.coverage import hidden_area, nearest_point
from loi_torch.mesh.rasterize import Frame
from loi_torch.mesh.segment_endpoints import EdgeSegments, EndpointKind, classify_endpoints, intersection_endpoints
from loi_torch.mesh.tensors import unit

__all__ = ["EdgeContributions", "edge_contributions"]

CENTRE_OFFSET_PX: Final = 1e-6  # displacement of a pixel's centre that lies on an edge
MIN_CROSSING_SINE: Final = 1e-6  # of the angle between two lines below which their crossing is not differentiated


class EdgeContributions(NamedTuple):
    """Changes of colour within pixels: each adds its area times the colour on the right less the colour on the left."""

    pixels: Any  # (f,) int
    triangles: tuple[Any, Any]  # (f,) int: on the left and right, -1 for none
    has_centre_colour: tuple[Any, Any]  # (f,) bool: whether a side has the pixel's centre and shows the same surface
    points: Tensor  # (f, 2): positions of the colours of the two sides, in pixels
    areas: Tensor  # (f,): see :func:`loi_torch.mesh.coverage.hidden_area`


def edge_contributions(frame: Frame) -> EdgeContributions:
    """Return the contributions of all visible edge and intersection segments of a frame."""
    visible = frame.visible
    segments = classify_endpoints(frame.scene, visible)
    start, end, orientation = _edge_points(frame, segments)
    if len(visible.intersection_pixel):
        columns = zip((start, end, orientation), _intersection_points(frame), strict=True)
        start, end, orientation = (torch.cat(pair) for pair in columns)
    pixels = np.concatenate([segments.pixel, visible.intersection_pixel])
    left, right = np.concatenate([segments.triangles, visible.intersection_triangles]).T
    centres = frame.pixel_centres(pixels)
    if bool((orientation == 0.0).any()):
        centres, orientation = _move_off_edges(frame, pixels, centres, start.detach(), end.detach(), orientation)
    return EdgeContributions(
        pixels,
        (left, right),
        _have_centre_colour(frame, pixels, left, right, to_numpy(orientation)),
        nearest_point(start, end, centres),
        hidden_area(start - centres, end - centres, orientation),
    )


def _have_centre_colour(frame: Frame, pixels: Any, left: Any, right: Any, orientation: Any) -> tuple[Any, Any]:
    centre = frame.visible.centre_triangle[pixels]
    groups = frame.topology.smoothing_group

    def group(triangle: Any) -> Any:
        return groups[triangle] if len(groups) else triangle

    centre_facing, centre_group = frame.facing(centre), group(centre)

    def is_same_surface(triangle: Any, centre_side: float) -> Any:
        is_same = (group(triangle) == centre_group) & (frame.facing(triangle) == centre_facing)
        return (centre >= 0) & (triangle >= 0) & (orientation == centre_side) & is_same

    return is_same_surface(left, 1.0), is_same_surface(right, -1.0)


def _move_off_edges(
    frame: Frame, pixels: Any, centres: Tensor, start: Tensor, end: Tensor, orientation: Tensor
) -> tuple[Tensor, Tensor]:
    """Move centres that lie on edges a little into their visible triangles, and return the new orientations."""
    on_edge = np.flatnonzero(np.isin(pixels, pixels[to_numpy(orientation) == 0.0]))
    rows = frame.index_tensor(on_edge)
    faces = frame.topology.faces[frame.visible.centre_triangle[pixels[on_edge]]]
    corners = gather_corners(frame.corners.detach(), frame.index_tensor(faces))
    on_screen = corners[..., :2] / corners[..., 2:].clamp(min=frame.scene.viewport.min_w)
    moved = centres[rows] + CENTRE_OFFSET_PX * unit(on_screen.mean(dim=1) - centres[rows])
    a, b = start[rows] - moved, end[rows] - moved
    sign = torch.sign(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return centres.index_copy(0, rows, moved), orientation.index_copy(0, rows, sign)


def _edge_points(frame: Frame, segments: EdgeSegments) -> tuple[Tensor, Tensor, Tensor]:
    """Return the differentiable end points of edge segments, in pixels, and their orientation around the centres."""
    edges = frame.topology.edges[segments.edge]
    a, b = (frame.corners.index_select(0, frame.index_tensor(edges[:, k])) for k in (0, 1))
    span = torch.as_tensor(segments.span)
    normal = _edge_lines(frame, edges)[:, :2].detach()
    points = []
    for k in (0, 1):
        on_edge = a + span[:, k, None] * (b - a)
        points.append(_constrained(frame, on_edge[:, :2] / on_edge[:, 2:], normal, segments.endpoints[:, k]))
    p, q = a.detach(), b.detach()
    x, y = frame.pixel_centres(segments.pixel).unbind(dim=1)
    # The same arithmetic as the edge functions', so that both agree on the side of each centre.
    value = (
        (p[:, 1] * q[:, 2] - p[:, 2] * q[:, 1]) * x
        + (p[:, 2] * q[:, 0] - p[:, 0] * q[:, 2]) * y
        + (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    )
    return points[0], points[1], torch.sign(value)


def _intersection_points(frame: Frame) -> tuple[Tensor, Tensor, Tensor]:
    """Return the same for intersection segments."""
    visible = frame.visible
    endpoints = intersection_endpoints(frame.scene, visible)
    line = _intersection_lines(frame, visible.intersection_triangles)
    normal = line[:, :2].detach()
    points = []
    for k in (0, 1):
        fixed = torch.as_tensor(visible.intersection_points[:, 2 * k : 2 * k + 2])
        moving = fixed + normal * _displacement(line, fixed)[:, None]
        points.append(_constrained(frame, moving, normal, endpoints[:, k]))
    return points[0], points[1], torch.sign(_line_value(line.detach(), frame.pixel_centres(visible.intersection_pixel)))


def _constrained(frame: Frame, point: Tensor, normal: Tensor, endpoint: Any) -> Tensor:
    """Return end points, shape (f, 2), that move with their line and stay on the geometry that ends it.

    `point`, shape (f, 2), moves as the line with `normal`, shape (f, 2), does. `endpoint`, shape (f, 3), is as in
    :class:`loi_torch.mesh.segment_endpoints.EdgeSegments`.
    """
    fixed = point.detach()
    displacement = ((point - fixed) * normal).sum(dim=1)
    kinds = endpoint[:, 0]
    borders = [kinds == EndpointKind.VERTICAL_BORDER, kinds == EndpointKind.HORIZONTAL_BORDER]
    end_normal = torch.as_tensor(np.stack(borders, axis=1).astype(float))
    end_displacement = torch.zeros_like(displacement)
    for line_kind, lines in ((EndpointKind.EDGE, _edge_lines), (EndpointKind.INTERSECTION, _intersection_lines)):
        is_kind = np.flatnonzero(kinds == line_kind)
        if len(is_kind):
            rows, line = frame.index_tensor(is_kind), lines(frame, endpoint[is_kind, 1:])
            end_normal = end_normal.index_copy(0, rows, line[:, :2].detach())
            end_displacement = end_displacement.index_copy(0, rows, _displacement(line, fixed[rows]))
    sine = normal[:, 0] * end_normal[:, 1] - normal[:, 1] * end_normal[:, 0]
    is_free = sine.abs() < MIN_CROSSING_SINE
    sine = torch.where(is_free, torch.ones_like(sine), sine)
    x = (displacement * end_normal[:, 1] - end_displacement * normal[:, 1]) / sine
    y = (normal[:, 0] * end_displacement - end_normal[:, 0] * displacement) / sine
    return torch.where(is_free[:, None], point, fixed + torch.stack([x, y], dim=1))


def _edge_lines(frame: Frame, edges: Any) -> Tensor:
    """Return lines a x + b y + c = 0 through pairs of vertices, shape (f, 3), with unit normals (a, b)."""
    a, b = (frame.corners.index_select(0, frame.index_tensor(edges[:, k])) for k in (0, 1))
    return _normalised(torch.linalg.cross(a, b))


def _intersection_lines(frame: Frame, pairs: Any) -> Tensor:
    """Return the lines of equal depth of pairs of triangles, shape (f, 3), in the same form."""
    return _normalised(_depth_planes(frame, pairs[:, 0]) - _depth_planes(frame, pairs[:, 1]))


def _depth_planes(frame: Frame, triangle: Any) -> Tensor:
    """Return the reversed depth of triangles as a x + b y + c, shape (g, 3)."""
    vertices = frame.index_tensor(frame.topology.faces[triangle])
    corners = gather_corners(frame.corners, vertices)
    opposite = [torch.linalg.cross(corners[:, (k + 1) % 3], corners[:, (k + 2) % 3]) for k in range(3)]
    functions = torch.stack(opposite, dim=1)
    depth = gather_corners(frame.depth[:, None], vertices)
    return (functions * depth).sum(dim=1) / (corners[:, 0] * functions[:, 0]).sum(dim=1, keepdim=True)


def _normalised(line: Tensor) -> Tensor:
    length = torch.linalg.vector_norm(line[:, :2].detach(), dim=1, keepdim=True)
    normalised: Tensor = line / torch.where(length > 0.0, length, torch.ones_like(length))
    return normalised


def _line_value(line: Tensor, points: Tensor) -> Tensor:
    value: Tensor = (line[:, :2] * points).sum(dim=1) + line[:, 2]
    return value


def _displacement(line: Tensor, points: Tensor) -> Tensor:
    """Return the displacement of lines along their normals at fixed points: 0, with the gradient of the line."""
    value = _line_value(line, points)
    return value.detach() - value

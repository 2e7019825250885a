"""Input and output of the visibility pass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from loi_torch.mesh.topology import FloatArray, IndexArray, Topology

__all__ = ["ProjectedScene", "Viewport", "VisibleSegments"]


class Viewport(NamedTuple):
    """Image size in pixels, and the near plane as the smallest `w` and the largest reversed depth."""

    height: int
    width: int
    min_w: float
    max_depth: float


class ProjectedScene(NamedTuple):
    """Triangles in homogeneous pixel coordinates.

    Attributes
    ----------
    topology, viewport
    corners : array, shape (n, 3)
        Vertices (x w, y w, w) with x and y in pixels.
    depth : array, shape (n,)
        Reversed depth, which is larger for nearer surfaces, times `w`.
    """

    topology: Topology
    viewport: Viewport
    corners: FloatArray
    depth: FloatArray


@dataclass(frozen=True)
class VisibleSegments:
    """Visible triangles, edge segments and intersection segments.

    A segment lies within one pixel. Left of an edge along (dx, dy) is the side of (-dy, dx).

    Attributes
    ----------
    centre_triangle : array of int, shape (H * W,)
        Triangle at the centre of each pixel, -1 for none.
    edge, pixel : array of int, shape (f,)
        Edge and pixel of each visible segment of an edge.
    span : array, shape (f, 2)
        Start and end of the segment on its edge, 0 to 1 in world space.
    triangles : array of int, shape (f, 2)
        Triangles on the left and right of the segment, -1 for none.
    occluder : array of int, shape (f, 2)
        Triangle that hides the edge beyond the start and the end, -1 if the edge leaves the pixel or ends there.
    intersection_pixel : array of int, shape (g,)
    intersection_triangles : array of int, shape (g, 2)
        Triangles on the left and right of each visible segment of an intersection.
    intersection_points : array, shape (g, 4)
        Start and end (x, y, x, y) in pixels.
    query : callable
        Visibility query. Takes edges and pixels, shape (k,), and positions on the edges, 0 to 1 in world space; returns
        the triangles on the left and right there, shape (k, 2).
    """

    centre_triangle: IndexArray
    edge: IndexArray
    span: FloatArray
    pixel: IndexArray
    triangles: IndexArray
    occluder: IndexArray
    intersection_pixel: IndexArray
    intersection_triangles: IndexArray
    intersection_points: FloatArray
    query: Callable[[IndexArray, IndexArray, FloatArray], IndexArray]

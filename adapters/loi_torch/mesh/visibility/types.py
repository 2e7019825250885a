"""Input and output of the visibility pass."""

from __future__ import annotations

from collections.abc import Callable
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
    """Triangles in homogeneous pixel coordinates."""

    topology: Topology
    viewport: Viewport
    corners: FloatArray  # (n, 3): vertices (x w, y w, w) with x and y in pixels
    depth: FloatArray  # (n,): reversed depth, which is larger for nearer surfaces, times w


class VisibleSegments(NamedTuple):
    """Visible triangles, edge segments and intersection segments, without gradients.

    A segment lies within one pixel. Left of an edge along (dx, dy) is the side of (-dy, dx). Positions on an edge are 0
    to 1 in world space. No triangle is -1. `query` takes edges, pixels and positions, shape (k,), and returns the
    triangles on the left and right of the edges there, shape (k, 2).
    """

    centre_triangle: IndexArray  # (H * W,): at the centre of each pixel
    edge: IndexArray  # (f,)
    span: FloatArray  # (f, 2): positions of the start and the end of each segment on its edge
    pixel: IndexArray  # (f,)
    triangles: IndexArray  # (f, 2): on the left and right
    occluder: IndexArray  # (f, 2): triangle that hides the edge beyond the start and the end; -1 if none does
    intersection_pixel: IndexArray  # (g,)
    intersection_triangles: IndexArray  # (g, 2): on the left and right
    intersection_points: FloatArray  # (g, 4): start and end (x, y, x, y) in pixels
    query: Callable[[IndexArray, IndexArray, FloatArray], IndexArray]

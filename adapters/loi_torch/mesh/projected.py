"""Triangles on the screen and what is seen of them: what the two ways of looking take and give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from loi_core.renderers.checks import FloatArray

__all__ = ["FloatArray", "IndexArray", "Projected", "Seen", "Topology", "View"]

IndexArray: TypeAlias = np.ndarray[Any, np.dtype[np.int32]]


@dataclass(frozen=True)
class Topology:
    """Which corners make triangles, and which triangles meet at an edge.

    Attributes
    ----------
    faces : array of int, shape (m, 3)
        Corners of each triangle.
    joined : array of int, shape (m, 3)
        The same with corners in one place under one number, so that triangles along a seam are neighbours.
    piece : array of int, shape (m,)
        The connected part that each triangle is of; only different ones are expected to cut into each other.
    sheet : array of int, shape (m,)
        The smooth part that each triangle is of: it ends where colours may jump.
    ends, joined_ends : array of int, shape (e, 2)
        The corners that each edge joins, in the two numberings.
    between : array of int, shape (e, 2)
        Triangles that meet at each edge: the first two, -1 where there is no second.
    always : array of bool, shape (e,)
        Edges at which colours may jump however the triangles face: rims, creases, and where three or more meet.
    several : bool
        Whether there are several pieces, which may cut into each other.
    twisted : int
        At how many edges two triangles, and no third, run the same way, so that one of them shows its back.
    """

    faces: IndexArray
    joined: IndexArray
    piece: IndexArray
    sheet: IndexArray
    ends: IndexArray
    joined_ends: IndexArray
    between: IndexArray
    always: np.ndarray[Any, np.dtype[np.bool_]]
    several: bool
    twisted: int


@dataclass(frozen=True)
class View:
    """The image's size, and where the near plane is: the least `w`, and the most nearness, of what is drawn."""

    height: int
    width: int
    near: float
    most: float


@dataclass(frozen=True)
class Projected:
    """A scene on the screen.

    Attributes
    ----------
    topology, view
    corners : array, shape (n, 3)
        Homogeneous: (x w, y w, w) with x and y in pixels.
    depth : array, shape (n,)
        Nearness times `w`: what is interpolated to tell which triangle is nearer.
    """

    topology: Topology
    view: View
    corners: FloatArray
    depth: FloatArray


@dataclass(frozen=True)
class Seen:
    """What is visible.

    Attributes
    ----------
    found : array of int, shape (H * W,)
        The triangle at the centre of each pixel, -1 for none.
    edge, span, pixel, sides : arrays, shapes (f,), (f, 2), (f,), (f, 2)
        Parts of edges that show, each within one pixel: the number of the edge; where on it the part begins and ends,
        0 to 1 in space; and the triangles on its left and right, -1 for none. Left is where (-dy, dx) points for an
        edge along (dx, dy).
    beyond : array of int, shape (f, 2)
        The triangle that hides the edge beyond each end of a part, -1 where the edge leaves the pixel or ends itself.
    crossing_pixel, crossing_sides, crossing_ends : arrays, shapes (g,), (g, 2), (g, 4)
        Parts of lines along which two triangles cut into each other: the ends are x, y, x, y in pixels.
    beside : callable
        From numbers of edges and pixels, and points on these edges, 0 to 1 in space, to the triangles on their left and
        right there, shape (k, 2).
    """

    found: IndexArray
    edge: IndexArray
    span: FloatArray
    pixel: IndexArray
    sides: IndexArray
    beyond: IndexArray
    crossing_pixel: IndexArray
    crossing_sides: IndexArray
    crossing_ends: FloatArray
    beside: Callable[[IndexArray, IndexArray, FloatArray], IndexArray]

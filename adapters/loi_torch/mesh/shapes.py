"""Box, sphere and quad."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from loi_core.errors import ParameterError
from loi_core.renderers.validation import check_floats
from loi_core.support.values import whole_number
from loi_core.support.wording import shown
from loi_torch.mesh.meshes import Mesh

__all__ = ["box", "quad", "sphere"]

MAX_SUBDIVISIONS: Final = 8  # 1,310,720 triangles


def box(size: Any = (1.0, 1.0, 1.0), centre: Any = (0.0, 0.0, 0.0), **options: Any) -> Mesh:
    """Make a box with flat sides.

    Parameters
    ----------
    size, centre : array, shape (3,)
        In world units.
    **options
        Of :class:`Mesh`. The box has twelve triangles, two for each of the sides -x, +x, -y, +y, -z, +z in this order.

    Returns
    -------
    Mesh
    """
    half, middle = 0.5 * check_floats("size", size, (3,)), check_floats("centre", centre, (3,))
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return Mesh(corners * half + middle, faces, **{"smooth": False, **options})


def sphere(radius: float = 1.0, centre: Any = (0.0, 0.0, 0.0), subdivisions: int = 4, **options: Any) -> Mesh:
    """Make a sphere of ``20 * 4**subdivisions`` triangles by subdividing an icosahedron.

    Parameters
    ----------
    radius : float
        In world units.
    centre : array, shape (3,)
    subdivisions : int
        Number of times that each triangle is divided into four, 0 to 8.
    **options
        Of :class:`Mesh`.

    Returns
    -------
    Mesh

    Raises
    ------
    ParameterError
        If `subdivisions` is out of range.
    """
    depth = whole_number(subdivisions)
    if depth is None or not 0 <= depth <= MAX_SUBDIVISIONS:
        msg = f"`subdivisions` must be a whole number from 0 to {MAX_SUBDIVISIONS}, got {shown(subdivisions)}"
        raise ParameterError(msg)
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = np.array([(a, b * golden, 0.0) for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    vertices = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
    vertices /= np.linalg.norm(vertices[0])
    # Adjacent vertices of the icosahedron are at distance 1.05; any three mutually adjacent ones form a face.
    is_adjacent = np.linalg.norm(vertices[:, None] - vertices[None], axis=-1) < 1.2
    triples = [
        (a, b, c)
        for a in range(12)
        for b in range(a)
        for c in range(b)
        if is_adjacent[a, b] and is_adjacent[b, c] and is_adjacent[a, c]
    ]
    faces = np.array([t if np.linalg.det(vertices[list(t)]) > 0.0 else t[::-1] for t in triples])
    for _ in range(depth):
        half_edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
        edges, edge_index = np.unique(half_edges, axis=0, return_inverse=True)
        midpoints = vertices[edges].sum(axis=1)
        ab, bc, ca = (edge_index.reshape(-1, 3) + len(vertices)).T
        a, b, c = faces.T
        faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
        vertices = np.concatenate([vertices, midpoints / np.linalg.norm(midpoints, axis=1, keepdims=True)])
    return Mesh(radius * vertices + check_floats("centre", centre, (3,)), faces, **options)


def quad(first: Any, second: Any, third: Any, fourth: Any, **options: Any) -> Mesh:
    """Make a quadrilateral of two triangles between four corners.

    Parameters
    ----------
    first, second, third, fourth : array, shape (3,)
        Counterclockwise as seen from the front: the bottom left, bottom right, top right and top left of a texture.
    **options
        Of :class:`Mesh`. With `texture`, the default `uv` covers the quadrilateral once.

    Returns
    -------
    Mesh
    """
    corners = np.stack([check_floats("corner", corner, (3,)) for corner in (first, second, third, fourth)])
    if "texture" in options:
        options = {"uv": np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), **options}
    return Mesh(corners, [[0, 1, 2], [0, 2, 3]], **options)

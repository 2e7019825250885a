"""Simple meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

from loi_core.errors import ParameterError
from loi_core.renderers.checks import floats
from loi_core.support.values import whole_number
from loi_core.support.wording import shown
from loi_torch.mesh.meshes import Mesh

__all__ = ["box", "quad", "sphere"]


def box(size: Any = (1.0, 1.0, 1.0), centre: Any = (0.0, 0.0, 0.0), **options: Any) -> Mesh:
    """A box with flat sides.

    Parameters
    ----------
    size, centre : array, shape (3,)
        Lengths of its sides and its middle, in world units.
    **options
        Of :class:`Mesh`. Twelve triangles, two of each side in turn: -x, +x, -y, +y, -z, +z.
    """
    half, middle = 0.5 * floats("size", size, (3,)), floats("centre", centre, (3,))
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return Mesh(corners * half + middle, faces, **{"smooth": False, **options})


def sphere(radius: float = 1.0, centre: Any = (0.0, 0.0, 0.0), subdivisions: int = 4, **options: Any) -> Mesh:
    """A sphere of ``20 * 4**subdivisions`` triangles, from an icosahedron.

    Parameters
    ----------
    radius : float
    centre : array, shape (3,)
    subdivisions : int
        How often each triangle is cut into four, 0 to 8.
    **options
        Of :class:`Mesh`.
    """
    depth = whole_number(subdivisions)
    if depth is None or not 0 <= depth <= 8:
        msg = f"`subdivisions` must be a whole number from 0 to 8, got {shown(subdivisions)}"
        raise ParameterError(msg)
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = np.array([(a, b * golden, 0.0) for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    vertices = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
    vertices /= np.linalg.norm(vertices[0])
    # Neighbours of an icosahedron's corners are an edge apart, and each three of them make a triangle.
    near = np.linalg.norm(vertices[:, None] - vertices[None], axis=-1) < 1.2
    triples = [
        (a, b, c) for a in range(12) for b in range(a) for c in range(b) if near[a, b] and near[b, c] and near[a, c]
    ]
    faces = np.array([t if np.linalg.det(vertices[list(t)]) > 0.0 else t[::-1] for t in triples])
    for _ in range(depth):
        ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
        edges, number = np.unique(ends, axis=0, return_inverse=True)
        middles = vertices[edges].sum(axis=1)
        ab, bc, ca = (number.reshape(-1, 3) + len(vertices)).T
        a, b, c = faces.T
        faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
        vertices = np.concatenate([vertices, middles / np.linalg.norm(middles, axis=1, keepdims=True)])
    return Mesh(radius * vertices + floats("centre", centre, (3,)), faces, **options)


def quad(first: Any, second: Any, third: Any, fourth: Any, **options: Any) -> Mesh:
    """Two triangles between four corners, counterclockwise; with texture coordinates from the first corner.

    Parameters
    ----------
    first, second, third, fourth : array, shape (3,)
        Bottom left, bottom right, top right and top left of a texture.
    **options
        Of :class:`Mesh`.
    """
    corners = np.stack([floats("corner", one, (3,)) for one in (first, second, third, fourth)])
    if "texture" in options:
        options = {"uv": np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), **options}
    return Mesh(corners, [[0, 1, 2], [0, 2, 3]], **options)

"""The Utah teapot (Martin Newell 1975), from its cubic Bezier patches."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from loi_torch.mesh import Mesh

__all__ = ["teapot"]

# Radius and height along the profiles of the surfaces of revolution: four control points for each curve.
PROFILES: Final = (
    ((1.4, 2.4), (1.3375, 2.53125), (1.4375, 2.53125), (1.5, 2.4)),  # the rim
    ((1.5, 2.4), (1.75, 1.875), (2.0, 1.35), (2.0, 0.9)),  # the body
    ((2.0, 0.9), (2.0, 0.45), (1.5, 0.225), (1.5, 0.15)),
    ((0.0, 3.15), (0.8, 3.15), (0.0, 2.85), (0.2, 2.7)),  # the lid
    ((0.2, 2.7), (0.4, 2.55), (1.3, 2.55), (1.3, 2.4)),
    ((1.5, 0.15), (1.5, 0.075), (1.425, 0.0), (0.0, 0.0)),  # the bottom
)
# Handle and spout: x and height of their inner and outer curves in the plane of symmetry, then the half widths.
TUBES: Final = (
    (
        ((-1.6, 2.025), (-2.3, 2.025), (-2.7, 2.025), (-2.7, 1.8)),
        ((-1.5, 2.25), (-2.5, 2.25), (-3.0, 2.25), (-3.0, 1.8)),
        (0.3,) * 4,
    ),
    (
        ((-2.7, 1.8), (-2.7, 1.575), (-2.5, 1.125), (-2.0, 0.9)),
        ((-3.0, 1.8), (-3.0, 1.35), (-2.65, 0.9375), (-1.9, 0.6)),
        (0.3,) * 4,
    ),
    (
        ((1.7, 1.425), (2.6, 1.425), (2.3, 2.1), (2.7, 2.4)),
        ((1.7, 0.6), (3.1, 0.825), (2.4, 2.025), (3.3, 2.4)),
        (0.66, 0.66, 0.25, 0.25),
    ),
    (
        ((2.7, 2.4), (2.8, 2.475), (2.9, 2.475), (2.8, 2.4)),
        ((3.3, 2.4), (3.525, 2.49375), (3.45, 2.5125), (3.2, 2.4)),
        (0.25, 0.25, 0.15, 0.15),
    ),
)
# Distance of the inner control points of a quarter circle from its ends, as a fraction of the radius.
ARC_HANDLE: Final = 0.56


def teapot(radius: float = 1.0, steps: int = 6, **options: Any) -> Mesh:
    """Return the teapot centred at the origin, y upwards, with `steps` cells along each side of a patch."""
    patches = [_revolved(np.array(curve), quarter) for curve in PROFILES for quarter in range(4)]
    for inner, outer, widths in TUBES:
        patches += [_half_tube(np.array(inner), np.array(outer), np.array(widths), sign) for sign in (1.0, -1.0)]
    vertices: list[np.ndarray[Any, Any]] = []
    faces: list[np.ndarray[Any, Any]] = []
    for patch in patches:
        grid = _surface(patch, steps)
        first = sum(map(len, vertices))
        corner = np.arange(steps * (steps + 1)).reshape(steps, -1)[:, :-1].ravel() + first
        a, b, c, d = corner, corner + 1, corner + steps + 2, corner + steps + 1
        vertices.append(grid)
        faces.append(np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)]))
    points, triangles = _welded(np.concatenate(vertices), np.concatenate(faces))
    lower, upper = points.min(axis=0), points.max(axis=0)
    points = radius * (points - 0.5 * (lower + upper)) / (0.5 * (upper - lower).max())
    return Mesh(points, triangles, **options)


def _revolved(curve: np.ndarray[Any, Any], quarter: int) -> np.ndarray[Any, Any]:
    """Return the control points (4, 4, 3) of a quarter of the surface of revolution of a curve of (radius, height)."""
    arc = np.array([[1.0, 0.0], [1.0, ARC_HANDLE], [ARC_HANDLE, 1.0], [0.0, 1.0]])
    angle = 0.5 * np.pi * quarter
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    horizontal = curve[:, None, :1] * (arc @ rotation)[None]
    heights = np.broadcast_to(curve[:, None, 1:], (4, 4, 1))
    return np.concatenate([horizontal[..., :1], heights, -horizontal[..., 1:]], axis=2)


def _half_tube(inner: Any, outer: Any, widths: Any, sign: float) -> np.ndarray[Any, Any]:
    """Return the control points (4, 4, 3) of the half of a tube on one side of the plane of symmetry."""
    rows = []
    for inner_point, outer_point, width in zip(inner, outer, widths, strict=True):
        rows.append(
            [
                (*inner_point, 0.0),
                (*inner_point, sign * width),
                (*outer_point, sign * width),
                (*outer_point, 0.0),
            ]
        )
    patch = np.array(rows)
    return patch if sign > 0.0 else patch[:, ::-1]


def _surface(patch: np.ndarray[Any, Any], steps: int) -> np.ndarray[Any, Any]:
    t = np.linspace(0.0, 1.0, steps + 1)[:, None]
    basis = np.concatenate([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], axis=1)
    points: np.ndarray[Any, Any] = np.einsum("ia,jb,abc->ijc", basis, basis, patch).reshape(-1, 3)
    return points


def _welded(
    points: np.ndarray[Any, Any], faces: np.ndarray[Any, Any]
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return vertices and faces with coincident vertices merged, and without degenerate triangles."""
    rounded, index = np.unique(np.round(points, 9) + 0.0, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    is_proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return rounded, faces[is_proper]

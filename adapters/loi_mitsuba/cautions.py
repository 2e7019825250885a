"""Scenes whose gradient Mitsuba gets wrong without a word."""

from __future__ import annotations

import warnings
from typing import Any

import mitsuba as mi
import numpy as np

from loi_core.support.arrays import Host

__all__ = ["GradientWarning", "warn_of_moving"]


class GradientWarning(UserWarning):
    """Part of the gradient that was asked for is missing or wrong."""


def warn_of_moving(scene: Any, integrator: Any, shapes: list[Any]) -> None:
    """Warn where moving `shapes` has a gradient that Mitsuba misses or counts twice.

    An integrator without projective sampling differentiates what lies inside the outlines of shapes and shadows, not
    that the outlines move. Projective sampling finds the rays that graze a shape and asks how bright what lies behind
    is. It looks at the scene's own shapes only, not into groups. Hardly any ray hits a point, so shadows of point,
    spot and directional lights have no gradient at all. And it takes every edge of a mesh that belongs to one
    triangle for a border, so an edge whose vertices are stored twice counts twice.
    """
    if shapes and not hasattr(integrator, "sppp"):  # only projective integrators count samples of outlines
        msg = (
            "a shape moves, and the integrator has no gradient of moving silhouettes and shadows; use "
            "direct_projective or prb_projective"
        )
        warnings.warn(msg, GradientWarning, stacklevel=4)
        return
    own = scene.shapes()
    for shape in shapes:
        if shape not in own:
            msg = (
                f"shape {shape.id()!r} moves in a shapegroup, and the motion of its instances' silhouettes and shadows "
                f"has no gradient; put the shape into the scene itself"
            )
            warnings.warn(msg, GradientWarning, stacklevel=4)
    delta = [emitter for emitter in scene.emitters() if mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta)]
    if shapes and delta:
        kinds = " and ".join(sorted({emitter.class_name() for emitter in delta}))
        msg = (
            f"a shape moves under a {kinds}, and the motion of its shadows has no gradient there; use a small sphere "
            f"with an area emitter"
        )
        warnings.warn(msg, GradientWarning, stacklevel=4)
    for shape in shapes:
        if isinstance(shape, mi.Mesh) and _split_edges(mi.traverse(shape)):
            msg = (
                f"mesh {shape.id()!r} stores the vertices of an edge more than once, and Mitsuba counts the gradient "
                f"of such an edge as often; merge equal vertices (and set face_normals for flat shading)"
            )
            warnings.warn(msg, GradientWarning, stacklevel=4)


def _split_edges(params: Any) -> bool:
    """Whether edges are borders only because their vertices are not shared."""
    if "faces" not in params:  # a rectangle is a mesh of Mitsuba's own, whose border is its outline
        return False
    faces = np.array(params["faces"], dtype=np.int64).reshape(-1, 3)
    positions = np.array(params["vertex_positions"], dtype=np.float32).reshape(-1, 3)
    rows = np.ascontiguousarray(positions + 0.0).view([("", np.float32)] * 3)  # + 0.0 makes -0.0 equal to 0.0
    place = np.unique(rows, return_inverse=True)[1].reshape(-1)
    return _borders(place[faces]) < _borders(faces)


def _borders(faces: Host) -> int:
    """Number of edges that belong to one triangle only."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    counts = np.unique(edges[:, 0] * (faces.max(initial=0) + 1) + edges[:, 1], return_counts=True)[1]
    return int(np.count_nonzero(counts == 1))

"""Scenes whose gradient Mitsuba gets wrong without a word."""

from __future__ import annotations

import warnings
from typing import Any, Final

import mitsuba as mi

from loi_core.support.wording import clause
from loi_mitsuba.seams import crowded_share, has_seams

__all__ = ["CROWDED", "GradientWarning", "lets_through", "warn_of_moving"]

CROWDED: Final = 0.05  # of a mesh's edges, by length: what its gradient may be off by


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
    each, own = dict.fromkeys(shapes), scene.shapes()
    grouped = dict.fromkeys(shape.id() for shape in each if shape not in own)
    if grouped:
        moves = f"{'shape' if len(grouped) == 1 else 'shapes'} {clause(grouped, 'moves', 'move')}"
        msg = (
            f"{moves} in a shapegroup, and the motion of its instances' silhouettes and shadows has no gradient; put "
            f"the shape into the scene itself"
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
    split = dict.fromkeys(shape.id() for shape in each if has_seams(shape))
    if split:
        stores = f"{'mesh' if len(split) == 1 else 'meshes'} {clause(split, 'stores', 'store')}"
        msg = (
            f"{stores} the vertices of an edge more than once, and Mitsuba counts the gradient of such an edge as "
            f"often; merge equal vertices (and set face_normals for flat shading); PlannedRenderer does where shading "
            f"is smooth or flat throughout"
        )
        warnings.warn(msg, GradientWarning, stacklevel=4)
    crowded = dict.fromkeys(shape.id() for shape in each if crowded_share(shape) > CROWDED)
    if crowded:
        has = f"{'mesh' if len(crowded) == 1 else 'meshes'} {clause(crowded, 'has', 'have')}"
        msg = (
            f"{has} edges at which more than two triangles meet, or that run along others, and Mitsuba counts the "
            f"gradient of such an edge several times; mend the mesh, or use PlannedRenderer, which blurs"
        )
        warnings.warn(msg, GradientWarning, stacklevel=4)
    open_to_light = dict.fromkeys(shape.id() for shape in each if lets_through(shape))
    if open_to_light:
        msg = (
            f"{clause(open_to_light, 'lets', 'let')} light straight through in part, and Mitsuba has no gradient of "
            f"cutouts; use PlannedRenderer, which blurs"
        )
        warnings.warn(msg, GradientWarning, stacklevel=4)


def lets_through(shape: Any) -> bool:
    """Whether light may go straight through a shape, as through the cutouts of a mask."""
    return shape.bsdf() is not None and bool(mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null))

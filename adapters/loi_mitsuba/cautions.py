"""Scenes whose gradient Mitsuba gets wrong without a word."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any, Final

import mitsuba as mi

from loi_core.support.wording import clause
from loi_mitsuba.seams import crowded_share, has_seams

__all__ = ["GradientWarning", "is_crowded", "lets_through", "warn_of_moving"]

CROWDED: Final = 0.05  # of a mesh's edges, by length: what its gradient may be off by


class GradientWarning(UserWarning):
    """Part of the gradient that was asked for is missing or wrong."""


def warn_of_moving(scene: Any, integrator: Any, shapes: list[Any]) -> None:
    """Warn where moving `shapes` has a gradient that Mitsuba misses or counts twice.

    An integrator without projective sampling differentiates what lies inside the outlines of shapes and shadows, not
    that the outlines move. Projective sampling finds the rays that graze a shape and asks how bright what lies behind
    is. It looks at the scene's own shapes only, not into groups, and takes them for whole, without cutouts. Hardly any
    ray hits a point, so shadows of point, spot and directional lights have no gradient at all. And it takes every edge
    of a mesh that belongs to one triangle, or to more than two, for a border, so that an edge whose vertices are stored
    twice counts twice.
    """
    for msg in _cautions(scene, integrator, shapes):
        warnings.warn(msg, GradientWarning, stacklevel=4)


def _cautions(scene: Any, integrator: Any, shapes: list[Any]) -> Iterator[str]:
    """What there is to warn of, one message each."""
    if shapes and not hasattr(integrator, "sppp"):  # only projective integrators count samples of outlines
        yield (
            "a shape moves, and the integrator has no gradient of moving silhouettes and shadows; use "
            "direct_projective or prb_projective"
        )
        return
    each, own = list(dict.fromkeys(shapes)), scene.shapes()
    if grouped := _ids(each, lambda shape: shape not in own):
        moves = f"{'shape' if len(grouped) == 1 else 'shapes'} {clause(grouped, 'moves', 'move')}"
        yield (
            f"{moves} in a shapegroup, and the motion of its instances' silhouettes and shadows has no gradient; put "
            f"the shape into the scene itself"
        )
    delta = [emitter for emitter in scene.emitters() if mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta)]
    if shapes and delta:
        kinds = " and ".join(sorted({emitter.class_name() for emitter in delta}))
        yield (
            f"a shape moves under a {kinds}, and the motion of its shadows has no gradient there; use a small sphere "
            f"with an area emitter"
        )
    if split := _ids(each, has_seams):
        yield (
            f"{_meshes(split, 'stores', 'store')} the vertices of an edge more than once, and Mitsuba counts the "
            f"gradient of such an edge as often; merge equal vertices (and set face_normals for flat shading); "
            f"PlannedRenderer does where shading is smooth or flat throughout"
        )
    if crowded := _ids(each, is_crowded):
        yield (
            f"{_meshes(crowded, 'has', 'have')} edges at which more than two triangles meet, or that run along others, "
            f"and Mitsuba counts the gradient of such an edge several times; mend the mesh, or use PlannedRenderer, "
            f"which blurs"
        )
    if cut := _ids(each, lets_through):
        yield (
            f"{clause(cut, 'lets', 'let')} light straight through in part, and Mitsuba has no gradient of cutouts; use "
            f"PlannedRenderer, which blurs"
        )


def _ids(shapes: list[Any], is_one: Callable[[Any], bool]) -> list[str]:
    """The ids of the shapes of a kind, each once."""
    return list(dict.fromkeys(shape.id() for shape in shapes if is_one(shape)))


def _meshes(ids: list[str], one: str, several: str) -> str:
    return f"{'mesh' if len(ids) == 1 else 'meshes'} {clause(ids, one, several)}"


def is_crowded(shape: Any) -> bool:
    """Whether Mitsuba counts so many of a shape's edges several times that its gradient is well off."""
    return crowded_share(shape) > CROWDED


def lets_through(shape: Any) -> bool:
    """Whether light may go straight through a shape, as through the cutouts of a mask."""
    return shape.bsdf() is not None and bool(mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null))

"""Scenes whose gradient Mitsuba gets wrong without a word."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core.support.wording import clause, listed
from loi_mitsuba.geometry.bounds import bounding_box
from loi_mitsuba.geometry.mesh import has_inward_normals, has_smoothed_edges, is_unwelded, non_manifold_fraction
from loi_mitsuba.geometry.stepped_textures import has_stepped_texture
from loi_mitsuba.scene.parameters import SceneIndex
from loi_mitsuba.sensing.sensor import ray_epsilon

__all__ = [
    "GradientWarning",
    "has_inverted_normals",
    "is_near_clipped",
    "is_non_manifold",
    "is_partly_transparent",
    "unsupported_parameter",
    "warn_about_entries",
    "warn_about_moving_shapes",
]

CURVES: Final = ("BSplineCurve", "LinearCurve")
WITH_ALPHA: Final = (2, 4)  # channels
CHOICES: Final = {"MaskBSDF": "opacity", "BlendBSDF": "weight"}
COLOURS: Final = ("specular_reflectance", "specular_transmittance", "eta", "k")
MAPS: Final = ("BumpMap", "NormalMap")
GRID: Final = 64  # places of the image along either side
LIFTED: Final = 1e-3  # of a shape's extent: what it may be lifted by
CROWDED: Final = 0.05  # of a mesh's edges, by length: what its gradient may be off by


class GradientWarning(UserWarning):
    """Part of the gradient that was asked for is missing or wrong."""


def warn_about_moving_shapes(
    scene: Any, sensor: Any, integrator: Any, shapes: list[Any], drawn: Container[Any]
) -> None:
    """Warn where moving `shapes` has a gradient that is missed or counted twice.

    An integrator without projective sampling differentiates what lies inside the outlines of shapes and shadows, not
    that the outlines move. Projective sampling finds the rays that graze a shape and asks how bright what lies behind
    is. It looks at the scene's own shapes only, not into groups, and takes them for whole, without cutouts. Hardly any
    ray hits a point, so shadows of point, spot and directional lights have no gradient at all. And it takes every edge
    of a mesh that belongs to one triangle, or to more than two, for a border, so that an edge whose vertices are stored
    twice counts twice. The edges in view of those that are `drawn` are not its business.
    """
    for msg in (*_cautions(scene, integrator, shapes, drawn), *_cautions_in_view(scene, sensor, shapes)):
        warnings.warn(msg, GradientWarning, stacklevel=4)


def _cautions(scene: Any, integrator: Any, shapes: list[Any], drawn: Container[Any]) -> Iterator[str]:
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
    for whose, met in (("", False), ("the shadow of ", True)):  # in view, our own edges stand for Mitsuba's
        split = _ids([one for one in each if (one in drawn) == met], is_unwelded)
        if split:
            yield (
                f"{_meshes(split, 'stores', 'store')} the vertices of an edge more than once, and Mitsuba counts the "
                f"gradient of {whose}such an edge as often; merge equal vertices (and set face_normals for flat "
                f"shading); PlannedRenderer does where shading is smooth or flat throughout"
            )
    if crowded := _ids(each, is_non_manifold):
        yield (
            f"{_meshes(crowded, 'has', 'have')} edges at which more than two triangles meet, or that run along others, "
            f"and Mitsuba counts the gradient of such an edge several times; mend the mesh, or use PlannedRenderer, "
            f"which blurs"
        )
    if cut := _ids(each, is_partly_transparent):
        yield (
            f"{clause(cut, 'lets', 'let')} light straight through in part, and Mitsuba has no gradient of cutouts; use "
            f"PlannedRenderer, which blurs"
        )


def _cautions_in_view(scene: Any, sensor: Any, shapes: list[Any]) -> Iterator[str]:
    """What there is to warn of where the shapes are seen, one message each."""
    each, own, film = list(dict.fromkeys(shapes)), scene.shapes(), sensor.film()
    if turned := _ids(each, lambda shape: has_inverted_normals(shape, sensor)):
        yield (
            f"{clause(turned, 'has', 'have')} normals that point inwards, and Mitsuba misses the shadow of such a "
            f"shape and counts its outline too much; turn it round, or use PlannedRenderer, which blurs"
        )
    if each and is_near_clipped(scene, sensor):
        yield (
            "a shape moves before a camera whose near clipping plane cuts something away, and Mitsuba takes that for "
            "what hides the rest; move it out of the way, or use PlannedRenderer, which blurs"
        )
    if each and (mi.is_spectral or mi.is_polarized):
        yield (
            f"a shape moves in the variant {mi.variant()}, where Mitsuba counts edges of boxes and leaning rectangles "
            f"too much or too little, and misses curves in which shapes cross; use one of RGB"
        )
    if each and film.base_channels_count() in WITH_ALPHA:
        yield "a shape moves, and outlines have no gradient in the film's alpha; compare its colours alone"
    if rounded := _ids(each, has_smoothed_edges):
        yield (
            f"{_meshes(rounded, 'is', 'are')} shaded as if sharp edges were round, and Mitsuba's gradient is then of a "
            f"wrong size; set face_normals, or use more triangles"
        )
    if tubes := _ids(each, lambda shape: sees_inside_cylinder(shape, sensor)):
        yield (
            f"the camera looks into an open end of {listed(tubes)}, and Mitsuba's gradient of such an "
            f"outline is wrong; use a mesh"
        )
    if lifted := _ids(each, lambda shape: ray_epsilon_too_large(shape, own)):
        yield (
            f"{clause(lifted, 'touches', 'touch')} another shape, so small or so far from the origin that Mitsuba "
            f"lifts rays off it by more than {LIFTED:.1%} of its extent, and the gradient is then of a wrong size; "
            f"give the scene in units of its size, near the origin"
        )
    if curves := _ids(each, lambda shape: shape.class_name() in CURVES):
        yield f"{clause(curves, 'is a curve', 'are curves')}, and Mitsuba's gradient of how its outline moves is wrong"
    if mapped := _ids(each, has_mapped_normals):
        yield (
            f"{clause(mapped, 'has', 'have')} a bump or normal map, where brightness jumps as a normal turns away from "
            f"the camera or the light, and at every texel of a bump map, and Mitsuba has no gradient of such steps; "
            f"leave the map out, or expect a gradient of a wrong size"
        )
    if stepped := _ids(each, has_stepped_texture):
        yield (
            f"{clause(stepped, 'has', 'have')} a texture with steps (a checkerboard, or a bitmap of filter_type "
            f"'nearest'), and Mitsuba has no gradient of steps that move; use a bitmap that is interpolated, as "
            f"PlannedRenderer does where the scene is a dict or a file and nothing of the texture is fitted"
        )


def _ids(shapes: list[Any], is_one: Callable[[Any], bool]) -> list[str]:
    """The ids of the shapes of a kind, each once."""
    return list(dict.fromkeys(shape.id() for shape in shapes if is_one(shape)))


def _meshes(ids: list[str], one: str, several: str) -> str:
    return f"{'mesh' if len(ids) == 1 else 'meshes'} {clause(ids, one, several)}"


def has_inverted_normals(shape: Any, sensor: Any) -> bool:
    """Whether the normals of a closed shape point inwards, and it is not one that is around the camera, as a sky."""
    place = np.array(sensor.world_transform().translation(), dtype=np.float64).reshape(3)
    return has_inward_normals(shape) and not shape.bbox().contains(mi.ScalarPoint3f(place.tolist()))


def sees_inside_cylinder(shape: Any, sensor: Any) -> bool:
    """Whether a shape is a cylinder, and a perspective camera is beyond one of its ends."""
    if shape.class_name() != "Cylinder" or sensor.class_name() != "PerspectiveCamera":
        return False
    eye = mi.traverse(shape)["to_world"].inverse() @ mi.Point3f(sensor.world_transform().translation())
    along = float(np.array(eye.z).reshape(-1)[0])  # 0 and 1 are its ends
    return along < 0.0 or along > 1.0


def ray_epsilon_too_large(shape: Any, others: Sequence[Any]) -> bool:
    """Whether a shape's box touches another's, and rays that leave it begin far off its surface for its extent."""
    low, high = bounding_box(shape)
    farthest = np.max(np.abs(np.stack([low, high])), axis=0)
    if ray_epsilon(mi.ScalarPoint3f(farthest.tolist())) <= LIFTED * np.linalg.norm(high - low):
        return False
    boxes = [bounding_box(one) for one in others if one != shape]
    return any(bool(np.all(low <= top) and np.all(bottom <= high)) for bottom, top in boxes)


def is_near_clipped(scene: Any, sensor: Any) -> bool:
    """Whether something is between a perspective camera and its near clipping plane, which the image does not show."""
    if sensor.class_name() != "PerspectiveCamera":
        return False
    grid = (np.indices((GRID, GRID)).reshape(2, -1).astype(np.float32) + np.float32(0.5)) / np.float32(GRID)
    with dr.suspend_grad():
        ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(grid), mi.Point2f(0.5))
        eye = mi.Point3f(sensor.world_transform().translation())
        way = mi.Ray3f(eye, ray.d)
        way.maxt = dr.norm(ray.o - eye)
        return bool(np.any(np.array(scene.ray_test(way))))


def warn_about_entries(called: SceneIndex, targets: Mapping[str, Any]) -> None:
    """Warn of the entries of materials among `targets` by which Mitsuba's gradient is missing or wrong."""
    for name, target in targets.items():
        why = unsupported_parameter(called, target) if isinstance(target, str) else ""
        if why:
            msg = f"{name!r}: {why}; use PlannedRenderer, which blurs"
            warnings.warn(msg, GradientWarning, stacklevel=4)


def unsupported_parameter(called: SceneIndex, target: str) -> str:
    """Why Mitsuba's gradient by an entry of a material is missing or wrong; empty if it is not.

    Its path tracers take what a surface does in single directions from the sample, without a gradient.
    """
    entry = called.known(target)
    material, part = (None, "") if entry is None else called.part_of_material(entry)
    if material is None:
        return ""
    single = mi.has_flag(material.flags(), mi.BSDFFlags.Delta)
    chosen = CHOICES.get(material.class_name(), "") == part
    if single and (chosen or part in COLOURS):
        return f"it is the {part} of a material with light in single directions, by which Mitsuba has no gradient"
    return ""


def is_non_manifold(shape: Any) -> bool:
    """Whether Mitsuba counts so many of a shape's edges several times that its gradient is well off."""
    return non_manifold_fraction(shape) > CROWDED


def has_mapped_normals(shape: Any) -> bool:
    """Whether a shape has a bump or normal map.

    A bump map's bitmap is interpolated linearly, and its slopes, of which the normals are made, not at all. And what is
    shaded by a normal that is turned away is black, however bright it is beside.
    """
    return any(node.class_name() in MAPS for node in mi.traverse(shape).hierarchy)


def is_partly_transparent(shape: Any) -> bool:
    """Whether light may go straight through a shape, as through the cutouts of a mask."""
    return shape.bsdf() is not None and bool(mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null))

"""Diagnoses of scenes whose gradient Mitsuba gets wrong without an error."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core.support.wording import clause, listed
from loi_mitsuba.scene.parameters import SceneIndex
from mitsuba_boundaries.geometry.bounds import bounding_box
from mitsuba_boundaries.geometry.mesh_checks import (
    has_inward_normals,
    has_smoothed_edges,
    is_unwelded,
    non_manifold_fraction,
)
from mitsuba_boundaries.geometry.stepped_textures import has_stepped_texture
from mitsuba_boundaries.sensing.sensor import ray_epsilon

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
ALPHA_CHANNEL_COUNTS: Final = (2, 4)  # channels of films with alpha
LOBE_WEIGHTS: Final = {"MaskBSDF": "opacity", "BlendBSDF": "weight"}
DELTA_LOBE_ENTRIES: Final = ("specular_reflectance", "specular_transmittance", "eta", "k")
NORMAL_MAPS: Final = ("BumpMap", "NormalMap")
CLIP_TEST_RAYS: Final = 64  # along each axis of the image
MAX_RELATIVE_EPSILON: Final = 1e-3  # Mitsuba's ray epsilon as a fraction of a shape's extent
MAX_NON_MANIFOLD: Final = 0.05  # fraction of a mesh's edges, by length: about the relative error of the gradient


class GradientWarning(UserWarning):
    """Part of the requested gradient is missing or wrong."""


def warn_about_moving_shapes(
    scene: Any, sensor: Any, integrator: Any, shapes: list[Any], edged: Container[Any]
) -> None:
    """Warn about moving shapes whose gradient is missing or counted twice.

    Integrators without projective sampling differentiate only the interior of silhouettes and shadows, not the motion
    of these. Projective sampling finds rays that graze a shape and evaluates the radiance behind it. It considers the
    scene's own shapes only, not those in groups, and ignores cutouts. Rays hardly ever hit a point, so shadows of
    point, spot and directional lights have no gradient at all (mitsuba3#1585). Every mesh edge that belongs to one
    triangle, or to more than two, counts as a border, so an edge whose vertices are stored twice counts twice.

    Parameters
    ----------
    scene : mi.Scene
    sensor : mi.Sensor
    integrator : mi.Integrator
    shapes : list of mi.Shape
        The moving shapes.
    edged : container of mi.Shape
        The shapes whose edges in view are sampled by :mod:`mitsuba_boundaries.edge_sampling` instead.
    """
    for msg in (*_scene_warnings(scene, integrator, shapes, edged), *_view_warnings(scene, sensor, shapes)):
        warnings.warn(msg, GradientWarning, stacklevel=4)


def _scene_warnings(scene: Any, integrator: Any, shapes: list[Any], edged: Container[Any]) -> Iterator[str]:
    """Yield the warnings that do not depend on the camera."""
    if shapes and not hasattr(integrator, "sppp"):  # only projective integrators have this sample count
        yield (
            "a shape moves, and the integrator has no gradient of moving silhouettes and shadows; use "
            "direct_projective or prb_projective"
        )
        return
    moving, in_scene = list(dict.fromkeys(shapes)), scene.shapes()
    if grouped := _ids(moving, lambda shape: shape not in in_scene):
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
    if unwelded := _ids([shape for shape in moving if shape not in edged], is_unwelded):
        yield (
            f"{_meshes(unwelded, 'stores', 'store')} the vertices of an edge more than once, and Mitsuba counts the "
            f"gradient of such an edge as often; merge equal vertices (and set face_normals for flat shading); "
            f"PlannedRenderer does where shading is smooth or flat throughout"
        )
    if non_manifold := _ids(moving, is_non_manifold):
        yield (
            f"{_meshes(non_manifold, 'has', 'have')} edges at which more than two triangles meet, or that run along "
            f"others, and Mitsuba counts the gradient of such an edge several times; repair the mesh, or use "
            f"PlannedRenderer, which blurs"
        )
    if transparent := _ids(moving, is_partly_transparent):
        yield (
            f"{clause(transparent, 'is', 'are')} partly transparent, and Mitsuba has no gradient of cutouts; use "
            f"PlannedRenderer, which blurs"
        )


def _view_warnings(scene: Any, sensor: Any, shapes: list[Any]) -> Iterator[str]:
    """Yield the warnings about shapes in view."""
    moving, in_scene, film = list(dict.fromkeys(shapes)), scene.shapes(), sensor.film()
    if inverted := _ids(moving, lambda shape: has_inverted_normals(shape, sensor)):
        yield (
            f"{clause(inverted, 'has', 'have')} normals that point inwards, and Mitsuba misses the shadow of such a "
            f"shape and overestimates its outline; flip the normals, or use PlannedRenderer, which blurs"
        )
    if moving and is_near_clipped(scene, sensor):
        yield (
            "a shape moves in a scene that the camera's near clipping plane cuts, and Mitsuba treats the hidden part "
            "as an occluder; move the part out of the way, or use PlannedRenderer, which blurs"
        )
    if moving and (mi.is_spectral or mi.is_polarized):
        yield (
            f"a shape moves in the variant {mi.variant()}, where Mitsuba weighs edges of boxes and leaning rectangles "
            f"wrongly, and misses the curves in which shapes intersect; use an RGB variant"
        )
    if moving and film.base_channels_count() in ALPHA_CHANNEL_COUNTS:
        yield "a shape moves, and silhouettes have no gradient in the film's alpha; compare the colours alone"
    if smoothed := _ids(moving, has_smoothed_edges):
        yield (
            f"{_meshes(smoothed, 'is', 'are')} shaded as if sharp edges were round, which scales Mitsuba's gradient; "
            f"set face_normals, or use more triangles"
        )
    if tubes := _ids(moving, lambda shape: sees_inside_cylinder(shape, sensor)):
        yield (
            f"the camera looks into an open end of {listed(tubes)}, and Mitsuba's gradient of such an outline is "
            f"wrong; use a mesh"
        )
    if spawned_off := _ids(moving, lambda shape: ray_epsilon_too_large(shape, in_scene)):
        yield (
            f"{clause(spawned_off, 'touches', 'touch')} another shape, and is too small, or too far from the origin, "
            f"for Mitsuba's ray epsilon, more than {MAX_RELATIVE_EPSILON:.1%} of its extent, which scales the "
            f"gradient; use units of the scene's size, and put it near the origin"
        )
    if curves := _ids(moving, lambda shape: shape.class_name() in CURVES):
        yield f"{clause(curves, 'is a curve', 'are curves')}, and Mitsuba's gradient of how its outline moves is wrong"
    if mapped := _ids(moving, has_normal_map):
        yield (
            f"{clause(mapped, 'has', 'have')} a bump or normal map: shading is discontinuous where a normal turns "
            f"away from the camera or the light, and at every texel of a bump map, and Mitsuba has no gradient of such "
            f"steps; remove the map, or expect a gradient of the wrong size"
        )
    if stepped := _ids(moving, has_stepped_texture):
        yield (
            f"{clause(stepped, 'has', 'have')} a texture with steps (a checkerboard, or a bitmap of filter_type "
            f"'nearest'), and Mitsuba has no gradient of moving steps; use an interpolated bitmap, as PlannedRenderer "
            f"does where the scene is a dict or a file and no parameter of the texture is fitted"
        )


def _ids(shapes: list[Any], condition: Callable[[Any], bool]) -> list[str]:
    """Return the distinct ids of the shapes that fulfil a condition."""
    return list(dict.fromkeys(shape.id() for shape in shapes if condition(shape)))


def _meshes(ids: list[str], singular: str, plural: str) -> str:
    return f"{'mesh' if len(ids) == 1 else 'meshes'} {clause(ids, singular, plural)}"


def has_inverted_normals(shape: Any, sensor: Any) -> bool:
    """Return whether the normals of a closed shape point inwards and the camera is outside it, unlike a sky dome's."""
    position = np.array(sensor.world_transform().translation(), dtype=np.float64).reshape(3)
    return has_inward_normals(shape) and not shape.bbox().contains(mi.ScalarPoint3f(position.tolist()))


def sees_inside_cylinder(shape: Any, sensor: Any) -> bool:
    """Return whether a shape is a cylinder with a perspective camera beyond one of its ends."""
    if shape.class_name() != "Cylinder" or sensor.class_name() != "PerspectiveCamera":
        return False
    camera = mi.traverse(shape)["to_world"].inverse() @ mi.Point3f(sensor.world_transform().translation())
    z = float(np.array(camera.z).reshape(-1)[0])  # the cylinder extends from 0 to 1
    return z < 0.0 or z > 1.0


def ray_epsilon_too_large(shape: Any, shapes: Sequence[Any]) -> bool:
    """Return whether a shape's box overlaps another's, and Mitsuba's ray epsilon is large compared to the shape."""
    lower, upper = bounding_box(shape)
    farthest = np.max(np.abs(np.stack([lower, upper])), axis=0)
    if ray_epsilon(mi.ScalarPoint3f(farthest.tolist())) <= MAX_RELATIVE_EPSILON * np.linalg.norm(upper - lower):
        return False
    boxes = [bounding_box(neighbour) for neighbour in shapes if neighbour != shape]
    return any(bool(np.all(lower <= top) and np.all(bottom <= upper)) for bottom, top in boxes)


def is_near_clipped(scene: Any, sensor: Any) -> bool:
    """Return whether something lies between a perspective camera and its near clipping plane."""
    if sensor.class_name() != "PerspectiveCamera":
        return False
    rays = np.float32(CLIP_TEST_RAYS)
    uv = (np.indices((CLIP_TEST_RAYS, CLIP_TEST_RAYS)).reshape(2, -1).astype(np.float32) + np.float32(0.5)) / rays
    with dr.suspend_grad():
        ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(uv), mi.Point2f(0.5))
        camera = mi.Point3f(sensor.world_transform().translation())
        clipped_part = mi.Ray3f(camera, ray.d)
        clipped_part.maxt = dr.norm(ray.o - camera)
        return bool(np.any(np.array(scene.ray_test(clipped_part))))


def warn_about_entries(index: SceneIndex, targets: Mapping[str, Any]) -> None:
    """Warn about targets that are material entries without a correct gradient in Mitsuba."""
    for name, target in targets.items():
        reason = unsupported_parameter(index, target) if isinstance(target, str) else ""
        if reason:
            warnings.warn(f"{name!r}: {reason}; use PlannedRenderer, which blurs", GradientWarning, stacklevel=4)


def unsupported_parameter(index: SceneIndex, target: str) -> str:
    """Return why Mitsuba's gradient for an entry of a material is missing or wrong; an empty string if it is right.

    Mitsuba's path tracers take the value of a delta lobe from BSDF sampling, without a gradient.
    """
    entry = index.get(target)
    material, attribute = (None, "") if entry is None else index.material_input(entry)
    if material is None:
        return ""
    is_delta = mi.has_flag(material.flags(), mi.BSDFFlags.Delta)
    is_lobe_weight = LOBE_WEIGHTS.get(material.class_name(), "") == attribute
    if is_delta and (is_lobe_weight or attribute in DELTA_LOBE_ENTRIES):
        return f"it is the {attribute} of a material with a delta lobe, for which Mitsuba has no gradient"
    return ""


def is_non_manifold(shape: Any) -> bool:
    """Return whether Mitsuba counts so many of a mesh's edges several times that its gradient is well off."""
    return non_manifold_fraction(shape) > MAX_NON_MANIFOLD


def has_normal_map(shape: Any) -> bool:
    """Return whether a shape has a bump or normal map.

    The normals of a bump map are discontinuous between texels, because its heights are interpolated linearly. Surfaces
    whose shading normal faces away are black, however bright they are nearby.
    """
    return any(node.class_name() in NORMAL_MAPS for node in mi.traverse(shape).hierarchy)


def is_partly_transparent(shape: Any) -> bool:
    """Return whether light may pass straight through a shape, as through the cutouts of a mask."""
    return shape.bsdf() is not None and bool(mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null))

"""Diagnoses of scenes whose gradient Mitsuba gets wrong without an error."""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Iterator, Sequence
from typing import Any, Final, Literal, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.attached.dielectrics import is_clear_glass
from mitsuba_boundaries.geometry.bounds import bounding_box
from mitsuba_boundaries.geometry.mesh_checks import (
    has_inward_normals,
    has_smoothed_edges,
    is_unwelded,
    non_manifold_fraction,
)
from mitsuba_boundaries.geometry.stepped_textures import has_stepped_texture
from mitsuba_boundaries.sensing.sensor import ray_epsilon, supports_boundary_sampling

__all__ = [
    "INSTANCE_PROBLEM",
    "Diagnosis",
    "diagnoses_of_moving_shapes",
    "has_medium",
    "is_delta_input",
    "is_instance",
    "is_non_manifold",
    "unsupported_motion",
]

INSTANCE_PROBLEM: Final = "it moves an instance of a shapegroup, for which Mitsuba has no gradient"
CURVES: Final = ("BSplineCurve", "LinearCurve")
ALPHA_CHANNEL_COUNTS: Final = (2, 4)  # channels of films with alpha
LOBE_WEIGHTS: Final = {"MaskBSDF": "opacity", "BlendBSDF": "weight"}
DELTA_LOBE_ENTRIES: Final = ("specular_reflectance", "specular_transmittance", "eta", "k")
NORMAL_MAPS: Final = ("BumpMap", "NormalMap")
CLIP_TEST_RAYS: Final = 64  # along each axis of the image
MAX_RELATIVE_EPSILON: Final = 1e-3  # Mitsuba's ray epsilon as a fraction of a shape's extent
MAX_NON_MANIFOLD: Final = 0.05  # fraction of a mesh's edges, by length: about the relative error of the gradient
MAX_LISTED: Final = 4  # ids before the others are only counted


class Diagnosis(NamedTuple):
    """A part of a gradient that is missing or wrong.

    Attributes
    ----------
    cause, remedy : str
        Clauses of a sentence.
    source : {"", "differentiable_scene", "images"}
        Another source of the gradient, if there is one: a scene of :func:`mitsuba_boundaries.differentiable_scene`, or
        only images with different parameters.
    """

    cause: str
    remedy: str
    source: Literal["", "differentiable_scene", "images"] = ""


def diagnoses_of_moving_shapes(
    scene: Any, sensor: Any, integrator: Any, shapes: Collection[Any], edged: Container[Any]
) -> list[Diagnosis]:
    """Return the diagnoses of moving shapes whose gradient is missing or counted twice.

    Integrators without projective sampling differentiate only the interior of silhouettes and shadows, not the motion
    of these. Projective sampling finds rays that graze a shape and evaluates the radiance behind it. It considers the
    scene's own shapes only, not those in groups, and ignores cutouts. Rays hardly ever hit a point, so shadows of
    point, spot and directional lights have no gradient (mitsuba3#1585) where boundary terms cannot be sampled. Every
    mesh edge that belongs to one triangle, or to more than two, counts as a border, so an edge whose vertices are
    stored twice counts twice.

    Parameters
    ----------
    scene : mi.Scene
    sensor : mi.Sensor
    integrator : mi.Integrator
    shapes : collection of mi.Shape
        The moving shapes.
    edged : container of mi.Shape
        The shapes whose edges in view are sampled by :mod:`mitsuba_boundaries.edge_sampling` instead.
    """
    moving = list(dict.fromkeys(shapes))
    if not moving:
        return []
    return [*_scene_diagnoses(scene, integrator, moving, edged), *_view_diagnoses(scene, sensor, moving)]


def _scene_diagnoses(scene: Any, integrator: Any, moving: Sequence[Any], edged: Container[Any]) -> Iterator[Diagnosis]:
    """Yield the diagnoses that do not depend on the camera."""
    if not hasattr(integrator, "sppp"):  # only projective integrators have this sample count
        yield Diagnosis(
            "a shape moves, and the integrator has no gradient of moving silhouettes and shadows",
            "use direct_projective or prb_projective",
        )
        return
    in_scene = scene.shapes()
    if grouped := _ids(moving, lambda shape: shape not in in_scene):
        moves = f"{'shape' if len(grouped) == 1 else 'shapes'} {_clause(grouped, 'moves', 'move')}"
        yield Diagnosis(
            f"{moves} in a shapegroup, and the motion of its instances' silhouettes and shadows has no gradient",
            "put the shape into the scene itself",
        )
    if unwelded := _ids([shape for shape in moving if shape not in edged], is_unwelded):
        yield Diagnosis(
            f"{_meshes(unwelded, 'stores', 'store')} the vertices of an edge more than once, and Mitsuba counts the "
            f"gradient of such an edge as often",
            "merge equal vertices (and set face_normals for flat shading)",
            "differentiable_scene",
        )
    if non_manifold := _ids(moving, is_non_manifold):
        yield Diagnosis(
            f"{_meshes(non_manifold, 'has', 'have')} edges at which more than two triangles meet, or that run along "
            f"others, and Mitsuba counts the gradient of such an edge several times",
            "repair the mesh",
            "images",
        )
    if transparent := _ids(moving, _is_partly_transparent):
        yield Diagnosis(
            f"{_clause(transparent, 'is', 'are')} partly transparent, and Mitsuba has no gradient of cutouts",
            "use meshes of the shape that is left",
            "images",
        )


def _view_diagnoses(scene: Any, sensor: Any, moving: Sequence[Any]) -> Iterator[Diagnosis]:
    """Yield the diagnoses of shapes in view."""
    in_scene, film = scene.shapes(), sensor.film()
    delta = [emitter for emitter in scene.emitters() if mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta)]
    if delta and not supports_boundary_sampling(scene, sensor):
        kinds = " and ".join(sorted({emitter.class_name() for emitter in delta}))
        yield Diagnosis(
            f"a shape moves under a {kinds}, and the motion of its shadows has no gradient for this camera, variant or "
            f"medium",
            "use a small sphere with an area emitter",
            "differentiable_scene",
        )
    if inverted := _ids(moving, lambda shape: _has_inverted_normals(shape, sensor)):
        yield Diagnosis(
            f"{_clause(inverted, 'has', 'have')} normals that point inwards, and Mitsuba misses the shadow of such a "
            f"shape and overestimates its outline",
            "flip the normals",
            "images",
        )
    if _is_near_clipped(scene, sensor):
        yield Diagnosis(
            "a shape moves in a scene that the camera's near clipping plane cuts, and Mitsuba treats the hidden part "
            "as an occluder",
            "move the part out of the way",
            "images",
        )
    if mi.is_spectral or mi.is_polarized:
        yield Diagnosis(
            f"a shape moves in the variant {mi.variant()}, where Mitsuba weighs edges of boxes and leaning rectangles "
            f"wrongly, and misses the curves in which shapes intersect",
            "use an RGB variant",
        )
    if film.base_channels_count() in ALPHA_CHANNEL_COUNTS:
        yield Diagnosis(
            "a shape moves, and silhouettes have no gradient in the film's alpha", "compare the colours alone"
        )
    if smoothed := _ids(moving, has_smoothed_edges):
        yield Diagnosis(
            f"{_meshes(smoothed, 'is', 'are')} shaded as if sharp edges were round, which scales Mitsuba's gradient",
            "set face_normals, or use more triangles",
        )
    if tubes := _ids(moving, lambda shape: _sees_inside_cylinder(shape, sensor)):
        yield Diagnosis(
            f"the camera looks into an open end of {_listed(tubes)}, and Mitsuba's gradient of such an outline is "
            f"wrong",
            "use a mesh",
        )
    if spawned_off := _ids(moving, lambda shape: _ray_epsilon_too_large(shape, in_scene)):
        yield Diagnosis(
            f"{_clause(spawned_off, 'touches', 'touch')} another shape, and is too small, or too far from the origin, "
            f"for Mitsuba's ray epsilon, more than {MAX_RELATIVE_EPSILON:.1%} of its extent, which scales the gradient",
            "use units of the scene's size, and put it near the origin",
        )
    if curves := _ids(moving, lambda shape: shape.class_name() in CURVES):
        yield Diagnosis(
            f"{_clause(curves, 'is a curve', 'are curves')}, and Mitsuba's gradient of how its outline moves is wrong",
            "use a mesh",
        )
    if mapped := _ids(moving, _has_normal_map):
        yield Diagnosis(
            f"{_clause(mapped, 'has', 'have')} a bump or normal map: shading is discontinuous where a normal turns "
            f"away from the camera or the light, and at every texel of a bump map, and Mitsuba has no gradient of such "
            f"steps",
            "remove the map, or expect a gradient of the wrong size",
        )
    if stepped := _ids(moving, has_stepped_texture):
        yield Diagnosis(
            f"{_clause(stepped, 'has', 'have')} a texture with steps (a checkerboard, or a bitmap of filter_type "
            f"'nearest'), and Mitsuba has no gradient of moving steps",
            "use an interpolated bitmap",
            "differentiable_scene",
        )


def unsupported_motion(node: Any, scene: Any, sensor: Any, *, medium: bool, rigid: bool) -> str:
    """Return why moving an object has no usable gradient with any integrator; empty if it has one.

    Parameters
    ----------
    node, scene, sensor
    medium : bool
        Whether the scene has a medium.
    rigid : bool
        Whether the object moves as a whole. Wrong gradients of single vertices are only diagnosed.
    """
    if isinstance(node, mi.Sensor):
        return "it moves a camera, for which Mitsuba has no gradient"
    if isinstance(node, mi.Emitter):
        return f"it moves a {node.class_name()}, for which Mitsuba's gradient is missing or wrong"
    if is_instance(node):
        return INSTANCE_PROBLEM
    if is_clear_glass(node):
        return "it moves clear glass, whose refractions have hardly any gradient in Mitsuba"
    if node not in scene.shapes():
        return "it moves a shape of a shapegroup, whose outlines and shadows have no gradient in Mitsuba"
    if rigid and _is_partly_transparent(node):
        return "it moves a partly transparent shape, and Mitsuba has no gradient of cutouts"
    if rigid and _has_inverted_normals(node, sensor):
        return "it moves a shape with inverted normals, whose shadow has no gradient in Mitsuba"
    if rigid and is_non_manifold(node):
        return "it moves a mesh with non-manifold edges, whose gradient Mitsuba counts several times"
    if rigid and _is_near_clipped(scene, sensor):
        return "it moves a shape in front of a near clipping plane that cuts a shape, which Mitsuba takes for opaque"
    if medium:
        return "it moves a shape in a scene with a medium, where outlines and shadows have no gradient in Mitsuba"
    if sensor.class_name() != "PerspectiveCamera":
        class_name = sensor.class_name()
        return f"it moves a shape, and Mitsuba has no gradient of outlines for a camera of type {class_name}"
    if any(emitter.class_name() == "DirectionalArea" for emitter in scene.emitters()):
        return "it moves a shape under a DirectionalArea, where Mitsuba has no gradient of outlines and shadows"
    return ""


def is_delta_input(material: Any, attribute: str) -> bool:
    """Return whether an input of a BSDF is one of a delta lobe, for which Mitsuba's gradient is missing or wrong.

    Mitsuba's path tracers take the value of a delta lobe from BSDF sampling, without a gradient.
    """
    is_lobe_weight = LOBE_WEIGHTS.get(material.class_name(), "") == attribute
    has_delta_lobe = bool(mi.has_flag(material.flags(), mi.BSDFFlags.Delta))
    return has_delta_lobe and (is_lobe_weight or attribute in DELTA_LOBE_ENTRIES)


def is_instance(node: Any) -> bool:
    """Return whether an object is an instance of a shapegroup."""
    return isinstance(node, mi.Shape) and node.class_name() == "Instance"


def has_medium(scene: Any) -> bool:
    """Return whether there is a participating medium within or around a shape, or around a sensor."""
    media = (medium for shape in scene.shapes() for medium in (shape.interior_medium(), shape.exterior_medium()))
    return any(medium is not None for medium in media) or any(
        isinstance(record[2], mi.Medium) for record in mi.traverse(scene).properties.values()
    )


def _ids(shapes: Sequence[Any], condition: Callable[[Any], bool]) -> list[str]:
    """Return the distinct ids of the shapes that fulfil a condition."""
    return list(dict.fromkeys(shape.id() for shape in shapes if condition(shape)))


def _listed(ids: Sequence[str]) -> str:
    """Return ids in quotes; of more than five the first four and the number of the others."""
    omitted = len(ids) - MAX_LISTED
    quoted = [repr(name) for name in ids]
    return ", ".join(quoted) if omitted <= 1 else f"{', '.join(quoted[:MAX_LISTED])} and {omitted} others"


def _clause(ids: Sequence[str], singular: str, plural: str) -> str:
    return f"{_listed(ids)} {singular if len(ids) == 1 else plural}"


def _meshes(ids: Sequence[str], singular: str, plural: str) -> str:
    return f"{'mesh' if len(ids) == 1 else 'meshes'} {_clause(ids, singular, plural)}"


def _has_inverted_normals(shape: Any, sensor: Any) -> bool:
    """Return whether the normals of a closed shape point inwards and the camera is outside it, unlike a sky dome's."""
    position = np.array(sensor.world_transform().translation(), dtype=np.float64).reshape(3)
    return has_inward_normals(shape) and not shape.bbox().contains(mi.ScalarPoint3f(position.tolist()))


def _sees_inside_cylinder(shape: Any, sensor: Any) -> bool:
    """Return whether a shape is a cylinder with a perspective camera beyond one of its ends."""
    if shape.class_name() != "Cylinder" or sensor.class_name() != "PerspectiveCamera":
        return False
    camera = mi.traverse(shape)["to_world"].inverse() @ mi.Point3f(sensor.world_transform().translation())
    z = float(np.array(camera.z).reshape(-1)[0])  # the cylinder extends from 0 to 1
    return z < 0.0 or z > 1.0


def _ray_epsilon_too_large(shape: Any, shapes: Sequence[Any]) -> bool:
    """Return whether a shape's box overlaps another's, and Mitsuba's ray epsilon is large compared to the shape."""
    lower, upper = bounding_box(shape)
    farthest = np.max(np.abs(np.stack([lower, upper])), axis=0)
    if ray_epsilon(mi.ScalarPoint3f(farthest.tolist())) <= MAX_RELATIVE_EPSILON * np.linalg.norm(upper - lower):
        return False
    boxes = [bounding_box(neighbour) for neighbour in shapes if neighbour != shape]
    return any(bool(np.all(lower <= top) and np.all(bottom <= upper)) for bottom, top in boxes)


def _is_near_clipped(scene: Any, sensor: Any) -> bool:
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


def is_non_manifold(shape: Any) -> bool:
    """Return whether Mitsuba counts so many of a mesh's edges several times that its gradient is well off."""
    return non_manifold_fraction(shape) > MAX_NON_MANIFOLD


def _has_normal_map(shape: Any) -> bool:
    """Return whether a shape has a bump or normal map.

    The normals of a bump map are discontinuous between texels, because its heights are interpolated linearly. Surfaces
    whose shading normal faces away are black, however bright they are nearby.
    """
    return any(node.class_name() in NORMAL_MAPS for node in mi.traverse(shape).hierarchy)


def _is_partly_transparent(shape: Any) -> bool:
    """Return whether light may pass straight through a shape, as through the cutouts of a mask."""
    return shape.bsdf() is not None and bool(mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null))

"""Find parameters with no usable gradient in Mitsuba; they are estimated from blurred images instead."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mitsuba as mi

from loi_mitsuba.diagnostics import (
    has_inverted_normals,
    is_near_clipped,
    is_non_manifold,
    is_partly_transparent,
    unsupported_parameter,
)
from loi_mitsuba.effects.traits import is_known, kind_of
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import INSTANCE_PROBLEM, SceneIndex, is_instance
from loi_mitsuba.scene.queries import has_medium
from mitsuba_boundaries.attached.dielectrics import is_clear_glass

__all__ = ["unsupported_parameters"]


def unsupported_parameters(index: SceneIndex, targets: Mapping[str, ParameterTarget], sensor: Any) -> dict[str, str]:
    """Return the parameters without a usable gradient, each with a reason in one line.

    They are entries that can be set and have no gradient, moving cameras and delta lights, and moving shapes whose
    gradient in Mitsuba is mostly missing or too noisy.
    """
    medium = has_medium(index.scene)
    reasons = {}
    for name, target in targets.items():
        if isinstance(target, str):
            parameter = index.get(target)
            if parameter is None:
                continue  # SceneIndex.find raises for it
            if parameter.problem and parameter.settable:
                reasons[name] = parameter.problem.partition(";")[0]
                continue
            if reason := unsupported_parameter(index, target):
                reasons[name] = reason
                continue
            node = index.moved_shape(parameter)
        else:
            node = index.find_movable(target.shape)[1]
        rigid = not isinstance(target, str)
        reason = "" if node is None else _unsupported_motion(node, index.scene, sensor, medium=medium, rigid=rigid)
        if reason:
            reasons[name] = reason
    return reasons


def _unsupported_motion(node: Any, scene: Any, sensor: Any, *, medium: bool, rigid: bool) -> str:
    """Return why moving an object has no usable gradient; empty if it has one.

    Parameters
    ----------
    node, scene, sensor
    medium : bool
        Whether the scene has a medium.
    rigid : bool
        Whether the object moves as a whole. Wrong gradients of single vertices cause a warning instead, because there
        are too many vertices to blur.
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
    if rigid and is_partly_transparent(node):
        return "it moves a partly transparent shape, and Mitsuba has no gradient of cutouts"
    if rigid and has_inverted_normals(node, sensor):
        return "it moves a shape with inverted normals, whose shadow has no gradient in Mitsuba"
    if rigid and is_non_manifold(node):
        return "it moves a mesh with non-manifold edges, whose gradient Mitsuba counts several times"
    if rigid and is_near_clipped(scene, sensor):
        return "it moves a shape in front of a near clipping plane that cuts a shape, which Mitsuba takes for opaque"
    if medium:
        return "it moves a shape in a scene with a medium, where outlines and shadows have no gradient in Mitsuba"
    if sensor.class_name() != "PerspectiveCamera":
        class_name = sensor.class_name()
        return f"it moves a shape, and Mitsuba has no gradient of outlines for a camera of type {class_name}"
    if any(emitter.class_name() == "DirectionalArea" for emitter in scene.emitters()):
        return "it moves a shape under a DirectionalArea, where Mitsuba has no gradient of outlines and shadows"
    integrator = scene.integrator()
    has_boundary_terms = hasattr(integrator, "sppp")
    if rigid and not is_known(kind_of(integrator)) and not has_boundary_terms:
        class_name = integrator.class_name()
        return f"it moves a shape, and an integrator of type {class_name} has no gradient of outlines and shadows"
    return ""

"""Which parameters have no gradient in Mitsuba that is of use, and why: those that images alone have to tell of."""

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
from loi_mitsuba.scene.parameters import INSTANCE, SceneIndex, is_instance
from loi_mitsuba.scene.queries import has_medium, is_clear_glass

__all__ = ["unsupported_parameters"]


def unsupported_parameters(called: SceneIndex, targets: Mapping[str, ParameterTarget], sensor: Any) -> dict[str, str]:
    """The parameters without a gradient, each with the reason in a line.

    Entries that can be set and have no gradient; cameras and lights without a surface that move; and shapes that move
    where Mitsuba misses most of what changes, or finds it with too much noise.
    """
    medium = has_medium(called.scene)
    found = {}
    for name, target in targets.items():
        if isinstance(target, str):
            entry = called.known(target)
            if entry is None:
                continue  # which is told when it is looked for
            if entry.problem and entry.settable:
                found[name] = entry.problem.partition(";")[0]
                continue
            if why := unsupported_parameter(called, target):
                found[name] = why
                continue
            node = called.moved_by(entry)
        else:
            node = called.find_movable(target.shape)[1]
        whole = not isinstance(target, str)
        reason = "" if node is None else _of_moving(node, called.scene, sensor, medium=medium, whole=whole)
        if reason:
            found[name] = reason
    return found


def _of_moving(node: Any, scene: Any, sensor: Any, *, medium: bool, whole: bool) -> str:
    """Why moving an object, as a whole or by its vertices, has no gradient; empty if it has one, or one is off.

    What is off by vertices is told of in a warning: there are too many of them to blur.
    """
    if isinstance(node, mi.Sensor):
        return "it moves a camera, by which Mitsuba has no gradient"
    if isinstance(node, mi.Emitter):
        return f"it moves a {node.class_name()}, by which Mitsuba's gradient is missing or wrong"
    if is_instance(node):
        return INSTANCE
    if is_clear_glass(node):
        return "it moves clear glass, and what that bends light to has next to no gradient in Mitsuba"
    if node not in scene.shapes():
        return "it moves a shape of a shapegroup, whose outlines and shadows have no gradient in Mitsuba"
    if whole and is_partly_transparent(node):
        return "it moves a shape that light goes straight through in part, and Mitsuba has no gradient of cutouts"
    if whole and has_inverted_normals(node, sensor):
        return "it moves a shape whose normals point inwards, of which Mitsuba misses the shadow"
    if whole and is_non_manifold(node):
        return "it moves a mesh at whose edges several triangles meet, and Mitsuba counts such an edge several times"
    if whole and is_near_clipped(scene, sensor):
        return "it moves a shape before a near clipping plane that cuts something away, which Mitsuba takes for opaque"
    if medium:
        return "it moves a shape where there is a medium, in which outlines and shadows have no gradient in Mitsuba"
    if sensor.class_name() != "PerspectiveCamera":
        kind = sensor.class_name()
        return f"it moves a shape, and Mitsuba has no gradient of outlines for the camera, which is of type {kind}"
    if any(one.class_name() == "DirectionalArea" for one in scene.emitters()):
        return (
            "it moves a shape where a DirectionalArea shines, and Mitsuba has no gradient of outlines and shadows there"
        )
    own = scene.integrator()
    if whole and not is_known(kind_of(own)) and not hasattr(own, "sppp"):  # who has outlines counts their samples
        return f"it moves a shape, and an integrator of type {own.class_name()} has no gradient of outlines and shadows"
    return ""

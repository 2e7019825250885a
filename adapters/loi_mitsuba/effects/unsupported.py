"""Find parameters with no usable gradient in Mitsuba; they are estimated from blurred images instead."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from loi_mitsuba.diagnostics import unsupported_parameter
from loi_mitsuba.effects.traits import is_known, kind_of
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import SceneIndex
from mitsuba_boundaries.diagnostics import has_medium, unsupported_motion

__all__ = ["unsupported_parameters"]


def unsupported_parameters(index: SceneIndex, targets: Mapping[str, ParameterTarget], sensor: Any) -> dict[str, str]:
    """Return the parameters without a usable gradient, each with a reason in one line.

    They are entries that can be set and have no gradient, moving cameras and delta lights, and moving shapes whose
    gradient in Mitsuba is mostly missing or too noisy.
    """
    medium, integrator = has_medium(index.scene), index.scene.integrator()
    known = is_known(kind_of(integrator))
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
        if node is None:
            continue
        rigid = not isinstance(target, str)  # there are too many vertices to blur
        reason = unsupported_motion(node, index.scene, sensor, medium=medium, rigid=rigid)
        if not reason and rigid and not (known or hasattr(integrator, "sppp")):
            class_name = integrator.class_name()
            reason = f"it moves a shape, and an integrator of type {class_name} has no gradient of outlines and shadows"
        if reason:
            reasons[name] = reason
    return reasons

"""Transforms of Mitsuba from handles on a shape's pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mitsuba as mi

from loi_core.renderers.poses import PoseParameter, Rotate, Scale, Translate, in_application_order
from mitsuba_boundaries.drjit.arrays import unravel

__all__ = ["PoseParameter", "Rotate", "Scale", "Translate", "combined_transform"]


def combined_transform(handles: Sequence[tuple[PoseParameter, Any]], centre: tuple[float, float, float]) -> Any:
    """Combine several handles on one shape into a transform.

    They apply in the order of :func:`loi_core.renderers.poses.in_application_order`.

    Parameters
    ----------
    handles : sequence of (handle, mi.Float)
        Each handle with its value, a flat array.
    centre : 3 floats
        The pivot of handles without a pivot.

    Returns
    -------
    mi.Transform4f
        Attached to the values.
    """
    total = mi.Transform4f()
    for handle, value in in_application_order(handles):
        if isinstance(handle, Translate):
            offset = unravel(mi.Vector3f, value) if handle.axis is None else mi.Vector3f(*handle.axis) * value
            total = mi.Transform4f().translate(offset) @ total
            continue
        pivot = mi.Vector3f(*(centre if handle.pivot is None else handle.pivot))
        if isinstance(handle, Rotate):
            axis = handle.axis or ()  # never empty: checked_targets requires an axis
            local = mi.Transform4f().rotate(mi.Vector3f(*axis), value)
        else:
            local = mi.Transform4f().scale(mi.Vector3f(value))
        total = mi.Transform4f().translate(pivot) @ local @ mi.Transform4f().translate(-pivot) @ total
    return total

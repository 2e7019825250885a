"""Transforms of Mitsuba for the handles on a shape's pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi

from loi_core.renderers.poses import PoseParameter, Rotate, Scale, Translate, in_application_order

__all__ = ["PoseParameter", "Rotate", "Scale", "Translate", "posed"]

Vector: TypeAlias = tuple[float, float, float]


def posed(handles: Sequence[tuple[PoseParameter, Any]], centre: Vector) -> Any:
    """The transform that several handles on one shape make together.

    The order is that of :func:`loi_core.renderers.poses.in_application_order`.

    Parameters
    ----------
    handles : sequence of (handle, mi.Float)
        Each with its value; a flat array.
    centre : 3 floats
        The pivot of handles that have none of their own.

    Returns
    -------
    mi.Transform4f
        Attached to the values.
    """
    total = mi.Transform4f()
    for handle, value in in_application_order(handles):
        if isinstance(handle, Translate):
            offset = dr.unravel(mi.Vector3f, value) if handle.axis is None else _along(handle.axis) * value
            total = mi.Transform4f().translate(offset) @ total
            continue
        pivot = mi.Vector3f(*(centre if handle.pivot is None else handle.pivot))
        if isinstance(handle, Rotate):
            local = mi.Transform4f().rotate(_along(handle.axis or ()), value)  # targets have one, they were checked
        else:
            local = mi.Transform4f().scale(mi.Vector3f(value))
        total = mi.Transform4f().translate(pivot) @ local @ mi.Transform4f().translate(-pivot) @ total
    return total


def _along(axis: Sequence[float]) -> Any:
    return mi.Vector3f(*axis)

"""Questions about scenes and their shapes, and the nodes of parsed scenes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import mitsuba as mi

from loi_mitsuba.scene.poses import PoseParameter

__all__ = ["group_by_shape", "has_medium", "is_clear_glass", "parts_of"]


def parts_of(state: Any, number: int, kind: Any) -> Iterator[int]:
    """The numbers of a shape's nodes of one kind, an ``mi.ObjectType``, by the shape's number in the scene."""
    nodes = state.nodes
    shapes = [one for one in _children(nodes[0].props) if nodes[one].type == mi.ObjectType.Shape]
    if number < len(shapes):
        yield from _below(nodes, shapes[number], kind)


def _below(nodes: Any, parent: int, kind: Any) -> Iterator[int]:
    for child in _children(nodes[parent].props):
        if nodes[child].type == kind:
            yield child
        yield from _below(nodes, child, kind)


def _children(props: Any) -> list[int]:
    """The numbers of the nodes that one is made of."""
    values = (props[key] for key in props.keys())  # noqa: SIM118  # these are no dict
    return [one.index() for one in values if isinstance(one, mi.Properties.ResolvedReference)]


def has_medium(scene: Any) -> bool:
    """Whether there is a participating medium, within a shape or around it, or around a sensor."""
    within = (one for shape in scene.shapes() for one in (shape.interior_medium(), shape.exterior_medium()))
    return any(one is not None for one in within) or any(
        isinstance(one[2], mi.Medium) for one in mi.traverse(scene).properties.values()
    )


def group_by_shape(
    targets: Mapping[str, str | PoseParameter], moving: Mapping[str, Any]
) -> tuple[tuple[str, ...], ...]:
    """The parameters, those together that move one shape, and every other alone."""
    together: dict[object, list[str]] = {}
    for name in targets:
        together.setdefault(moving.get(name, name), []).append(name)
    return tuple(map(tuple, together.values()))


def is_clear_glass(shape: Any) -> bool:
    """Whether a shape is of clear glass: light goes through it in single directions."""
    bsdf = shape.bsdf()
    return bsdf is not None and bool(mi.has_flag(bsdf.flags(), mi.BSDFFlags.DeltaTransmission))

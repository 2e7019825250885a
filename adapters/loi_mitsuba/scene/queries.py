"""The nodes of a parsed scene: what its shapes are made of."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mitsuba as mi

__all__ = ["parts_of"]


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

"""Queries about a scene and the parameters that move its shapes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import mitsuba as mi

__all__ = ["group_by_shape", "has_medium"]


def has_medium(scene: Any) -> bool:
    """Return whether there is a participating medium within or around a shape, or around a sensor."""
    media = (medium for shape in scene.shapes() for medium in (shape.interior_medium(), shape.exterior_medium()))
    return any(medium is not None for medium in media) or any(
        isinstance(record[2], mi.Medium) for record in mi.traverse(scene).properties.values()
    )


def group_by_shape(names: Iterable[str], moving: Mapping[str, Any]) -> tuple[tuple[str, ...], ...]:
    """Group parameters that move the same shape; a parameter that moves none is alone.

    Parameters
    ----------
    names : iterable of str
    moving : dict of mi.Shape
        The shape that each parameter moves.
    """
    groups: dict[object, list[str]] = {}
    for name in names:
        groups.setdefault(moving.get(name, name), []).append(name)
    return tuple(map(tuple, groups.values()))

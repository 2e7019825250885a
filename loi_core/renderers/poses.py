"""Handles on the pose of a shape: what a parameter of a renderer may move, other than an entry of the scene.

Renderers of scenes with several shapes share them; each has its own transforms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.errors import ParameterError
from loi_core.renderers.validation import FloatArray
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = ["ParameterTarget", "PoseParameter", "Rotate", "Scale", "Translate", "in_application_order", "parse_targets"]

Vector: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class Translate:
    """Moves a shape from where the scene has it.

    The parameter is an offset (x, y, z) in units of the world, shape (3,); with `axis`, the distance along it, 0-d.

    Parameters
    ----------
    shape : str
        The shape's id or readable name. An area light is moved by its shape.
    axis : sequence of 3 floats, optional
        Direction, of any length.
    """

    shape: str
    axis: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if self.axis is not None:
            object.__setattr__(self, "axis", _direction("axis", self.axis))

    def initial(self) -> FloatArray:
        """The value at which the shape is where the scene has it."""
        return np.zeros(3 if self.axis is None else ())


@dataclass(frozen=True)
class Rotate:
    """Turns a shape about an axis; the parameter is an angle in degrees, 0-d.

    Without an axis it turns freely. The parameter is then two rows of three, from which a matrix of rotation follows by
    Gram and Schmidt's process: unlike angles, they have no singularity (Zhou et al. 2019). Two rows that are parallel
    have no such matrix. Mitsuba's shapes turn about an axis only.

    Parameters
    ----------
    shape : str
        The shape's id or readable name.
    axis : sequence of 3 floats, optional
        Direction, of any length.
    pivot : sequence of 3 floats, optional
        A point on the axis; the centre of the shape's bounding box, where the scene has it, by default.
    """

    shape: str
    axis: Sequence[float] | None = None
    pivot: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if self.axis is not None:
            object.__setattr__(self, "axis", _direction("axis", self.axis))
        if self.pivot is not None:
            object.__setattr__(self, "pivot", _vector("pivot", self.pivot))

    def initial(self) -> FloatArray:
        """The value at which the shape is as the scene has it."""
        return np.eye(2, 3) if self.axis is None else np.zeros(())


@dataclass(frozen=True)
class Scale:
    """Scales a shape alike in all directions; the parameter is a factor, 0-d, more than 0.

    Parameters
    ----------
    shape : str
        The shape's id or readable name.
    pivot : sequence of 3 floats, optional
        The point that stays; the centre of the shape's bounding box, where the scene has it, by default.
    """

    shape: str
    pivot: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if self.pivot is not None:
            object.__setattr__(self, "pivot", _vector("pivot", self.pivot))

    def initial(self) -> FloatArray:
        """The value at which the shape is as large as the scene has it."""
        return np.ones(())


PoseParameter: TypeAlias = Translate | Rotate | Scale
ParameterTarget: TypeAlias = str | PoseParameter

KINDS: Final[dict[str, type[PoseParameter]]] = {kind.__name__: kind for kind in (Translate, Rotate, Scale)}


def _from_table(table: Mapping[str, Any]) -> PoseParameter:
    """The handle that a table of a scene file spells: ``{ Rotate = "ball", axis = [0, 1, 0] }``.

    Its class is a key whose value is the shape; the other keys are the class's other arguments.

    Raises
    ------
    ParameterError
        If it names no class or several, an argument that the class does not have, or lacks one that it needs.
    """
    named = [key for key in table if key in KINDS]
    if len(named) != 1:
        msg = f"a handle has one key of {', '.join(KINDS)}, got {', '.join(map(str, table)) or 'none'}"
        raise ParameterError(msg)
    kind = KINDS[named[0]]
    options = {key: value for key, value in table.items() if key != named[0]}
    arguments = {one.name: one.default for one in fields(kind) if one.name != "shape"}
    for key in options:
        if key not in arguments:
            msg = f"unknown key `{key}`; {kind.__name__} takes {', '.join(arguments)}"
            raise ParameterError(msg)
    for key, default in arguments.items():
        if default is MISSING and key not in options:
            msg = f"{kind.__name__} needs `{key}`"
            raise ParameterError(msg)
    return kind(table[named[0]], **options)


def parse_targets(parameters: object) -> dict[str, ParameterTarget]:
    """Targets by parameter; tables of scene files become handles."""
    if not isinstance(parameters, Mapping) or not parameters:
        msg = f"`parameters` must be a dict of names and what they stand for, at least one, got {parameters!r:.80}"
        raise ParameterError(msg)
    targets: dict[str, ParameterTarget] = {}
    for name, given in parameters.items():
        try:
            target = _from_table(given) if isinstance(given, Mapping) else given
        except ParameterError as error:
            msg = f"`parameters[{name!r}]`: {error}"
            raise ParameterError(msg) from None
        if not isinstance(name, str) or not isinstance(target, str | Translate | Rotate | Scale):
            msg = f"`parameters[{name!r}]` must be an entry's name, Translate, Rotate or Scale, got {target!r:.80}"
            raise ParameterError(msg)
        targets[name] = target
    return targets


def in_application_order(handles: Sequence[tuple[PoseParameter, Any]]) -> list[tuple[PoseParameter, Any]]:
    """Handles with their values, in the order in which they act on a shape.

    It is scaled first, then turned, in the order in which the handles are given, then moved, so that a turn does not
    swing it around the place it was moved from.
    """
    return sorted(handles, key=lambda one: (Scale, Rotate, Translate).index(type(one[0])))


def _vector(name: str, value: object) -> Vector:
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) and len(value) == 3:
        x, y, z = map(real_number, value)
        if all(map(math.isfinite, (x, y, z))):
            return x, y, z
    msg = f"`{name}` must be three finite numbers, got {shown(value)}"
    raise ParameterError(msg)


def _direction(name: str, value: object) -> Vector:
    x, y, z = _vector(name, value)
    length = math.hypot(x, y, z)
    if length == 0.0:
        msg = f"`{name}` must be a direction, got {shown(value)}"
        raise ParameterError(msg)
    return x / length, y / length, z / length

"""Pose parameters: translation, rotation and scale of a shape, for parameters that are not entries of a scene.

Renderers of scenes with several shapes share them; each renderer has its own transforms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.errors import ParameterError
from loi_core.renderers.validation import FloatArray
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = [
    "ParameterTarget",
    "PoseParameter",
    "Rotate",
    "Scale",
    "Translate",
    "in_application_order",
    "parse_targets",
]

Vector: TypeAlias = tuple[float, float, float]


@suggest_keywords
@dataclass(frozen=True)
class Translate:
    """Translation of a shape from its position in the scene.

    The parameter is an offset (x, y, z) in world units, shape (3,); with `axis`, the distance along it, 0-d.

    Parameters
    ----------
    shape : str
        Id or readable name of the shape. An area light moves with its shape.
    axis : sequence of 3 floats, optional
        Direction, of any length.
    """

    shape: str
    axis: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if self.axis is not None:
            object.__setattr__(self, "axis", _direction("axis", self.axis))

    def initial(self) -> FloatArray:
        """Return the value of the identity."""
        return np.zeros(3 if self.axis is None else ())


@suggest_keywords
@dataclass(frozen=True)
class Rotate:
    """Rotation of a shape about an axis; the parameter is an angle in degrees, 0-d.

    Without an axis the rotation is free. The parameter is then two rows of three numbers, and the Gram-Schmidt process
    makes a rotation matrix of them: unlike angles, this representation has no singularity (Zhou et al. 2019). Parallel
    rows have no rotation matrix. Shapes of Mitsuba need an axis.

    Parameters
    ----------
    shape : str
        Id or readable name of the shape.
    axis : sequence of 3 floats, optional
        Direction, of any length.
    pivot : sequence of 3 floats, optional
        A point on the axis; by default the centre of the shape's bounding box in the scene.
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
        """Return the value of the identity."""
        return np.eye(2, 3) if self.axis is None else np.zeros(())


@suggest_keywords
@dataclass(frozen=True)
class Scale:
    """Uniform scaling of a shape; the parameter is a factor, 0-d, more than 0.

    Parameters
    ----------
    shape : str
        Id or readable name of the shape.
    pivot : sequence of 3 floats, optional
        The fixed point; by default the centre of the shape's bounding box in the scene.
    """

    shape: str
    pivot: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if self.pivot is not None:
            object.__setattr__(self, "pivot", _vector("pivot", self.pivot))

    def initial(self) -> FloatArray:
        """Return the value of the identity."""
        return np.ones(())


PoseParameter: TypeAlias = Translate | Rotate | Scale
ParameterTarget: TypeAlias = str | PoseParameter
"""The target of a parameter: the name of an entry of the scene, or a pose parameter."""

POSE_PARAMETERS: Final[dict[str, type[PoseParameter]]] = {pose.__name__: pose for pose in (Translate, Rotate, Scale)}


def parse_targets(parameters: object) -> dict[str, ParameterTarget]:
    """Return targets by parameter; tables of scene files become pose parameters.

    Raises
    ------
    ParameterError
        If `parameters` is not a dict of targets, or a table is not a pose parameter.
    """
    if not isinstance(parameters, Mapping) or not parameters:
        msg = f"`parameters` must be a dict of names and their targets, at least one, got {parameters!r:.80}"
        raise ParameterError(msg)
    targets: dict[str, ParameterTarget] = {}
    for name, value in parameters.items():
        try:
            target = _from_table(value) if isinstance(value, Mapping) else value
        except ParameterError as error:
            msg = f"`parameters[{name!r}]`: {error}"
            raise ParameterError(msg) from None
        if not isinstance(name, str) or not isinstance(target, str | Translate | Rotate | Scale):
            msg = f"`parameters[{name!r}]` must be an entry's name, Translate, Rotate or Scale, got {target!r:.80}"
            raise ParameterError(msg)
        targets[name] = target
    return targets


def in_application_order(poses: Sequence[tuple[PoseParameter, Any]]) -> list[tuple[PoseParameter, Any]]:
    """Sort pose parameters and their values by order of application to a shape.

    Scaling comes first, then rotations in the given order, then translation, so that a rotation does not swing the
    shape around its old position.
    """
    return sorted(poses, key=lambda pose: (Scale, Rotate, Translate).index(type(pose[0])))


def _from_table(table: Mapping[str, Any]) -> PoseParameter:
    """Return the pose parameter of a table of a scene file: ``{ Rotate = "ball", axis = [0, 1, 0] }``.

    One key is the name of the class, with the shape as its value; the other keys are the other arguments.
    """
    classes = [key for key in table if key in POSE_PARAMETERS]
    if len(classes) != 1:
        names = ", ".join(map(str, table)) or "none"
        msg = f"a pose parameter has one key of {', '.join(POSE_PARAMETERS)}, got {names}"
        raise ParameterError(msg)
    pose = POSE_PARAMETERS[classes[0]]
    options = {key: value for key, value in table.items() if key != classes[0]}
    arguments = [argument.name for argument in fields(pose) if argument.name != "shape"]  # all are optional
    for key in options:
        if key not in arguments:
            msg = f"unknown key `{key}`; {pose.__name__} takes {', '.join(arguments)}"
            raise ParameterError(msg)
    return pose(table[classes[0]], **options)


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

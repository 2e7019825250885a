"""Index the parameters of a scene under readable names that are the same in every process."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core.errors import ParameterError
from loi_mitsuba.scene.load import LoadedScene, load_scene, use_variant
from mitsuba_boundaries.diagnostics import INSTANCE_PROBLEM, is_instance
from mitsuba_boundaries.parameter_names import ancestors, is_merged, readable_names

__all__ = [
    "Scene",
    "SceneIndex",
    "SceneParameter",
    "index_scene",
    "list_parameters",
    "matrix_or_value",
]

Scene: TypeAlias = Any
SceneParameters: TypeAlias = Any

EIGHT_BIT_PROBLEM: Final = "it is an 8-bit texture, which has no gradient; load the bitmap with format='variant'"
POSE_ENTRIES: Final = ("to_world", "position")  # of sensors and lights
BLUR_HINT: Final = "; or use PlannedRenderer, which estimates the gradient from images alone"
HANDLE_HINT: Final = (
    "; or give PlannedRenderer a Translate or Rotate of {!r}, whose gradient it estimates from images alone"
)


@dataclass(frozen=True)
class SceneParameter:
    """One entry of ``mi.traverse``.

    Attributes
    ----------
    name : str
        Readable name. An object without an id is named after its kind and number, as in ``sphere_0.to_world``.
    key : str
        Key in ``mi.traverse`` in this process.
    shape : tuple of int
        Shape of its value.
    problem : str
        Why it cannot be fitted and an alternative; empty if it can be fitted.
    settable : bool
        Whether it can be set although it has no gradient, so that a blurred gradient exists.
    """

    name: str
    key: str
    shape: tuple[int, ...]
    problem: str
    settable: bool = True


def list_parameters(scene: dict[str, Any] | str | Path | Scene) -> dict[str, SceneParameter]:
    """List all parameters of a scene by their readable names, in the order of ``mi.traverse``.

    A name refers to the same object however the scene is loaded. Objects without an id are numbered in the order of the
    file, as ``sphere_0``. A scene that you have loaded yourself may have lost that order for its meshes. They are named
    by their position instead, as ``rectangle_at_0_0_-1``; renderers accept both names.

    Parameters
    ----------
    scene : dict, path or mi.Scene
        As for :class:`MitsubaRenderer`.

    Raises
    ------
    SceneLoadError
        If Mitsuba cannot load the scene.
    OptionError
        If `scene` is of another type.
    """
    use_variant()
    return SceneIndex(load_scene(scene)).parameters


def index_scene(scene: dict[str, Any] | str | Path | Scene | LoadedScene, targets: Mapping[str, Any]) -> SceneIndex:
    """Load and index a scene, with float textures if an 8-bit texture is among `targets`."""
    index = SceneIndex(load_scene(scene))
    parameters = [index.get(target) for target in targets.values() if isinstance(target, str)]
    eight_bit = any(parameter is not None and parameter.problem == EIGHT_BIT_PROBLEM for parameter in parameters)
    if eight_bit and isinstance(scene, dict | str | Path):
        return SceneIndex(load_scene(scene, float_textures=True))
    return index


class SceneIndex:
    """The parameters and shapes of a scene by name, for the scene's values at construction.

    Parameters
    ----------
    loaded : LoadedScene

    Attributes
    ----------
    loaded : LoadedScene
    scene : mi.Scene
    parameters : dict of SceneParameter
        By readable name.
    """

    def __init__(self, loaded: LoadedScene) -> None:
        self.loaded = loaded
        self.scene = loaded.scene
        self._params = mi.traverse(loaded.scene)
        self._readable, self._positional = readable_names(self._params, in_order=loaded.in_order)
        self.parameters: dict[str, SceneParameter] = {}
        self._aliases: dict[str, SceneParameter] = {}
        for key in self._params.properties:  # iterating over it directly yields pairs
            folder, _, entry = key.rpartition(".")
            name = f"{self._readable[folder]}.{entry}" if folder else entry
            try:
                shape = _shape(self._params[key])
            except TypeError:  # not set, as the absorption of hair that is given by pigments
                continue
            parameter = SceneParameter(name, key, shape, _problem(self._params, key), _is_settable(self._params, key))
            self.parameters[name] = self._aliases[key] = parameter
            for path, positional in self._positional.items():
                if folder == path or folder.startswith(f"{path}."):
                    self._aliases[f"{positional}{folder[len(path) :]}.{entry}"] = parameter

    def get(self, key: str) -> SceneParameter | None:
        """Return the parameter with that name or key, or None."""
        return self.parameters.get(key) or self._aliases.get(key)

    def find(self, key: str, *, images: bool = False) -> SceneParameter:
        """Return the parameter with that name or key.

        Parameters
        ----------
        key : str
        images : bool
            Accept a parameter without a gradient if it can be set, for blurred gradients.

        Raises
        ------
        ParameterError
            If there is none, or it cannot be fitted.
        """
        parameter = self.get(key)
        if parameter is None:
            usable = [name for name, candidate in self.parameters.items() if not candidate.problem]
            similar = difflib.get_close_matches(key, usable, 3, 0.4)
            options = f"similar: {', '.join(similar)}" if similar else f"it has: {', '.join(usable)}"
            msg = f"the scene has no parameter {key!r}; {options}"
            raise ParameterError(msg)
        if parameter.problem and not (images and parameter.settable):
            hint = BLUR_HINT if parameter.settable and not images else self._handle_hint(parameter)
            msg = f"{key!r} cannot be fitted: {parameter.problem}{hint}"
            raise ParameterError(msg)
        return parameter

    def _handle_hint(self, parameter: SceneParameter) -> str:
        folder, _, entry = parameter.key.rpartition(".")
        movable = entry == "to_world" and _moves_by_images_only(self._params.properties[parameter.key][2])
        return HANDLE_HINT.format(self._readable.get(folder, folder)) if movable else ""

    def moved_shape(self, parameter: SceneParameter) -> Any:
        """Return the shape that a parameter moves, or None."""
        node = self._params.properties[parameter.key][2]
        moves = isinstance(node, mi.Shape) and self._params.flags(parameter.key) & mi.ParamFlags.Discontinuous
        return node if moves else None

    def material_input(self, parameter: SceneParameter) -> tuple[Any, str]:
        """Return the innermost BSDF around a parameter and the input it belongs to; None and "" without a BSDF."""
        nodes, keys = ancestors(self._params, self._params.properties[parameter.key][2]), parameter.key.split(".")
        for node, key in reversed([*zip(nodes, keys, strict=False)]):
            if isinstance(node, mi.BSDF):
                return node, key
        return None, ""

    def positioned_light(self, key: str) -> Any:
        """Return the light whose position is called `key`, or None."""
        parameter = self.get(key)
        if parameter is None or parameter.key.rpartition(".")[2] != "position":
            return None
        node = self._params.properties[parameter.key][2]
        return node if isinstance(node, mi.Emitter) else None

    def find_movable(self, name: str) -> tuple[str, Any]:
        """Return the pose key and the object, as :meth:`find_shape`, also for sensors, instances and delta lights."""
        for key in self._params.properties:
            folder, _, entry = key.rpartition(".")
            node = self._params.properties[key][2]
            if entry not in POSE_ENTRIES or not _moves_by_images_only(node):
                continue
            if name in (folder, self._readable.get(folder)):
                return key, node
        return self.find_shape(name)

    def find_shape(self, name: str) -> tuple[str, Any]:
        """Return the pose key of the shape with that name or id, and the shape.

        Returns
        -------
        key : str
            Key of its ``vertex_positions`` or ``to_world``.
        shape : mi.Shape

        Raises
        ------
        ParameterError
            If there is none, or it cannot be moved.
        """
        movable = []
        for key in self._params.properties:
            folder, _, entry = key.rpartition(".")
            node = self._params.properties[key][2]
            matches = name in (folder, self._readable.get(folder), self._positional.get(folder))
            if isinstance(node, mi.Shape) and entry in ("vertex_positions", "to_world"):
                problem = _problem(self._params, key)
                if matches and not problem:
                    return key, node
                if matches:
                    msg = f"{name!r} cannot be moved: {INSTANCE_PROBLEM + BLUR_HINT if is_instance(node) else problem}"
                    raise ParameterError(msg)
                if not problem:
                    movable.append(self._readable[folder])
            elif folder and matches and isinstance(node, mi.Sensor | mi.Emitter):
                has_pose = any(f"{folder}.{pose}" in self._params.properties for pose in POSE_ENTRIES)
                problem = f"{_immovable(node)}{BLUR_HINT}" if has_pose else f"a {node.class_name()} has no position"
                msg = f"{name!r} cannot be moved: {problem}"
                raise ParameterError(msg)
        names = ", ".join(dict.fromkeys(movable)) or "none"
        msg = f"the scene has no shape {name!r} that can be moved; it has: {names}"
        raise ParameterError(msg)


def matrix_or_value(value: Any) -> Any:
    """Return the matrix of a transform, or any other value unchanged."""
    # By type: an array of Dr.Jit has an attribute of nearly any name, which picks components.
    return value.matrix if isinstance(value, mi.Transform4f) else value


def _moves_by_images_only(node: Any) -> bool:
    """Return whether moving an object has no gradient in Mitsuba: a sensor, an instance, or a light."""
    return isinstance(node, mi.Sensor | mi.Emitter) or is_instance(node)


def _shape(value: Any) -> tuple[int, ...]:
    value = matrix_or_value(value)
    shape = np.array(value).shape
    # Dr.Jit's last axis runs over a whole wavefront; a uniform value has just one entry there.
    is_wavefront = dr.is_jit_v(value) and not dr.is_tensor_v(value)
    return shape[:-1] if is_wavefront and shape[-1:] == (1,) else shape


def _problem(params: SceneParameters, key: str) -> str:
    flags, node, value = params.flags(key), params.properties[key][2], params[key]
    if any(map(is_merged, ancestors(params, node))):
        return "Mitsuba has merged several meshes into it; give the renderer the path, or load with optimize=False"
    sensors = [ancestor for ancestor in ancestors(params, node) if isinstance(ancestor, mi.Sensor)]
    if sensors:
        return _immovable(sensors[-1])
    array = matrix_or_value(value)
    if dr.is_tensor_v(array) and not dr.is_float_v(array):
        return EIGHT_BIT_PROBLEM
    if (flags & mi.ParamFlags.NonDifferentiable) or (flags & mi.ParamFlags.ReadOnly):
        if isinstance(node, mi.Emitter) and key.rpartition(".")[2] in ("position", "to_world"):
            return _immovable(node)
        return "Mitsuba gives no gradient for it"
    return "" if dr.is_diff_v(array) and dr.is_float_v(array) else "it is not a floating-point array of Dr.Jit"


def _is_settable(params: SceneParameters, key: str) -> bool:
    """Return whether any value may be set. Not so for a matrix: blurring its elements leaves the rigid transforms."""
    value = params[key]
    if params.flags(key) & mi.ParamFlags.ReadOnly or any(map(is_merged, ancestors(params, params.properties[key][2]))):
        return False
    return isinstance(value, float) or bool(dr.is_diff_v(value) and dr.is_float_v(value))


def _immovable(node: Any) -> str:
    if isinstance(node, mi.Sensor):
        return "Mitsuba gives no gradient for sensors; move the scene instead"
    class_name = node.class_name()
    return f"Mitsuba's gradient for moving a {class_name} is missing or wrong; use a small sphere with an area emitter"

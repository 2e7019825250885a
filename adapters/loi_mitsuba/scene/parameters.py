"""What a scene can be fitted by: every entry of ``mi.traverse``, under a name that is the same in every process."""

from __future__ import annotations

import difflib
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core.errors import ParameterError
from loi_mitsuba.geometry.bounds import bounding_box
from loi_mitsuba.scene.load import LoadedScene, load_scene, load_with_float_textures, use_variant

__all__ = [
    "INSTANCE",
    "Scene",
    "SceneIndex",
    "SceneParameter",
    "ancestors",
    "index_scene",
    "is_instance",
    "list_parameters",
    "numbers",
]

Scene: TypeAlias = Any
SceneParameters: TypeAlias = Any

EIGHT_BITS: Final = "it is an 8-bit texture, which has no gradient; load the bitmap with format='variant'"
INSTANCE: Final = "it moves an instance of a shapegroup, by which Mitsuba has no gradient"
PLACING: Final = ("to_world", "position")  # what places a sensor or a light
BY_IMAGES: Final = "; or leave it to PlannedRenderer, which finds it by images alone"
BY_HANDLE: Final = "; or give PlannedRenderer a Translate or Rotate of {!r}, which it finds by images alone"
_ADDRESS = re.compile(r"object_\d+(_\d+)?")
_WORD = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


@dataclass(frozen=True)
class SceneParameter:
    """One entry of a scene.

    Attributes
    ----------
    name : str
        Readable: an object without an id is called by its kind and order, as in ``sphere_0.to_world``.
    key : str
        What ``mi.traverse`` calls it in this process.
    shape : tuple of int
        Of its value.
    problem : str
        Why it cannot be fitted, and what to do instead; empty if it can.
    settable : bool
        Whether it can be set all the same, so that images tell of it.
    """

    name: str
    key: str
    shape: tuple[int, ...]
    problem: str
    settable: bool = True


def list_parameters(scene: dict[str, Any] | str | Path | Scene) -> dict[str, SceneParameter]:
    """Every entry of a scene by its readable name, in the order of ``mi.traverse``.

    A name means one object however the scene was loaded. Objects without an id are numbered in the file's order, as
    ``sphere_0``. A scene that you have loaded yourself may not have kept that order of its meshes, so those are called
    by where they stand, as ``rectangle_at_0_0_-1``; renderers know both names.

    Parameters
    ----------
    scene : dict, path or mi.Scene
        As that of :class:`MitsubaRenderer`.

    Raises
    ------
    SceneLoadError
        If Mitsuba cannot load the scene.
    OptionError
        If it is none.
    """
    use_variant()
    return SceneIndex(load_scene(scene)).entries


def index_scene(scene: dict[str, Any] | str | Path | Scene | LoadedScene, targets: Mapping[str, Any]) -> SceneIndex:
    """A scene, loaded so that the entries among `targets` have a gradient if that is a matter of how it is loaded."""
    names = SceneIndex(load_scene(scene))
    wanted = [names.known(target) for target in targets.values() if isinstance(target, str)]
    if any(one is not None and one.problem == EIGHT_BITS for one in wanted) and isinstance(scene, dict | str | Path):
        return SceneIndex(load_with_float_textures(scene))
    return names


class SceneIndex:
    """What the entries and shapes of a scene are called, as it stands when this is made.

    Parameters
    ----------
    loaded : LoadedScene

    Attributes
    ----------
    loaded : LoadedScene
    scene : mi.Scene
    entries : dict of SceneParameter
        By readable name.
    """

    def __init__(self, loaded: LoadedScene) -> None:
        self.loaded = loaded
        self.scene = loaded.scene
        self._params = mi.traverse(loaded.scene)
        self._readable, places = _readable(self._params, in_order=loaded.in_order)
        self.entries: dict[str, SceneParameter] = {}
        self._also: dict[str, SceneParameter] = {}
        for key in self._params.properties:  # iterating over it itself yields pairs
            folder, _, last = key.rpartition(".")
            name = f"{self._readable[folder]}.{last}" if folder else last
            try:
                shape = _shape(self._params[key])
            except TypeError:  # it is not set, as is what absorbs light in hair that has pigments
                continue
            entry = SceneParameter(name, key, shape, _problem(self._params, key), _settable(self._params, key))
            self.entries[name] = self._also[key] = entry
            for own, place in places.items():
                if folder == own or folder.startswith(f"{own}."):
                    self._also[f"{place}{folder[len(own) :]}.{last}"] = entry
        self._places = places

    def known(self, key: str) -> SceneParameter | None:
        """The entry of that name or key, if there is one."""
        return self.entries.get(key) or self._also.get(key)

    def find(self, key: str, *, images: bool = False) -> SceneParameter:
        """The entry of that name or key; with `images`, it need not have a gradient.

        Raises
        ------
        ParameterError
            If there is none, or it cannot be fitted.
        """
        entry = self.known(key)
        if entry is None:
            usable = [name for name, one in self.entries.items() if not one.problem]
            near = difflib.get_close_matches(key, usable, 3, 0.4) or usable
            msg = f"the scene has no entry {key!r}; {'near' if near != usable else 'it has'}: {', '.join(near)}"
            raise ParameterError(msg)
        if entry.problem and not (images and entry.settable):
            otherwise = BY_IMAGES if entry.settable and not images else self._by_handle(entry)
            msg = f"{key!r} cannot be fitted: {entry.problem}{otherwise}"
            raise ParameterError(msg)
        return entry

    def _by_handle(self, entry: SceneParameter) -> str:
        """How else what an entry moves can be moved; empty if not."""
        folder, _, last = entry.key.rpartition(".")
        node = self._params.properties[entry.key][2]
        movable = last == "to_world" and _is_placed(node)
        return BY_HANDLE.format(self._readable.get(folder, folder)) if movable else ""

    def moved_by(self, entry: SceneParameter) -> Any:
        """The shape that an entry moves; None if it moves none."""
        node = self._params.properties[entry.key][2]
        moves = isinstance(node, mi.Shape) and self._params.flags(entry.key) & mi.ParamFlags.Discontinuous
        return node if moves else None

    def part_of_material(self, entry: SceneParameter) -> tuple[Any, str]:
        """The material nearest to an entry, and which of its inputs the entry belongs to; None and "" without."""
        nodes, parts = ancestors(self._params, self._params.properties[entry.key][2]), entry.key.split(".")
        for node, part in reversed([*zip(nodes, parts, strict=False)]):
            if isinstance(node, mi.BSDF):
                return node, part
        return None, ""

    def placed_by(self, key: str) -> Any:
        """The light whose position the entry of that name or key is; None if it is no light's."""
        entry = self.known(key)
        if entry is None or entry.key.rpartition(".")[2] != "position":
            return None
        node = self._params.properties[entry.key][2]
        return node if isinstance(node, mi.Emitter) else None

    def find_movable(self, name: str) -> tuple[str, Any]:
        """As :meth:`find_shape`, and of sensors, instances and lights without a surface, which have no gradient."""
        for key in self._params.properties:
            folder, _, last = key.rpartition(".")
            node = self._params.properties[key][2]
            if last not in PLACING or not _is_placed(node):
                continue
            if name in (folder, self._readable.get(folder)):
                return key, node
        return self.find_shape(name)

    def find_shape(self, name: str) -> tuple[str, Any]:
        """The key of what places the shape of that name or id, and the shape.

        Returns
        -------
        key : str
            Of its ``vertex_positions`` or ``to_world``.
        shape : mi.Shape

        Raises
        ------
        ParameterError
            If there is none, or it cannot be moved.
        """
        shapes = []
        for key in self._params.properties:
            folder, _, last = key.rpartition(".")
            node = self._params.properties[key][2]
            called = (folder, self._readable.get(folder), self._places.get(folder))
            if isinstance(node, mi.Shape) and last in ("vertex_positions", "to_world"):
                problem = _problem(self._params, key)
                if name in called and not problem:
                    return key, node
                if name in called and is_instance(node):
                    msg = f"{name!r} cannot be moved: {INSTANCE}{BY_IMAGES}"
                    raise ParameterError(msg)
                if name in called and problem:
                    msg = f"{name!r} cannot be moved: {problem}"
                    raise ParameterError(msg)
                if not problem:
                    shapes.append(self._readable[folder])
            elif folder and name in called and isinstance(node, mi.Sensor | mi.Emitter):
                placed = any(f"{folder}.{last}" in self._params.properties for last in PLACING)
                problem = f"{_fixed(node)}{BY_IMAGES}" if placed else f"a {node.class_name()} is at no place"
                msg = f"{name!r} cannot be moved: {problem}"
                raise ParameterError(msg)
        msg = f"the scene has no shape {name!r} that can be moved; it has: {', '.join(dict.fromkeys(shapes)) or 'none'}"
        raise ParameterError(msg)


def numbers(value: Any) -> Any:
    """The matrix of a transform, or `value` as it is."""
    # By type: an array of Dr.Jit has an attribute of nearly any name, which picks components.
    return value.matrix if isinstance(value, mi.Transform4f) else value


def _readable(params: SceneParameters, *, in_order: bool) -> tuple[dict[str, str], dict[str, str]]:
    """Readable names of the objects that entries belong to, by their keys, and those by place of meshes without an id.

    Where meshes may have been merged or moved, numbers would mean other ones than in the file.
    """
    names: dict[str, str] = {}
    counts: defaultdict[str, int] = defaultdict(int)
    taken = {part for key in params.properties for part in key.split(".")}
    places = _places(params)
    unsafe = set() if in_order else _unsafe(params, places)
    for key in params.properties:
        parts = key.split(".")[:-1]
        nodes = ancestors(params, params.properties[key][2])
        for depth in range(1, len(parts) + 1):
            path, above = ".".join(parts[:depth]), names.get(".".join(parts[: depth - 1]), "")
            if path in names:
                continue
            part = parts[depth - 1]
            node = nodes[depth] if len(nodes) == len(parts) + 1 else None
            if path in unsafe:
                part = places[path]
            elif node is not None and not node.id() and _ADDRESS.fullmatch(part):
                kind = _kind_of(node)
                while (part := f"{kind}_{counts[kind]}") in taken:
                    counts[kind] += 1
                counts[kind] += 1
            names[path] = f"{above}.{part}" if above else part
    return names, places


def _places(params: SceneParameters) -> dict[str, str]:
    """By key, a name for each mesh without an id that says where it stands, and if others do too, how large it is."""
    found: dict[str, str] = {}
    sizes: dict[str, str] = {}
    for key in params.properties:
        folder, _, last = key.rpartition(".")
        node = params.properties[key][2]
        if last in ("vertex_positions", "to_world") and isinstance(node, mi.Mesh) and not node.id():
            if _is_merged(node):
                found[folder] = "merged_meshes"
                continue
            found[folder] = f"{_kind_of(node)}_at_{_numbers(bounding_box(node).mean(axis=0))}"
            sizes[folder] = f"_size_{_numbers(np.ptp(bounding_box(node), axis=0))}"
    named = list(found.values())
    found = {key: name + sizes.get(key, "") if named.count(name) > 1 else name for key, name in found.items()}
    named = list(found.values())
    numbered = {name: iter(range(len(named))) for name in named}
    # Nothing that is known here says which is which of meshes of one size in one place.
    return {key: f"{name}_{next(numbered[name])}" if named.count(name) > 1 else name for key, name in found.items()}


def _numbers(values: Any) -> str:
    """Coordinates as part of a name; what is 0 but for rounding is 0."""
    return "_".join(f"{one:.5g}" for one in np.where(np.abs(values) < 1e-5, 0.0, values))


def _unsafe(params: SceneParameters, places: Mapping[str, str]) -> set[str]:
    """The meshes whose number may not be that of the file: all but the only one of their kind, if none were merged."""
    nodes = {params.properties[key][2]: key.rpartition(".")[0] for key in params.properties}
    meshes = {folder: node for node, folder in nodes.items() if folder in places}
    kinds = [_kind_of(node) for node in meshes.values()]
    merged = any(map(_is_merged, meshes.values()))
    return {folder for folder, node in meshes.items() if merged or kinds.count(_kind_of(node)) > 1}


def _kind_of(node: Any) -> str:
    return _WORD.sub("_", node.class_name()).lower()


def _is_merged(node: Any) -> bool:
    """Whether Mitsuba has made one mesh of several; it then joins their names."""
    if not isinstance(node, mi.Mesh) or node.class_name() != "Mesh" or node.id():
        return False
    return " + " in str(node).partition("bbox")[0]


def is_instance(node: Any) -> bool:
    """Whether an object is an instance of a shapegroup."""
    return isinstance(node, mi.Shape) and node.class_name() == "Instance"


def _is_placed(node: Any) -> bool:
    """Whether an object is moved by images alone: a sensor, an instance, or a light."""
    return isinstance(node, mi.Sensor | mi.Emitter) or is_instance(node)


def ancestors(params: SceneParameters, node: Any) -> list[Any]:
    """The objects from the scene down to `node`."""
    chain = []
    while node is not None:
        chain.append(node)
        node = params.hierarchy[node][0]
    return chain[::-1]


def _shape(value: Any) -> tuple[int, ...]:
    value = numbers(value)
    shape = np.array(value).shape
    # Dr.Jit's last axis runs over a whole wavefront; a uniform value has just one entry there.
    flat = dr.is_jit_v(value) and not dr.is_tensor_v(value)
    return shape[:-1] if flat and shape[-1:] == (1,) else shape


def _problem(params: SceneParameters, key: str) -> str:
    flags, node, value = params.flags(key), params.properties[key][2], params[key]
    if any(map(_is_merged, ancestors(params, node))):
        return "Mitsuba has merged several meshes into it; give the renderer the path, or load with optimize=False"
    owners = [one for one in ancestors(params, node) if isinstance(one, mi.Sensor)]
    if owners:
        return _fixed(owners[-1])
    plain = numbers(value)
    if dr.is_tensor_v(plain) and not dr.is_float_v(plain):
        return EIGHT_BITS
    if (flags & mi.ParamFlags.NonDifferentiable) or (flags & mi.ParamFlags.ReadOnly):
        if isinstance(node, mi.Emitter) and key.rpartition(".")[2] in ("position", "to_world"):
            return _fixed(node)
        return "Mitsuba gives no gradient for it"
    return "" if dr.is_diff_v(plain) and dr.is_float_v(plain) else "it is not a floating-point array of Dr.Jit"


def _settable(params: SceneParameters, key: str) -> bool:
    """Whether blurred values of an entry are values of it. Those of a matrix are not: a handle turns and moves it."""
    value = params[key]
    if params.flags(key) & mi.ParamFlags.ReadOnly or any(map(_is_merged, ancestors(params, params.properties[key][2]))):
        return False
    return isinstance(value, float) or bool(dr.is_diff_v(value) and dr.is_float_v(value))


def _fixed(node: Any) -> str:
    if isinstance(node, mi.Sensor):
        return "Mitsuba gives no gradient for sensors; move the scene instead"
    kind = node.class_name()
    return f"Mitsuba's gradient for moving a {kind} is missing or wrong; use a small sphere with an area emitter"

"""What a scene can be fitted by: every entry of ``mi.traverse``, under a name that is the same in every process."""

from __future__ import annotations

import difflib
import re
from collections import defaultdict
from dataclasses import dataclass
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core.errors import OptionError, ParameterError
from loi_core.support.wording import shown

__all__ = ["Entry", "Scene", "ancestors", "find_entry", "find_shape", "list_entries", "numbers"]

Scene: TypeAlias = Any
SceneParameters: TypeAlias = Any

_ADDRESS = re.compile(r"object_\d+(_\d+)?")
_WORD = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


@dataclass(frozen=True)
class Entry:
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
    """

    name: str
    key: str
    shape: tuple[int, ...]
    problem: str


def list_entries(scene: Scene) -> dict[str, Entry]:
    """Every entry of a scene by its readable name, in the order of ``mi.traverse``.

    Raises
    ------
    OptionError
        If it is not a scene that Mitsuba has loaded.
    """
    if not isinstance(scene, mi.Object):
        msg = f"`scene` must be loaded, as by mi.load_file(path) or mi.load_dict(scene), got {shown(scene)}"
        raise OptionError(msg)
    params = mi.traverse(scene)
    readable = _readable(params)
    listed = {}
    for key in params.properties:  # iterating over `params` itself yields pairs
        folder, _, last = key.rpartition(".")
        name = f"{readable[folder]}.{last}" if folder else last
        listed[name] = Entry(name, key, _shape(params[key]), _problem(params, key))
    return listed


def find_entry(entries: dict[str, Entry], key: str) -> Entry:
    """The entry of that readable name or key, once it is known that it can be fitted."""
    entry = entries.get(key) or next((one for one in entries.values() if one.key == key), None)
    if entry is None:
        usable = [name for name, one in entries.items() if not one.problem]
        near = difflib.get_close_matches(key, usable, 3, 0.4) or usable
        msg = f"the scene has no entry {key!r}; {'near' if near != usable else 'it has'}: {', '.join(near)}"
        raise ParameterError(msg)
    if entry.problem:
        msg = f"{key!r} cannot be fitted: {entry.problem}"
        raise ParameterError(msg)
    return entry


def find_shape(scene: Scene, name: str) -> tuple[str, Any]:
    """The key of what places the shape of that readable name or id, and the shape.

    Returns
    -------
    key : str
        Of its ``vertex_positions`` or ``to_world``.
    shape : mi.Shape
    """
    params = mi.traverse(scene)
    readable = _readable(params)
    shapes = []
    for key in params.properties:
        folder, _, last = key.rpartition(".")
        node = params.properties[key][2]
        if isinstance(node, mi.Shape) and last in ("vertex_positions", "to_world"):
            if name in (folder, readable[folder]) and not _problem(params, key):
                return key, node
            shapes.append(readable[folder])
        elif folder and name in (folder, readable[folder]) and isinstance(node, mi.Sensor | mi.Emitter):
            msg = f"{name!r} cannot be moved: {_fixed(node)}"
            raise ParameterError(msg)
    msg = f"the scene has no shape {name!r} that can be moved; it has: {', '.join(dict.fromkeys(shapes)) or 'none'}"
    raise ParameterError(msg)


def numbers(value: Any) -> Any:
    """The matrix of a transform, or `value` as it is."""
    # By type: an array of Dr.Jit has an attribute of nearly any name, which picks components.
    return value.matrix if isinstance(value, mi.Transform4f) else value


def _readable(params: SceneParameters) -> dict[str, str]:
    """Readable names of the objects that entries belong to, by their keys."""
    names: dict[str, str] = {}
    counts: defaultdict[str, int] = defaultdict(int)
    taken = {part for key in params.properties for part in key.split(".")}
    for key in params.properties:
        parts = key.split(".")[:-1]
        nodes = ancestors(params, params.properties[key][2])
        for depth in range(1, len(parts) + 1):
            path, above = ".".join(parts[:depth]), names.get(".".join(parts[: depth - 1]), "")
            if path in names:
                continue
            part = parts[depth - 1]
            node = nodes[depth] if len(nodes) == len(parts) + 1 else None
            if node is not None and not node.id() and _ADDRESS.fullmatch(part):
                kind = _WORD.sub("_", node.class_name()).lower()
                while (part := f"{kind}_{counts[kind]}") in taken:
                    counts[kind] += 1
                counts[kind] += 1
            names[path] = f"{above}.{part}" if above else part
    return names


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
    owners = [one for one in ancestors(params, node) if isinstance(one, mi.Sensor)]
    if owners:
        return _fixed(owners[-1])
    plain = numbers(value)
    if dr.is_tensor_v(plain) and not dr.is_float_v(plain):
        return "it is an 8-bit texture, which has no gradient; load the bitmap with format='variant'"
    if (flags & mi.ParamFlags.NonDifferentiable) or (flags & mi.ParamFlags.ReadOnly):
        if isinstance(node, mi.Emitter) and key.rpartition(".")[2] in ("position", "to_world"):
            return _fixed(node)
        return "Mitsuba gives no gradient for it"
    return "" if dr.is_diff_v(plain) and dr.is_float_v(plain) else "it is not a floating-point array of Dr.Jit"


def _fixed(node: Any) -> str:
    if isinstance(node, mi.Sensor):
        return "Mitsuba gives no gradient for sensors; move the scene instead"
    kind = node.class_name()
    return f"Mitsuba's gradient for moving a {kind} is missing or wrong; use a small sphere with an area emitter"

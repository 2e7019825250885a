"""Named parameters in a scene: where each is found, how it is set, and what it starts from."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core.errors import ParameterError
from loi_core.support.wording import shown
from loi_mitsuba.drjit.arrays import Float32Array, aligned_copy
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import SceneIndex, numbers
from loi_mitsuba.scene.poses import Scale, posed

__all__ = ["ParameterBinding", "as_host", "host_numbers"]

NORMALS: Final = "vertex_normals"
SAME: Final = 1e-3  # between unit normals that are one but for rounding


@dataclass(frozen=True)
class _Posed:
    """A shape that handles move."""

    key: str
    names: tuple[str, ...]
    centre: tuple[float, float, float]
    start: Any  # vertex positions as a Point3f, or the transform
    normals: Any = None  # of the vertices, as a Normal3f, where they are not those that Mitsuba would compute


class ParameterBinding:
    """The parameters of a renderer, by their names, as entries of a scene and poses of its shapes.

    Parameters
    ----------
    called : SceneIndex
        Of a scene; its values at this moment are those that the parameters start from.
    targets : dict of str or handle
        What each parameter stands for.
    without_gradient : names, optional
        Parameters that need not have a gradient.

    Attributes
    ----------
    entries : mi.SceneParameters
        What the scene can be set by.
    targets : dict
        As given.
    start : dict of arrays, float32
        Values at the start.

    Raises
    ------
    ParameterError
        If a target is not there, has no gradient, or sets what another sets.
    """

    def __init__(
        self, called: SceneIndex, targets: Mapping[str, ParameterTarget], without_gradient: Iterable[str] = ()
    ) -> None:
        self.entries = mi.traverse(called.scene)
        self.targets = dict(targets)
        self.start: dict[str, Float32Array] = {}
        self._keys: dict[str, str] = {}
        self._posed: list[_Posed] = []
        by_shape: defaultdict[str, list[str]] = defaultdict(list)
        nodes: dict[str, Any] = {}
        images = frozenset(without_gradient)
        for name, target in targets.items():
            if isinstance(target, str):
                entry = called.find(target, images=name in images)
                self._keys[name] = entry.key
                self.start[name] = as_host(numbers(self.entries[entry.key]), entry.shape)
            else:
                key, node = (called.find_movable if name in images else called.find_shape)(target.shape)
                by_shape[key].append(name)
                nodes[key] = node
                self.start[name] = target.initial().astype(np.float32)
        normals = self._own_normals(nodes)
        for key, names in by_shape.items():
            value = self.entries[key]
            start = value if isinstance(value, mi.Transform4f | mi.Point3f) else dr.unravel(mi.Point3f, value)
            centre = _centre(nodes[key], start)
            self._posed.append(_Posed(key, tuple(names), centre, dr.detach(start), normals.get(key)))
        used = [*self._keys.values(), *by_shape]
        for key in used:
            if used.count(key) > 1:
                names = [name for name in targets if self._keys.get(name) == key or name in by_shape.get(key, ())]
                msg = f"`parameters` must not set one entry twice, got {', '.join(map(repr, names))}"
                raise ParameterError(msg)

    def moving(self, names: Iterable[str] | None = None) -> list[Any]:
        """The shapes that the parameters move, or some of them, as often as they do."""
        wanted = set(self.targets if names is None else names)
        keys = [key for name, key in self._keys.items() if name in wanted]
        keys += [one.key for one in self._posed if wanted & set(one.names)]
        # A shape has entries that do not move it, such as the colours of its vertices.
        keys = [key for key in keys if self.entries.flags(key) & mi.ParamFlags.Discontinuous]
        nodes = [self.entries.properties[key][2] for key in keys]
        return [node for node in nodes if isinstance(node, mi.Shape)]

    def leaves(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """`params`, checked, as flat arrays of Dr.Jit.

        Raises
        ------
        ParameterError
            If they have not exactly the names, shapes, and finite values.
        """
        if set(params) != set(self.start):
            msg = f"`params` must have exactly the names {sorted(self.start)}, got {sorted(params)}"
            raise ParameterError(msg)
        leaves = {}
        for name, start in self.start.items():
            value = host_numbers(name, params[name], start.shape)
            if isinstance(self.targets[name], Scale) and value <= 0:
                msg = f"`{name}` scales a shape and must be more than 0, got {float(value):g}"
                raise ParameterError(msg)
            leaves[name] = mi.Float(aligned_copy(value.reshape(-1)))
        return leaves

    @contextmanager
    def attached(
        self, params: Mapping[str, Any], wanted: Collection[str], *, settled: bool = False
    ) -> Iterator[dict[str, Any]]:
        """`params` in the scene, and their leaves, of which those that are `wanted` have a gradient meanwhile.

        No graph is left behind in the scene, also where Mitsuba fails; errors as of :meth:`leaves`.

        Parameters
        ----------
        params : mapping of arrays
        wanted : names
        settled : bool
            Whether the scene has these `params` already, so that only what is wanted is to be set.
        """
        leaves = self.leaves(params)
        try:
            with dr.resume_grad():  # the caller may have suspended gradients
                dr.enable_grad([leaves[name] for name in wanted])
                self.set(leaves, wanted if settled else None)
                yield leaves
        finally:
            self.set(self.leaves(params), wanted)

    def gradients(self, leaves: Mapping[str, Any], names: Iterable[str]) -> dict[str, Float32Array]:
        """What has arrived at leaves, in the shapes of their parameters."""
        return {name: as_host(dr.grad(leaves[name]), self.start[name].shape) for name in names}

    def set(self, leaves: Mapping[str, Any], names: Collection[str] | None = None) -> None:
        """Put values into the scene: all, so that none is left from the call before, or what some of them set."""
        for name, key in self._keys.items():
            if names is None or name in names:
                self.entries[key] = _like(self.entries[key], leaves[name], self.start[name].shape)
        for one in self._posed:
            if names is not None and not any(name in names for name in one.names):
                continue
            handles = [(self.targets[name], leaves[name]) for name in one.names]
            pose = posed(handles, one.centre)  # type: ignore[arg-type]  # handles, all of them
            moved = pose @ one.start
            flat = isinstance(moved, mi.Point3f) and not isinstance(self.entries[one.key], mi.Point3f)
            self.entries[one.key] = dr.ravel(moved) if flat else moved
            if one.normals is not None:
                turned = dr.normalize(pose @ one.normals)
                self.entries[_beside(one.key, NORMALS)] = dr.ravel(turned)
        self.entries.update()

    def _own_normals(self, nodes: Mapping[str, Any]) -> dict[str, Any]:
        """By key, normals of meshes that are not what Mitsuba computes when vertices are set."""
        given = {
            key: as_host(self.entries[_beside(key, NORMALS)], (-1, 3))
            for key, node in nodes.items()
            if isinstance(node, mi.Mesh) and not node.has_face_normals() and _beside(key, NORMALS) in self.entries
        }
        given = {key: own for key, own in given.items() if len(own)}
        for key in given:
            self.entries.set_dirty(key)
        self.entries.update()
        found = {}
        for key, own in given.items():
            beside = _beside(key, NORMALS)
            if np.max(np.abs(as_host(self.entries[beside], (-1, 3)) - own)) >= SAME:
                self.entries[beside] = mi.Float(aligned_copy(own.reshape(-1)))
                found[key] = mi.Normal3f(*(mi.Float(aligned_copy(each)) for each in own.T))
        self.entries.update()
        return found


def _beside(key: str, entry: str) -> str:
    """The key of another entry of the same shape."""
    return f"{key.rpartition('.')[0]}.{entry}"


def _centre(node: Any, start: Any) -> tuple[float, float, float]:
    """What an object turns about: the middle of a shape's box, the place of anything else."""
    if isinstance(node, mi.Shape):
        place = node.bbox().center()
    else:
        place = start @ mi.Point3f(0.0) if isinstance(start, mi.Transform4f) else start
    x, y, z = np.array(place, dtype=np.float64).reshape(3).tolist()
    return x, y, z


def host_numbers(name: str, value: Any, shape: tuple[int, ...]) -> Float32Array:
    """`value` as a new float32 array, once it is known to be finite numbers of `shape`."""
    try:
        with np.errstate(over="ignore"):  # what is too large for float32 becomes infinite
            array = np.array(value, dtype=np.float32, order="C")
    except (TypeError, ValueError):
        msg = f"`{name}` must be numbers of shape {shape}, got {shown(value)}"
        raise ParameterError(msg) from None
    if array.shape != shape:
        msg = f"`{name}` must have shape {shape}, got {array.shape}"
        raise ParameterError(msg)
    if not np.all(np.isfinite(array)):
        msg = f"`{name}` must be finite, got {int((~np.isfinite(array)).sum())} values that are not"
        raise ParameterError(msg)
    return array


def as_host(value: Any, shape: tuple[int, ...]) -> Float32Array:
    """An array of Dr.Jit as float32 of `shape`, in C order."""
    return np.array(value, dtype=np.float32, order="C").reshape(shape)


def _like(current: Any, flat: Any, shape: tuple[int, ...]) -> Any:
    """The flat array `flat`, in C order of `shape`, as a value of the type of `current`."""
    if isinstance(current, float):
        return float(flat[0])
    if dr.is_tensor_v(current):
        return type(current)(flat, shape=shape)
    if isinstance(current, mi.Transform4f):
        # By gathering: an entry of a flat array, as `flat[3]`, is a plain number without a gradient.
        rows = [[dr.gather(type(flat), flat, 4 * row + column) for column in range(4)] for row in range(4)]
        return mi.Transform4f(mi.Matrix4f(rows))
    return type(current)(flat) if dr.depth_v(current) == 1 else dr.unravel(type(current), flat, order="C")

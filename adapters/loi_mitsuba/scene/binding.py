"""Bind the named parameters of a renderer to a scene: their targets, their initial values, and how they are set."""

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
from loi_core.renderers.validation import check_floats, check_parameters
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import SceneIndex, matrix_or_value
from loi_mitsuba.scene.poses import Scale, combined_transform
from mitsuba_boundaries.drjit.arrays import Float32Array, aligned_copy, as_host, converted

__all__ = ["ParameterBinding", "host_numbers"]

NORMALS: Final = "vertex_normals"
NORMAL_TOLERANCE: Final = 1e-3  # between unit normals that are equal up to rounding


@dataclass(frozen=True)
class _PosedShape:
    """A shape that handles move."""

    key: str
    names: tuple[str, ...]
    centre: tuple[float, float, float]
    start: Any  # vertex positions as a Point3f, or the transform
    normals: Any = None  # vertex normals as a Normal3f, where they differ from those that Mitsuba computes


class ParameterBinding:
    """The parameters of a renderer, bound to entries of a scene and to poses of its shapes.

    Parameters
    ----------
    index : SceneIndex
        Index of the scene; the scene's current values are the initial values.
    targets : dict of str or handle
        ParameterTarget of each parameter.
    without_gradient : names, optional
        Parameters that need no gradient.

    Attributes
    ----------
    entries : mi.SceneParameters
        All parameters of the scene.
    targets : dict
        As given.
    start : dict of arrays, float32
        Initial values.

    Raises
    ------
    ParameterError
        If a target does not exist, has no gradient, or is set by two parameters.
    """

    def __init__(
        self, index: SceneIndex, targets: Mapping[str, ParameterTarget], without_gradient: Iterable[str] = ()
    ) -> None:
        self.entries = mi.traverse(index.scene)
        self.targets = dict(targets)
        self.start: dict[str, Float32Array] = {}
        self._keys: dict[str, str] = {}
        self._posed: list[_PosedShape] = []
        names_by_shape: defaultdict[str, list[str]] = defaultdict(list)
        nodes: dict[str, Any] = {}
        images = frozenset(without_gradient)
        for name, target in targets.items():
            if isinstance(target, str):
                parameter = index.find(target, images=name in images)
                self._keys[name] = parameter.key
                self.start[name] = as_host(matrix_or_value(self.entries[parameter.key]), parameter.shape)
            else:
                key, node = (index.find_movable if name in images else index.find_shape)(target.shape)
                names_by_shape[key].append(name)
                nodes[key] = node
                self.start[name] = target.initial().astype(np.float32)
        normals = self._authored_normals(nodes)
        for key, names in names_by_shape.items():
            value = self.entries[key]
            start = value if isinstance(value, mi.Transform4f | mi.Point3f) else dr.unravel(mi.Point3f, value)
            centre = _pivot(nodes[key], start)
            self._posed.append(_PosedShape(key, tuple(names), centre, dr.detach(start), normals.get(key)))
        keys = [*self._keys.values(), *names_by_shape]
        for key in keys:
            if keys.count(key) > 1:
                names = [name for name in targets if self._keys.get(name) == key or name in names_by_shape.get(key, ())]
                msg = f"`parameters` must not set one entry twice, got {', '.join(map(repr, names))}"
                raise ParameterError(msg)

    def moving(self, names: Iterable[str] | None = None) -> list[Any]:
        """Return the shapes that all or some of the parameters move; a shape is listed once for each key."""
        selected = set(self.targets if names is None else names)
        keys = [key for name, key in self._keys.items() if name in selected]
        keys += [posed.key for posed in self._posed if selected & set(posed.names)]
        # A shape has entries that do not move it, such as the colours of its vertices.
        keys = [key for key in keys if self.entries.flags(key) & mi.ParamFlags.Discontinuous]
        nodes = [self.entries.properties[key][2] for key in keys]
        return [node for node in nodes if isinstance(node, mi.Shape)]

    def leaves(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Check `params` and return them as flat arrays of Dr.Jit.

        Raises
        ------
        ParameterError
            If they have not exactly the names and shapes of the parameters, or values that are not finite.
        """
        leaves = {}
        for name, number in check_parameters(params, self.start).items():
            value = host_numbers(name, number, number.shape)
            if isinstance(self.targets[name], Scale) and value <= 0:
                msg = f"`{name}` scales a shape and must be more than 0, got {float(value):g}"
                raise ParameterError(msg)
            leaves[name] = mi.Float(aligned_copy(value.reshape(-1)))
        return leaves

    @contextmanager
    def attached(self, params: Mapping[str, Any], wrt: Collection[str]) -> Iterator[dict[str, Any]]:
        """Set `params` in the scene with gradients enabled for `wrt`, and yield their leaves.

        On exit no graph is left in the scene, even if Mitsuba raises. Errors as of :meth:`leaves`.

        Parameters
        ----------
        params : mapping of arrays
        wrt : names
            Parameters that have a gradient within the context.
        """
        leaves = self.leaves(params)
        try:
            with dr.resume_grad():  # the caller may have suspended gradients
                dr.enable_grad([leaves[name] for name in wrt])
                self.set(leaves)
                yield leaves
        finally:
            self.set(self.leaves(params), wrt)

    def gradients(self, leaves: Mapping[str, Any], names: Iterable[str]) -> dict[str, Float32Array]:
        """Return the gradients that leaves have accumulated, in the shapes of their parameters."""
        return {name: as_host(dr.grad(leaves[name]), self.start[name].shape) for name in names}

    def set(self, leaves: Mapping[str, Any], names: Collection[str] | None = None) -> None:
        """Set all parameters in the scene, or those in `names` with the other handles of their shapes."""
        for name, key in self._keys.items():
            if names is None or name in names:
                self.entries[key] = converted(self.entries[key], leaves[name], self.start[name].shape)
        for posed in self._posed:
            if names is not None and not any(name in names for name in posed.names):
                continue
            handles = [(self.targets[name], leaves[name]) for name in posed.names]
            transform = combined_transform(handles, posed.centre)  # type: ignore[arg-type]  # handles, all of them
            moved = transform @ posed.start
            flat = isinstance(moved, mi.Point3f) and not isinstance(self.entries[posed.key], mi.Point3f)
            self.entries[posed.key] = dr.ravel(moved) if flat else moved
            if posed.normals is not None:
                normals = dr.normalize(transform @ posed.normals)
                self.entries[_sibling(posed.key, NORMALS)] = dr.ravel(normals)
        self.entries.update()

    def _authored_normals(self, nodes: Mapping[str, Any]) -> dict[str, Any]:
        """Return by key the vertex normals that differ from those that Mitsuba computes when vertices are set."""
        stored = {
            key: as_host(self.entries[_sibling(key, NORMALS)], (-1, 3))
            for key, node in nodes.items()
            if isinstance(node, mi.Mesh) and not node.has_face_normals() and _sibling(key, NORMALS) in self.entries
        }
        stored = {key: normals for key, normals in stored.items() if len(normals)}
        for key in stored:
            self.entries.set_dirty(key)
        self.entries.update()
        authored = {}
        for key, normals in stored.items():
            sibling = _sibling(key, NORMALS)
            if np.max(np.abs(as_host(self.entries[sibling], (-1, 3)) - normals)) >= NORMAL_TOLERANCE:
                self.entries[sibling] = mi.Float(aligned_copy(normals.reshape(-1)))
                authored[key] = mi.Normal3f(*(mi.Float(aligned_copy(axis)) for axis in normals.T))
        self.entries.update()
        return authored


def _sibling(key: str, entry: str) -> str:
    """Return the key of another entry of the same shape."""
    return f"{key.rpartition('.')[0]}.{entry}"


def _pivot(node: Any, start: Any) -> tuple[float, float, float]:
    """Return the centre of a shape's bounding box, or the position of any other object."""
    if isinstance(node, mi.Shape):
        point = node.bbox().center()
    else:
        point = start @ mi.Point3f(0.0) if isinstance(start, mi.Transform4f) else start
    x, y, z = np.array(point, dtype=np.float64).reshape(3).tolist()
    return x, y, z


def host_numbers(name: str, value: Any, shape: tuple[int, ...]) -> Float32Array:
    """Return `value` as a new float32 array.

    Raises
    ------
    ParameterError
        If it is not of that shape, or not finite.
    """
    with np.errstate(over="ignore"):  # values too large for float32 become infinite
        single = check_floats(name, value, shape).astype(np.float32, order="C")
    check_floats(name, single, shape)
    return single

"""A scene of meshes as named numbers: what may be set, and how a scene follows from numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.renderers.checks import FloatArray, check_parameters
from loi_core.renderers.handles import Rotate, Scale, Target, Translate
from loi_core.support.arrays import to_numpy
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.lighting import Environment, Light
from loi_torch.mesh.meshes import Mesh
from loi_torch.mesh.posing import posed, rotation

__all__ = ["Scene", "Values"]

OF_MESH: Final = ("vertices", "colours", "texture")
OF_MATERIAL: Final = ("ambient", "diffuse", "specular", "mirror", "shininess")
OF_CAMERA: Final = ("position", "target", "up", "fov", "extent")
OF_LIGHT: Final = ("position", "direction", "colour")
LIGHTS: Final = ("colours", "texture", "image", "colour", "background", *OF_MATERIAL)  # none of which is less than 0
LEAST_SCALE: Final = 1e-6
WIDEST: Final = 179.0  # degrees of a field of view
PARALLEL: Final = 1e-6  # sine of the least angle between the rows of a free rotation


@dataclass(frozen=True)
class Scene:
    """What is drawn."""

    meshes: dict[str, Mesh]
    camera: Camera
    lights: dict[str, Light]
    environment: Environment | None
    background: Any

    def entries(self) -> dict[str, Tensor]:
        """Everything that a parameter may stand for, by its dotted name."""
        found: dict[str, Any] = {}
        for name, mesh in self.meshes.items():
            found |= {f"{name}.{key}": getattr(mesh, key) for key in OF_MESH}
            found |= {f"{name}.{key}": getattr(mesh.material, key) for key in OF_MATERIAL}
        found |= {f"camera.{key}": getattr(self.camera, key) for key in OF_CAMERA}
        for name, light in self.lights.items():
            found |= {f"{name}.{key}": getattr(light, key) for key in OF_LIGHT}
        found["environment.image"] = None if self.environment is None else self.environment.image
        found["background"] = None if isinstance(self.background, Environment) else self.background
        return {name: value for name, value in found.items() if value is not None}

    def with_entries(self, values: Mapping[str, Any]) -> Scene:
        """The scene with other values for some entries."""
        by_owner: dict[str, dict[str, Any]] = {}
        for entry, value in values.items():
            owner, _, key = entry.partition(".")
            by_owner.setdefault(owner, {})[key] = value
        scene = self
        for owner, own in by_owner.items():
            if owner in self.meshes:
                mesh = self.meshes[owner]
                made_of = {key: value for key, value in own.items() if key in OF_MATERIAL}
                rest = {key: value for key, value in own.items() if key not in OF_MATERIAL}
                changed = replace(mesh, material=replace(mesh.material, **made_of), **rest)
                scene = replace(scene, meshes={**scene.meshes, owner: changed})
            elif owner == "camera":
                scene = replace(scene, camera=replace(self.camera, **own))
            elif owner in self.lights:
                scene = replace(scene, lights={**scene.lights, owner: replace(self.lights[owner], **own)})
            elif owner == "environment" and self.environment is not None:
                scene = replace(scene, environment=self.environment.with_image(own["image"]))
            else:
                scene = replace(scene, background=own[""])
        return scene


class Values:
    """Named parameters of a scene; keeps the rules of :class:`loi_torch.painted.HostScene`.

    Parameters
    ----------
    scene : Scene
        Its values are those that the parameters start from.
    targets : dict of str or handle
        What each parameter stands for.

    Raises
    ------
    ParameterError
        If a target is not there, or sets what another sets.
    """

    def __init__(self, scene: Scene, targets: Mapping[str, Target]) -> None:
        self.scene, self.targets = scene, dict(targets)
        entries = scene.entries()
        self._start: dict[str, FloatArray] = {}
        self._centres: dict[str, Tensor] = {}
        for name, target in self.targets.items():
            if isinstance(target, str):
                if target not in entries:
                    msg = f"`parameters[{name!r}]` must be one of {', '.join(sorted(entries))}, got {target!r}"
                    raise ParameterError(msg)
                self._start[name] = np.array(to_numpy(entries[target].detach()), dtype=np.float64)
            else:
                if target.shape not in scene.meshes:
                    known = ", ".join(scene.meshes) or "none"
                    msg = f"`parameters[{name!r}]` must move a mesh, which are {known}, got {target.shape!r}"
                    raise ParameterError(msg)
                self._start[name] = target.initial()
                vertices = scene.meshes[target.shape].vertices.detach()
                self._centres[target.shape] = _centre(vertices)
        texts = [target for target in self.targets.values() if isinstance(target, str)]
        for text in texts:
            if texts.count(text) > 1:
                names = ", ".join(repr(name) for name, target in self.targets.items() if target == text)
                msg = f"`parameters` must not set one entry twice, got {names}"
                raise ParameterError(msg)

    def parameters(self) -> dict[str, FloatArray]:
        """All parameters; new arrays on each call."""
        return {name: value.copy() for name, value in self._start.items()}

    def checked(self, params: Mapping[str, object]) -> dict[str, FloatArray]:
        """`params` as new float64 arrays, once they are known to be a scene that can be rendered."""
        values = check_parameters(params, self._start)
        for name, legal in self.project(values).items():
            target = self.targets[name]
            if isinstance(target, Rotate) and target.axis is None:
                if not _independent(values[name]):
                    msg = (
                        f"`{name}` turns freely and must be two rows that are not parallel, got {values[name].tolist()}"
                    )
                    raise ParameterError(msg)
            elif not np.array_equal(legal, values[name]):
                at = np.flatnonzero(legal.ravel() != values[name].ravel())[0]
                wanted, got = legal.ravel()[at], values[name].ravel()[at]
                msg = f"`{name}` must be {'at least' if wanted > got else 'at most'} {wanted:g}, got {got:g}"
                raise ParameterError(msg)
        return values

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """The legal parameters next to `params`: light is not negative, scales are positive, turns are rotations."""
        return {name: self._legal(name, value) for name, value in check_parameters(params, self._start).items()}

    def _legal(self, name: str, value: FloatArray) -> FloatArray:
        target = self.targets[name]
        if isinstance(target, Scale):
            return np.maximum(value, LEAST_SCALE)
        if isinstance(target, Rotate) and target.axis is None:
            return rotation(torch.from_numpy(value if _independent(value) else _beside(value)))[:2].numpy()
        if isinstance(target, Rotate | Translate):
            return value
        key = target.rpartition(".")[2]
        if key in ("fov", "extent", "shininess"):
            return np.clip(value, LEAST_SCALE, WIDEST if key == "fov" else np.inf)
        return np.maximum(value, 0.0) if key in LIGHTS else value

    def scene_of(self, values: Mapping[str, Tensor]) -> Scene:
        """The scene that has these values, with their gradients."""
        entries = {target: values[name] for name, target in self.targets.items() if isinstance(target, str)}
        scene = self.scene.with_entries(entries) if entries else self.scene
        handles: dict[str, list[Any]] = {}
        for name, target in self.targets.items():
            if not isinstance(target, str):
                handles.setdefault(target.shape, []).append((target, values[name]))
        moved = {
            shape: replace(scene.meshes[shape], vertices=posed(scene.meshes[shape].vertices, own, self._centres[shape]))
            for shape, own in handles.items()
        }
        return replace(scene, meshes={**scene.meshes, **moved}) if moved else scene


def _centre(vertices: Tensor) -> Tensor:
    if not len(vertices):
        return torch.zeros(3, dtype=vertices.dtype)
    return 0.5 * (vertices.amin(dim=0) + vertices.amax(dim=0))


def _independent(rows: FloatArray) -> bool:
    lengths: Sequence[float] = np.linalg.norm(rows, axis=1).tolist()
    across = float(np.linalg.norm(np.cross(rows[0], rows[1])))
    return across > PARALLEL * lengths[0] * lengths[1]


def _beside(rows: FloatArray) -> FloatArray:
    """Two rows that are not parallel, the first as it is if it has a length: what a bound may make of a rotation."""
    first = rows[0] if np.any(rows[0]) else np.array([1.0, 0.0, 0.0])
    return np.stack([first, np.eye(3)[np.argmin(np.abs(first))]])

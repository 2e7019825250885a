"""A mesh scene and its named parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.renderers.poses import ParameterTarget, Rotate, Scale, Translate
from loi_core.renderers.validation import FloatArray, check_parameters
from loi_core.support.arrays import to_numpy
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.lighting import Environment, Light
from loi_torch.mesh.meshes import Mesh
from loi_torch.mesh.posing import apply_handles, rotation_from_rows

__all__ = ["MeshScene", "SceneParameters"]

MESH_ENTRIES: Final = ("vertices", "colours", "texture")
MATERIAL_ENTRIES: Final = ("ambient", "diffuse", "specular", "mirror", "shininess")
CAMERA_ENTRIES: Final = ("position", "target", "up", "fov", "extent", "focal", "principal_point", "skew")
LIGHT_ENTRIES: Final = ("position", "direction", "colour")
NONNEGATIVE_ENTRIES: Final = ("colours", "texture", "image", "colour", "background", *MATERIAL_ENTRIES)
MIN_POSITIVE: Final = 1e-6  # of scale factors, fields of view, extents, focal lengths and exponents
MAX_FOV_DEGREES: Final = 179.0
MIN_ROW_SINE: Final = 1e-6  # of the angle between the rows of a free rotation


@dataclass(frozen=True)
class MeshScene:
    """Meshes with the camera, the lights, the environment and the background of their image."""

    meshes: dict[str, Mesh]
    camera: Camera
    lights: dict[str, Light]
    environment: Environment | None
    background: Any

    def entries(self) -> dict[str, Tensor]:
        """Return all values that a parameter may set, by dotted name."""
        entries: dict[str, Any] = {}
        for name, mesh in self.meshes.items():
            entries |= {f"{name}.{key}": getattr(mesh, key) for key in MESH_ENTRIES}
            entries |= {f"{name}.{key}": getattr(mesh.material, key) for key in MATERIAL_ENTRIES}
        entries |= {f"camera.{key}": getattr(self.camera, key) for key in CAMERA_ENTRIES}
        for name, light in self.lights.items():
            entries |= {f"{name}.{key}": getattr(light, key) for key in LIGHT_ENTRIES}
        entries["environment.image"] = None if self.environment is None else self.environment.image
        entries["background"] = None if isinstance(self.background, Environment) else self.background
        return {name: value for name, value in entries.items() if value is not None}

    def with_entries(self, values: Mapping[str, Any]) -> MeshScene:
        """Return the scene with other values of some entries."""
        by_owner: dict[str, dict[str, Any]] = {}
        for entry, value in values.items():
            owner, _, key = entry.partition(".")
            by_owner.setdefault(owner, {})[key] = value
        scene = self
        for owner, changes in by_owner.items():
            if owner in self.meshes:
                mesh = self.meshes[owner]
                of_material = {key: value for key, value in changes.items() if key in MATERIAL_ENTRIES}
                of_mesh = {key: value for key, value in changes.items() if key not in MATERIAL_ENTRIES}
                changed = replace(mesh, material=replace(mesh.material, **of_material), **of_mesh)
                scene = replace(scene, meshes={**scene.meshes, owner: changed})
            elif owner == "camera":
                scene = replace(scene, camera=replace(self.camera, **changes))
            elif owner in self.lights:
                scene = replace(scene, lights={**scene.lights, owner: replace(self.lights[owner], **changes)})
            elif owner == "environment":
                scene = replace(scene, environment=Environment(changes["image"]))
            else:
                scene = replace(scene, background=changes[""])
        return scene


class SceneParameters:
    """Named parameters of a scene; implements :class:`loi_torch.painted.HostScene`.

    Each parameter sets the entry, or moves the handle, that is its target, from the value in the scene. A
    ParameterError is raised if a target does not exist, or if two parameters set the same entry.
    """

    def __init__(self, scene: MeshScene, targets: Mapping[str, ParameterTarget]) -> None:
        self.scene, self.targets = scene, dict(targets)
        entries = scene.entries()
        self._initial: dict[str, FloatArray] = {}
        self._centres: dict[str, Tensor] = {}
        for name, target in self.targets.items():
            if isinstance(target, str):
                if target not in entries:
                    msg = f"`parameters[{name!r}]` must be one of {', '.join(sorted(entries))}, got {target!r}"
                    raise ParameterError(msg)
                self._initial[name] = np.array(to_numpy(entries[target].detach()), dtype=np.float64)
            else:
                if target.shape not in scene.meshes:
                    meshes = ", ".join(scene.meshes) or "none"
                    msg = f"`parameters[{name!r}]` must move one of the meshes {meshes}, got {target.shape!r}"
                    raise ParameterError(msg)
                self._initial[name] = target.initial()
                self._centres[target.shape] = _box_centre(scene.meshes[target.shape].vertices.detach())
        for entry in entries:
            names = [repr(name) for name, target in self.targets.items() if target == entry]
            if len(names) > 1:
                msg = f"`parameters` must not set one entry twice, got {', '.join(names)}"
                raise ParameterError(msg)

    def parameters(self) -> dict[str, FloatArray]:
        """Return the initial values of all parameters as new arrays."""
        return {name: value.copy() for name, value in self._initial.items()}

    def checked(self, params: Mapping[str, object]) -> dict[str, FloatArray]:
        """Return `params` as new float64 arrays, or raise ParameterError if a value is not allowed."""
        values = check_parameters(params, self._initial)
        for name, legal in self.project(values).items():
            target = self.targets[name]
            if isinstance(target, Rotate) and target.axis is None:
                if not _are_independent(values[name]):
                    msg = f"`{name}` must be two rows that are not parallel, got {values[name].tolist()}"
                    raise ParameterError(msg)
            elif not np.array_equal(legal, values[name]):
                index = np.flatnonzero(legal.ravel() != values[name].ravel())[0]
                bound, value = legal.ravel()[index], values[name].ravel()[index]
                msg = f"`{name}` must be {'at least' if bound > value else 'at most'} {bound:g}, got {value:g}"
                raise ParameterError(msg)
        return values

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return the nearest legal parameters: light is not negative, scales are positive, rows make rotations."""
        return {name: self._legal(name, value) for name, value in check_parameters(params, self._initial).items()}

    def _legal(self, name: str, value: FloatArray) -> FloatArray:
        target = self.targets[name]
        if isinstance(target, Scale):
            return np.maximum(value, MIN_POSITIVE)
        if isinstance(target, Rotate) and target.axis is None:
            rows = value if _are_independent(value) else _independent_rows(value)
            return rotation_from_rows(torch.from_numpy(rows))[:2].numpy()
        if isinstance(target, Rotate | Translate):
            return value
        key = target.rpartition(".")[2]
        if key in ("fov", "extent", "focal", "shininess"):
            return np.clip(value, MIN_POSITIVE, MAX_FOV_DEGREES if key == "fov" else np.inf)
        return np.maximum(value, 0.0) if key in NONNEGATIVE_ENTRIES else value

    def scene_of(self, values: Mapping[str, Tensor]) -> MeshScene:
        """Return the scene with parameter values, and their gradients."""
        values = {name: value.cpu() for name, value in values.items()}
        entries = {target: values[name] for name, target in self.targets.items() if isinstance(target, str)}
        scene = self.scene.with_entries(entries) if entries else self.scene
        handles: dict[str, list[Any]] = {}
        for name, target in self.targets.items():
            if not isinstance(target, str):
                handles.setdefault(target.shape, []).append((target, values[name]))
        moved = {}
        for name, mesh_handles in handles.items():
            mesh = scene.meshes[name]
            moved[name] = replace(mesh, vertices=apply_handles(mesh.vertices, mesh_handles, self._centres[name]))
        return replace(scene, meshes={**scene.meshes, **moved}) if moved else scene


def _box_centre(vertices: Tensor) -> Tensor:
    """Return the centre of the bounding box."""
    if not len(vertices):
        return torch.zeros(3, dtype=vertices.dtype)
    return 0.5 * (vertices.amin(dim=0) + vertices.amax(dim=0))


def _are_independent(rows: FloatArray) -> bool:
    lengths = np.linalg.norm(rows, axis=1).tolist()
    cross_length = float(np.linalg.norm(np.cross(rows[0], rows[1])))
    return bool(cross_length > MIN_ROW_SINE * lengths[0] * lengths[1])


def _independent_rows(rows: FloatArray) -> FloatArray:
    """Replace parallel rows, which clipping to bounds may produce; the first row stays unless it is 0."""
    first = rows[0] if np.any(rows[0]) else np.array([1.0, 0.0, 0.0])
    return np.stack([first, np.eye(3)[np.argmin(np.abs(first))]])

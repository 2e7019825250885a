"""The delta lights of a scene, and the size that a small area light in place of one may have."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import Float64Array
from mitsuba_boundaries.geometry.bounds import bounding_box

__all__ = ["DELTA_LIGHTS", "LightContext", "delta_lights", "light_intensity", "light_position"]

DELTA_LIGHTS: Final = {"PointLight": "point", "SpotLight": "spot", "DirectionalEmitter": "directional"}
SURFACE_POINTS: Final = 64  # of a proxy light, for tests of visibility
MIN_VISIBLE_FRACTION: Final = 0.9  # of the surface points if the light itself sees a point; otherwise none may


@dataclass(frozen=True)
class LightContext:
    """The moving shapes and the delta lights of a scene.

    Attributes
    ----------
    boxes : array, shape (n, 2, 3)
        Bounding boxes of the moving shapes.
    centre : array, shape (3,)
        Centre of the scene.
    radius : float
        Radius of the bounding sphere of the scene.
    intensities : tuple of array or None
        RGB intensity or irradiance of each delta light; None if it is unknown, or the light must not be replaced.
    scene : mi.Scene
    """

    boxes: Float64Array
    centre: Float64Array
    radius: float
    intensities: tuple[Float64Array | None, ...]
    scene: Any

    @classmethod
    def of(cls, scene: Any, moving: Iterable[Any], keep: Collection[Any] = ()) -> LightContext:
        """Describe a loaded scene with these moving shapes; the lights in `keep` are not replaced."""
        boxes = np.array([bounding_box(shape) for shape in moving])
        lower, upper = bounding_box(scene)
        intensities = tuple(None if light in keep else light_intensity(light) for light in delta_lights(scene))
        return cls(boxes, 0.5 * (lower + upper), 0.5 * float(np.linalg.norm(upper - lower)), intensities, scene)

    @property
    def smallest_half_size(self) -> float:
        """Half the longest side of the smallest bounding box."""
        return 0.5 * float(np.min(np.max(self.boxes[:, 1] - self.boxes[:, 0], axis=1)))

    def distance(self, point: Float64Array) -> float:
        """Return the distance from a point to the nearest box; from within a box, the distance to its centre."""
        offsets = np.maximum(np.maximum(self.boxes[:, 0] - point, point - self.boxes[:, 1]), 0.0)
        distances = np.linalg.norm(offsets, axis=1)
        to_centres = np.linalg.norm(self.boxes.mean(axis=1) - point, axis=1)
        return float(np.min(np.where(distances > 0.0, distances, to_centres)))

    def preserves_visibility(self, point: Float64Array, radius: float) -> bool:
        """Return whether a sphere at a light sees the moving shapes where the light does, and only there.

        A light in a shade does not see through the shade; a larger sphere may reach beyond it.
        """
        numbers = np.arange(SURFACE_POINTS)
        angles = numbers * math.pi * (3.0 - math.sqrt(5.0))  # golden angle
        radii = np.sqrt((numbers + 0.5) / SURFACE_POINTS)
        disk = radius * np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)
        for lower, upper in self.boxes:
            centre, half_diagonal = 0.5 * (lower + upper), 0.5 * float(np.linalg.norm(upper - lower))
            clearance = float(np.linalg.norm(centre - point)) - half_diagonal  # beyond it, the moving shape may be hit
            if clearance <= 0.0:
                continue
            forward = (centre - point) / np.linalg.norm(centre - point)
            tangents = np.linalg.svd(forward[None, :])[2][1:]
            heights = np.sqrt(radius**2 - np.sum(disk**2, axis=1))  # of the hemisphere that faces the shape
            origins = np.concatenate([point[None, :], point + disk @ tangents + heights[:, None] * forward])
            limits = clearance - np.append(0.0, heights)
            corners = lower + (upper - lower) * np.indices((2, 2, 2)).reshape(3, 8).T
            for target in (centre, *corners):
                hidden = _first_hit(self.scene, origins, target) < limits
                if not (np.all(hidden) if hidden[0] else np.mean(~hidden) >= MIN_VISIBLE_FRACTION):
                    return False
        return True


def delta_lights(scene: Any) -> list[Any]:
    """Return the delta lights that a proxy can replace, in the scene's order."""
    return [emitter for emitter in scene.emitters() if emitter.class_name() in DELTA_LIGHTS]


def light_position(light: Any) -> Float64Array:
    """Return the position of a point or spot light, shape (3,); it has no meaning for a directional light."""
    params = mi.traverse(light)
    position = params["position"] if "position" in params else params["to_world"].translation()
    return np.array(position, dtype=np.float64).reshape(3)


def _first_hit(scene: Any, origins: Float64Array, target: Float64Array) -> Float64Array:
    """Return the distance to the first hit from origins, shape (n, 3), towards a point; infinite without a hit."""
    directions = target - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(origins.astype(np.float32).T), mi.Vector3f(directions.astype(np.float32).T))
    with dr.suspend_grad():
        return np.array(scene.ray_intersect_preliminary(ray).t, dtype=np.float64)


def light_intensity(light: Any) -> Float64Array | None:
    """Return the RGB intensity or irradiance of a delta light, shape (3,); None if it is textured or a spectrum."""
    if mi.is_spectral:
        return None
    params = mi.traverse(light)
    quantity = "irradiance" if DELTA_LIGHTS[light.class_name()] == "directional" else "intensity"
    textured = "texture.data" in params
    if f"{quantity}.value" not in params or textured:
        return None
    value = np.array(params[f"{quantity}.value"], dtype=np.float64).reshape(-1)
    return np.resize(value, 3) if value.size in (1, 3) else None

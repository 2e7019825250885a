"""What is around the things that move in a scene: where they are, and the lights without a size."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.drjit.arrays import Float64Array
from loi_mitsuba.geometry.bounds import bounding_box

__all__ = ["KINDS", "LightContext", "delta_lights", "light_intensity", "light_position"]


KINDS: Final = {"PointLight": "point", "SpotLight": "spot", "DirectionalEmitter": "directional"}
PLACES: Final = 64  # of a lamp, from which what moves is seen or hidden
OPEN: Final = 0.9  # of them, that see it if the light does; if that does not, none may


@dataclass(frozen=True)
class LightContext:
    """Where things move, and what lights there are.

    Attributes
    ----------
    boxes : array, shape (n, 2, 3)
        Lowest and highest corners of what moves.
    middle : array, shape (3,)
        Of the whole scene.
    radius : float
        Of a sphere around the whole scene.
    powers : tuple of array or None
        Intensity or irradiance of each light without a size, as red, green and blue; None where it is not known, or the
        light is to stay as it is.
    scene : mi.Scene
        What there is.
    """

    boxes: Float64Array
    middle: Float64Array
    radius: float
    powers: tuple[Float64Array | None, ...]
    scene: Any

    @classmethod
    def of(cls, scene: Any, moving: Iterable[Any], stay: Iterable[int] = ()) -> LightContext:
        """Of a loaded scene, the shapes that move in it, and the numbers of lights that are to stay as they are."""
        boxes = np.array([bounding_box(one) for one in moving])
        low, high = bounding_box(scene)
        kept = set(stay)
        powers = tuple(None if k in kept else light_intensity(one) for k, one in enumerate(delta_lights(scene)))
        return cls(boxes, 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)), powers, scene)

    def distance(self, point: Float64Array) -> float:
        """From a point to the nearest box, or if it is within one, to that one's middle."""
        outside = np.maximum(np.maximum(self.boxes[:, 0] - point, point - self.boxes[:, 1]), 0.0)
        away = np.linalg.norm(outside, axis=1)
        middles = np.linalg.norm(self.boxes.mean(axis=1) - point, axis=1)
        return float(np.min(np.where(away > 0.0, away, middles)))

    def fits(self, point: Float64Array, radius: float) -> bool:
        """Whether a sphere at a light sees what moves where the light does, and does not where that has a shade."""
        turns = np.arange(PLACES) * math.pi * (3.0 - math.sqrt(5.0))
        away = np.sqrt((np.arange(PLACES) + 0.5) / PLACES)
        disk = radius * np.stack([away * np.cos(turns), away * np.sin(turns)], axis=1)
        for low, high in self.boxes:
            middle, reach = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
            before = float(np.linalg.norm(middle - point)) - reach  # from there on, it may be what moves itself
            if before <= 0.0:
                continue
            towards = (middle - point) / np.linalg.norm(middle - point)
            across = np.linalg.svd(towards[None, :])[2][1:]
            bulge = np.sqrt(radius**2 - np.sum(disk**2, axis=1))  # of the side of the sphere that is turned there
            origins = np.concatenate([point[None, :], point + disk @ across + bulge[:, None] * towards])
            room = before - np.append(0.0, bulge)
            corners = low + (high - low) * np.indices((2, 2, 2)).reshape(3, 8).T
            for goal in (middle, *corners):
                hidden = _first_hit(self.scene, origins, goal) < room
                if not (np.all(hidden) if hidden[0] else np.mean(~hidden) >= OPEN):
                    return False
        return True

    @property
    def least(self) -> float:
        """Half the longest side of the smallest box."""
        return 0.5 * float(np.min(np.max(self.boxes[:, 1] - self.boxes[:, 0], axis=1)))


def delta_lights(scene: Any) -> list[Any]:
    """The lights without a size that can be exchanged, in the scene's order."""
    return [one for one in scene.emitters() if one.class_name() in KINDS]


def light_position(light: Any) -> Float64Array:
    """Where a light without a size is, shape (3,); of a directional light, nowhere that means anything."""
    params = mi.traverse(light)
    told = params["position"] if "position" in params else params["to_world"].translation()
    return np.array(told, dtype=np.float64).reshape(3)


def _first_hit(scene: Any, origins: Float64Array, goal: Float64Array) -> Float64Array:
    """How far away the first surface is on the ways from points, shape (n, 3), to one; infinite where there is none."""
    ways = goal - origins
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(origins.astype(np.float32).T), mi.Vector3f(ways.astype(np.float32).T))
    with dr.suspend_grad():
        return np.array(scene.ray_intersect_preliminary(ray).t, dtype=np.float64)


def light_intensity(light: Any) -> Float64Array | None:
    """Intensity or irradiance of a light of one colour in all directions, shape (3,); None for others, and spectra."""
    if mi.is_spectral:
        return None
    params = mi.traverse(light)
    power = "irradiance" if KINDS[light.class_name()] == "directional" else "intensity"
    textured = "texture.data" in params
    if f"{power}.value" not in params or textured:
        return None
    value = np.array(params[f"{power}.value"], dtype=np.float64).reshape(-1)
    return np.resize(value, 3) if value.size in (1, 3) else None

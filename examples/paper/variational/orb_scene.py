"""A glass orb on a table with a known print, and a simulated photograph of it.

The unknown is the position of the orb. The target is no render of the model, see
:mod:`examples.paper.variational.photograph`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np

from examples.paper.variational.photograph import Photograph
from examples.paper.variational.problem import Group, Images, Problem
from loi_core.renderers.poses import ParameterTarget
from loi_mitsuba import Translate  # before mitsuba

# isort: split
import mitsuba as mi

__all__ = ["RADIUS", "TRUTH", "Rig", "problem", "scene"]

RADIUS: Final = 0.45
TRUTH: Final = {"x": 1.1, "z": -0.9}
LOWER_BOUNDS: Final = {"x": -2.3, "z": -3.3}
UPPER_BOUNDS: Final = {"x": 2.3, "z": 2.4}
CAMERA_POSITION: Final = (0.0, 8.0, 5.5)
LIGHT_POSITION: Final = (-4.0, 7.0, -2.0)
TABLE_HALF_SIDE: Final = 8.0
TILES_PER_SIDE: Final = 32
DARK_REFLECTANCE: Final = 0.4
LIGHT_REFLECTANCE: Final = 0.6
MAX_DEPTH: Final = 8
REFERENCE_SAMPLES: Final = 64
PHOTOGRAPH_SAMPLES: Final = 64  # of each pixel before four become one
MODEL_VARIANT: Final = "llvm_ad_rgb"
PHOTOGRAPH_VARIANT: Final = "llvm_ad_spectral"


@dataclass(frozen=True)
class Rig:
    """Camera, light and path depth of a scene; the defaults are the model's.

    Attributes
    ----------
    fov : float
        Field of view of the camera, in degrees.
    light_position : 3 floats
    intensity : float
        Radiance of the light, relative to the model.
    max_depth : int
        Maximum depth of a path.
    """

    fov: float = 36.0
    light_position: tuple[float, float, float] = LIGHT_POSITION
    intensity: float = 1.0
    max_depth: int = MAX_DEPTH


def scene(side_px: int, rig: Rig, position: tuple[float, float] = (0.0, 0.0)) -> dict[str, Any]:
    """Return the scene for ``mi.load_dict``, with the orb at `position`, (x, z)."""
    transform = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": rig.max_depth},
        "sensor": {
            "type": "perspective",
            "fov": rig.fov,
            "to_world": transform().look_at(list(CAMERA_POSITION), [0, 0, 0.2], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": side_px, "height": side_px, "rfilter": {"type": "box"}},
        },
        "table": {
            "type": "rectangle",
            "to_world": transform().rotate([1, 0, 0], -90).scale(TABLE_HALF_SIDE),
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "bitmap", "bitmap": mi.Bitmap(_print()), "filter_type": "nearest"},
            },
        },
        "orb": {
            "type": "sphere",
            "center": [position[0], RADIUS, position[1]],
            "radius": RADIUS,
            "bsdf": {"type": "dielectric", "int_ior": 1.47, "ext_ior": 1.0},  # borosilicate
        },
        "lamp": {
            "type": "rectangle",
            "to_world": transform().look_at(list(rig.light_position), [0, 0, 0], [0, 1, 0]).scale(1.5),
            "emitter": {
                "type": "area",
                "radiance": {"type": "rgb", "value": [rig.intensity * channel for channel in (12.0, 11.3, 10.6)]},
            },
        },
    }


@lru_cache(maxsize=2)
def problem(side_px: int, samples: int) -> Problem:
    """Return the orb at a size in pixels."""
    target = Photograph().of(_exposure(side_px), seed=7)
    mi.set_variant(MODEL_VARIANT)
    targets: dict[str, ParameterTarget] = {"x": Translate("orb", (1, 0, 0)), "z": Translate("orb", (0, 0, 1))}
    images, reference_images = (Images(scene(side_px, Rig()), targets, count) for count in (samples, REFERENCE_SAMPLES))
    groups = (Group("orb, radii", tuple(TRUTH), RADIUS, 0.25),)
    return Problem(images, reference_images, target, TRUTH, LOWER_BOUNDS, UPPER_BOUNDS, groups)


def _exposure(side_px: int) -> Any:
    """Return the radiance on the photograph's sensor, linear, at twice the resolution: shape (2 side_px, 2 side_px, 3).

    The field of view, and the position and the intensity of the light, are 1 % off.
    """
    model = Rig()
    x, y, z = model.light_position
    rig = Rig(1.01 * model.fov, (1.01 * x, 1.01 * y, 0.99 * z), 1.01 * model.intensity, 3 * model.max_depth)
    mi.set_variant(PHOTOGRAPH_VARIANT)
    loaded = mi.load_dict(scene(2 * side_px, rig, (TRUTH["x"], TRUTH["z"])))
    return np.array(mi.render(loaded, seed=123, spp=PHOTOGRAPH_SAMPLES).numpy())


def _print() -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return randomly dark or light tiles of one texel, shape (tiles, tiles, 3)."""
    is_light = np.random.default_rng(0).random((TILES_PER_SIDE, TILES_PER_SIDE, 1)) < 0.5
    return np.where(is_light, LIGHT_REFLECTANCE, DARK_REFLECTANCE).repeat(3, axis=2).astype(np.float32)

"""A glass orb on a table with a known print, and what stands in for a photograph of it.

Unknown is where the orb is. The target is no render of the model: see :mod:`examples.paper.variational.photograph`.
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
LOW: Final = {"x": -2.3, "z": -3.3}
HIGH: Final = {"x": 2.3, "z": 2.4}
EYE: Final = (0.0, 8.0, 5.5)
LAMP: Final = (-4.0, 7.0, -2.0)
TABLE: Final = 8.0  # half of its side
TILES: Final = 32  # along a side
DARK: Final = 0.4
LIGHT: Final = 0.6
DEPTH: Final = 8
CLOSE: Final = 64  # samples
PHOTOGRAPHED: Final = 64  # samples of each pixel of the photograph, of which four become one
MODEL: Final = "llvm_ad_rgb"
CAMERA: Final = "llvm_ad_spectral"  # the photograph's light has wavelengths


@dataclass(frozen=True)
class Rig:
    """Camera, lamp and depth of paths: those of the model, unless they are off.

    Attributes
    ----------
    fov : float
        Degrees.
    lamp : 3 floats
        Where it is.
    power : float
        Of the lamp.
    depth : int
    """

    fov: float = 36.0
    lamp: tuple[float, float, float] = LAMP
    power: float = 1.0
    depth: int = DEPTH


def scene(side: int, rig: Rig, at: tuple[float, float] = (0.0, 0.0)) -> dict[str, Any]:
    """The scene, for ``mi.load_dict``; `at` is where the orb stands, x and z."""
    place = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": rig.depth},
        "sensor": {
            "type": "perspective",
            "fov": rig.fov,
            "to_world": place().look_at(list(EYE), [0, 0, 0.2], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}},
        },
        "table": {
            "type": "rectangle",
            "to_world": place().rotate([1, 0, 0], -90).scale(TABLE),
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "bitmap", "bitmap": mi.Bitmap(_print()), "filter_type": "nearest"},
            },
        },
        "orb": {
            "type": "sphere",
            "center": [at[0], RADIUS, at[1]],
            "radius": RADIUS,
            "bsdf": {"type": "dielectric", "int_ior": 1.47, "ext_ior": 1.0},  # borosilicate
        },
        "lamp": {
            "type": "rectangle",
            "to_world": place().look_at(list(rig.lamp), [0, 0, 0], [0, 1, 0]).scale(1.5),
            "emitter": {
                "type": "area",
                "radiance": {"type": "rgb", "value": [rig.power * one for one in (12.0, 11.3, 10.6)]},
            },
        },
    }


@lru_cache(maxsize=2)
def problem(side: int, samples: int) -> Problem:
    """The orb at a size in pixels."""
    target = Photograph().of(_light(side), seed=7)
    mi.set_variant(MODEL)
    targets: dict[str, ParameterTarget] = {"x": Translate("orb", (1, 0, 0)), "z": Translate("orb", (0, 0, 1))}
    images, close = (Images(scene(side, Rig()), targets, count) for count in (samples, CLOSE))
    return Problem(images, close, target, TRUTH, LOW, HIGH, (Group("orb, radii", tuple(TRUTH), RADIUS, 0.25),))


def _light(side: int) -> Any:
    """What falls into the photograph's camera, at twice the pixels: shape (2 side, 2 side, 3), linear.

    Its field of view, the lamp's place and the lamp's power are 1 % off.
    """
    model = Rig()
    x, y, z = model.lamp
    off = Rig(1.01 * model.fov, (1.01 * x, 1.01 * y, 0.99 * z), 1.01 * model.power, 3 * model.depth)
    mi.set_variant(CAMERA)
    loaded = mi.load_dict(scene(2 * side, off, (TRUTH["x"], TRUTH["z"])))
    return np.array(mi.render(loaded, seed=123, spp=PHOTOGRAPHED).numpy())


def _print() -> np.ndarray[Any, np.dtype[np.float32]]:
    """Dark and light tiles at random, a texel each: shape (TILES, TILES, 3)."""
    light = np.random.default_rng(0).random((TILES, TILES, 1)) < 0.5
    return np.where(light, LIGHT, DARK).repeat(3, axis=2).astype(np.float32)

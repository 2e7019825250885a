"""Small procedural scenes that need different effects of light transport."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import loi_mitsuba  # noqa: F401 - before Dr.Jit, so that it gets an LLVM that works

# isort: split
import mitsuba as mi
import numpy as np

from examples.effects.parts import ball, bitmap, camera, colour, diffuse, floor, lamp, mesh_of_boxes, numbers, picture
from loi_mitsuba import Rotate, Translate

__all__ = ["SUITE", "Case"]

WIDTH, HEIGHT = 96, 72


@dataclass(frozen=True)
class Case:
    """A scene with its optimised parameters, their initial values and their true values.

    Attributes
    ----------
    name : str
        Name of the scene.
    make : callable
        Returns the dict for ``mi.load_dict`` at a width and height, once Mitsuba's variant is set.
    parameters : dict
        For :class:`loi_mitsuba.MitsubaRenderer`.
    start, truth : dict of arrays
        Initial values of a fit, and the values of the target.
    rate : float
        Learning rate, in units of the parameters.
    manual : dict
        The integrator that an expert would choose; all its sample counts above 0 are equal.
    default : dict
        Mitsuba's default integrator for such a scene: the cheaper projective one if direct light is enough.
    """

    name: str
    make: Callable[[int, int], dict[str, Any]]
    parameters: Mapping[str, Any]
    start: Mapping[str, Any]
    truth: Mapping[str, Any]
    rate: float
    manual: Mapping[str, Any]
    default: Mapping[str, Any]

    def scene(self, width: int = WIDTH, height: int = HEIGHT) -> dict[str, Any]:
        """Return the dict for ``mi.load_dict``."""
        return self.make(width, height)


def _texture(width: int, height: int) -> dict[str, Any]:
    wall = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(2.5)}
    grey = np.full((8, 12, 3), 0.5, np.float32)
    return {
        "type": "scene",
        "sensor": camera(width, height, [0, 0, 6], [0, 0, 0]),
        "wall": {**wall, "bsdf": {"type": "diffuse", "reflectance": bitmap(grey)}},
        "lamp": lamp([2, 3, 5], 0.5, 60.0),
    }


def _emitter(width: int, height: int) -> dict[str, Any]:
    return {
        "type": "scene",
        "sensor": camera(width, height, [0, 6, 6], [0, 0, 0]),
        "floor": floor(),
        "ball": ball([0, 0.8, 0], 0.8, bsdf=diffuse([0.7, 0.7, 0.7])),
        "lamp": lamp([3, 6, 2], 0.7, 40.0),
    }


def _visible(width: int, height: int) -> dict[str, Any]:
    return {
        "type": "scene",
        "sensor": camera(width, height, [0, 0, 8], [0, 0, 0], 40.0),
        "ball": ball([0, 0, 0], 0.5, bsdf=diffuse([0.9, 0.5, 0.2])),
        "light": {"type": "constant", "radiance": 0.6},
    }


def _shadow(width: int, height: int) -> dict[str, Any]:
    return {
        "type": "scene",
        "sensor": camera(width, height, [0, 6, 6], [0, 0, 0]),
        "floor": floor(),
        "ball": ball([0, 5, 0], 0.4),
        "lamp": lamp([0, 12, 0], 0.7, 100.0),
    }


def _both(width: int, height: int) -> dict[str, Any]:
    return {
        "type": "scene",
        "sensor": camera(width, height, [0, 6, 6], [0, 0, 0]),
        "floor": floor(),
        "ball": ball([0, 0.7, 0], 0.6, bsdf=diffuse([0.8, 0.2, 0.2])),
        "lamp": lamp([2, 8, 1], 0.7, 60.0),
    }


def _mirror(width: int, height: int) -> dict[str, Any]:
    # The camera looks down at a glossy floor; the ball hangs above its view.
    glossy = {"type": "roughconductor", "alpha": 0.08}
    return {
        "type": "scene",
        "sensor": camera(width, height, [0, 3, 6], [0, 0, -1], 35.0),
        "floor": {**floor(), "bsdf": {"type": "twosided", "bsdf": glossy}},
        "ball": ball([0, 3.0, -6.0], 0.8, bsdf=diffuse([0.9, 0.4, 0.1])),
        "light": {"type": "constant", "radiance": 0.4},
        "lamp": lamp([3, 7, 0], 0.7, 30.0),
    }


def _caustic(width: int, height: int) -> dict[str, Any]:
    return {
        "type": "scene",
        "sensor": camera(width, height, [0, 6, 6], [0, 0, 0]),
        "floor": floor(),
        "glass": ball([0, 1.2, 0], 0.8, bsdf={"type": "dielectric"}),
        "lamp": lamp([0, 7, -2], 1.2, 25.0),
    }


def _light(width: int, height: int) -> dict[str, Any]:
    return {
        "type": "scene",
        "sensor": camera(width, height, [0, 6, 6], [0, 0, 0]),
        "floor": floor(),
        "ball": ball([0, 0.8, 0], 0.8, bsdf=diffuse([0.7, 0.7, 0.7])),
        "lamp": lamp([0, 6, 0], 0.5, 50.0),
    }


def _environment(width: int, height: int) -> dict[str, Any]:
    # Mitsuba has no gradient for the rotation of an environment map, but for the rotation of an emitting sphere.
    enlarged = mi.ScalarTransform4f().scale(20)
    sky = {"type": "area", "radiance": bitmap(picture(16, 32, 3))}
    return {
        "type": "scene",
        "sensor": camera(width, height, [0, 2, 6], [0, 0, 0]),
        "sky": {"type": "sphere", "flip_normals": True, "to_world": enlarged, "emitter": sky},
        "ball": ball([0, 0, 0], 1.2, bsdf=diffuse([0.8, 0.8, 0.8])),
    }


CAMERA: Final = [0.0, 0.0, 8.0]


def _pose(width: int, height: int) -> dict[str, Any]:
    # Rotating the scene about the camera equals rotating the camera the opposite way.
    boxes = [((-1.2, 0.2, 0.0), 0.5), ((0.9, -0.5, 0.6), 0.6), ((0.3, 1.1, -0.8), 0.4)]
    return {
        "type": "scene",
        "sensor": camera(width, height, CAMERA, [0, 0, 0]),
        "room": mesh_of_boxes("room", boxes, [0.7, 0.5, 0.3]),
        "light": {"type": "constant", "radiance": 0.6},
    }


def _fog(width: int, height: int) -> dict[str, Any]:
    fog = {"type": "homogeneous", "albedo": colour([0.8, 0.8, 0.8]), "sigma_t": 0.6}
    return {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 6},
        "sensor": camera(width, height, [0, 1.5, 6], [0, 0.8, 0]),
        "floor": floor(),
        "cloud": {**ball([0, 1.0, 0], 1.0), "bsdf": {"type": "null"}, "interior": fog},
        "lamp": lamp([2, 6, 2], 0.7, 60.0),
    }


def _nothing(width: int, height: int) -> dict[str, Any]:
    return {
        "type": "scene",
        "sensor": camera(width, height, [0, 0, 8], [0, 0, 0], 40.0),
        "ball": ball([0, 0, 0], 0.5, bsdf=diffuse([0.9, 0.5, 0.2])),
        "behind": ball([0, 0, 14], 0.5),
        "light": {"type": "constant", "radiance": 0.6},
    }


def _unguided(plugin: str, **settings: int) -> dict[str, Any]:
    return {"type": plugin, "guiding": "none", **settings}


def _plane(shape: str) -> dict[str, Any]:
    return {"x": Translate(shape, (1, 0, 0)), "z": Translate(shape, (0, 0, 1))}


def _at(x: float, z: float) -> dict[str, Any]:
    return {"x": numbers(x), "z": numbers(z)}


SUITE: Final = (
    Case(
        "diffuse texture",
        _texture,
        {"texture": "wall.bsdf.reflectance.data"},
        {"texture": np.full((8, 12, 3), 0.5, np.float32)},
        {"texture": picture(8, 12, 1)},
        0.02,
        {"type": "prb", "max_depth": 2},
        {"type": "prb"},
    ),
    Case(
        "emitter colour",
        _emitter,
        {"light": "lamp.emitter.radiance.value"},
        {"light": numbers(20, 20, 20)},
        {"light": numbers(40, 30, 15)},
        0.5,
        {"type": "prb", "max_depth": 3},
        {"type": "prb"},
    ),
    Case(
        "visible object, no shadow",
        _visible,
        {"place": Translate("ball")},
        {"place": numbers(-1.5, 0.9, 0.0)},
        {"place": numbers(1.4, -0.8, 0.0)},
        0.1,
        _unguided("direct_projective", sppi=0),
        {"type": "direct_projective"},
    ),
    Case(
        "shadow of an object out of view",
        _shadow,
        _plane("ball"),
        _at(-1.1, 0.5),
        _at(0.8, -0.5),
        0.04,
        _unguided("direct_projective", sppc=0, sppp=0),
        {"type": "direct_projective"},
    ),
    Case(
        "object and its shadow",
        _both,
        _plane("ball"),
        _at(-1.2, 0.6),
        _at(1.0, -0.6),
        0.04,
        _unguided("prb_projective", max_depth=3),
        {"type": "prb_projective"},
    ),
    Case(
        "object in a mirror only",
        _mirror,
        {"x": Translate("ball", (1, 0, 0))},
        {"x": numbers(-1.2)},
        {"x": numbers(1.0)},
        0.04,
        _unguided("prb_projective", max_depth=3, sppp=0),
        {"type": "prb_projective"},
    ),
    Case(
        "glass sphere with caustic",
        _caustic,
        {"light": "lamp.emitter.radiance.value"},
        {"light": numbers(12, 12, 12)},
        {"light": numbers(25, 20, 12)},
        0.3,
        {"type": "prb", "max_depth": 5},
        {"type": "prb"},
    ),
    Case(
        "moving area light",
        _light,
        _plane("lamp"),
        _at(-1.5, 0.5),
        _at(1.0, -0.5),
        0.05,
        _unguided("prb_projective", max_depth=3, sppc=0, sppp=0),
        {"type": "prb_projective"},
    ),
    Case(
        "environment rotation",
        _environment,
        {"turn": Rotate("sky", (0, 1, 0))},
        {"turn": numbers(-12.0)},
        {"turn": numbers(20.0)},
        1.0,
        {"type": "prb", "max_depth": 2},
        {"type": "prb_projective"},
    ),
    Case(
        "camera pose",
        _pose,
        {"pan": Rotate("room", (0, 1, 0), CAMERA), "tilt": Rotate("room", (1, 0, 0), CAMERA)},
        {"pan": numbers(-2.5), "tilt": numbers(1.5)},
        {"pan": numbers(2.5), "tilt": numbers(-1.5)},
        0.25,
        _unguided("direct_projective"),
        {"type": "direct_projective"},
    ),
    Case(
        "fog",
        _fog,
        {"density": "cloud.interior_medium.sigma_t.value.value"},
        {"density": numbers(0.3)},
        {"density": numbers(1.2)},
        0.02,
        {"type": "prbvolpath", "max_depth": 6},
        {"type": "prbvolpath"},
    ),
    Case(
        "nothing that can be seen",
        _nothing,
        {"place": Translate("behind")},
        {"place": numbers(0.0, 0.0, 0.0)},
        {"place": numbers(1.0, 0.0, 0.0)},
        0.05,
        _unguided("direct_projective"),
        {"type": "direct_projective"},
    ),
)
"""All scenes, in the order of the table."""

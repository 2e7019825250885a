"""Things in Mitsuba that are seen by their light alone: a shadow, an image in a mirror, a highlight, a lens, a lamp."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypeAlias

import numpy as np

from examples.external.problem import Problem, Start, needs
from examples.external.solid_turns import host
from loi_core import Free
from loi_core.support.arrays import Host, to_numpy

__all__ = ["LIGHTS"]

WIDTH_PX, HEIGHT_PX = 128, 96
SAMPLES: Final = 32
TARGET_SAMPLES: Final = 256
TARGET_SEED: Final = 10**6

Scene = dict[str, Any]
Value: TypeAlias = float | tuple[float, float, float]


@dataclass(frozen=True)
class _Thing:
    """A scene of Mitsuba, its free parameters with start, goal and bounds, and the allowed errors.

    Attributes
    ----------
    scene : callable
        Returns the dict for ``mi.load_dict``.
    parameters : callable
        Returns the parameters of the renderer.
    start, goal : dict of float or tuple of float
    bounds : pair of float or of tuples
    allowed : float
        In the unit of the parameters.
    """

    scene: Callable[[], Scene]
    parameters: Callable[[], Mapping[str, Any]]
    start: Mapping[str, Value]
    goal: Mapping[str, Value]
    bounds: tuple[Value, Value]
    allowed: float

    def error(self, params: Mapping[str, Any]) -> float:
        """Return the distance to the goal in units of the allowed error."""
        offsets = [np.ravel(host(params[name]) - goal) for name, goal in self.goal.items()]
        return float(np.linalg.norm(np.concatenate(offsets))) / self.allowed


def seen(thing: _Thing, gain: float, seed: int) -> Start:
    """Return a start for a photograph with this gain; the photograph's noise and the fit use the same seed."""
    import loi_mitsuba

    _set_variant()
    scene, parameters = thing.scene(), thing.parameters()
    renderer = loi_mitsuba.PlannedRenderer(scene, parameters, spp=SAMPLES)
    clean = loi_mitsuba.PlannedRenderer(scene, parameters, spp=TARGET_SAMPLES).unabridged
    single = {name: np.asarray(value, np.float32) for name, value in thing.goal.items()}
    target = gain * to_numpy(clean.render(clean.parameters() | single, seed=TARGET_SEED + seed))
    return Start(
        renderer, target, {name: Free(value, *thing.bounds) for name, value in thing.start.items()}, thing.error
    )


def _set_variant() -> None:
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")


def _moves(shape: str, axes: Mapping[str, tuple[int, int, int] | None]) -> Mapping[str, Any]:
    import loi_mitsuba

    return {name: loi_mitsuba.Translate(shape, axis) for name, axis in axes.items()}


def _camera(origin: list[float], target: list[float], fov: float = 45.0) -> Scene:
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov": fov,
        "to_world": mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": WIDTH_PX,
            "height": HEIGHT_PX,
            "sample_border": True,
            "rfilter": {"type": "box"},
        },
    }


def _diffuse(*colour: float) -> Scene:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}


def _wall(z: float, half: float, *, facing: int, bsdf: Scene) -> Scene:
    """Return a square across the z axis that faces along it."""
    import mitsuba as mi

    at = mi.ScalarTransform4f().translate([0, 0, z])
    return {"type": "rectangle", "to_world": at.rotate([0, 1, 0], 90.0 - 90.0 * facing).scale(half), "bsdf": bsdf}


def _checkers(count: int) -> Scene:
    import mitsuba as mi

    y, x = np.mgrid[:256, :256] * count // 256
    image: Host = np.where((x + y) % 2 == 0, 0.2, 0.7)[..., None] * np.array([1.0, 0.9, 0.7])
    bitmap = mi.Bitmap(image.astype(np.float32))
    return {"type": "diffuse", "reflectance": {"type": "bitmap", "bitmap": bitmap, "raw": True}}


def _shadow() -> Scene:
    import mitsuba as mi

    at = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "camera": _camera([0, 6, 6], [0, 0, 0]),
        "lamp": {"type": "point", "position": [0, 12, 0], "intensity": 150.0},
        "sky": {"type": "constant", "radiance": 0.1},
        "floor": {
            "type": "rectangle",
            "to_world": at().rotate([1, 0, 0], -90).scale(8),
            "bsdf": _diffuse(0.6, 0.5, 0.35),
        },
        "ball": {"type": "sphere", "to_world": at().translate([0, 5, 0]).scale(0.7)},
    }


def _mirror() -> Scene:
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "camera": _camera([0, 0, 5], [0, 0, 0]),
        "lamp": {"type": "point", "position": [2, 4, 2], "intensity": 60.0},
        "sky": {"type": "constant", "radiance": 0.2},
        "mirror": _wall(0.0, 3.0, facing=1, bsdf={"type": "conductor", "material": "none"}),
        "wall": _wall(11.0, 8.0, facing=-1, bsdf=_diffuse(0.5, 0.5, 0.45)),
        "ball": {"type": "sphere", "center": [0, 0, 8], "radius": 0.8, "bsdf": _diffuse(0.8, 0.25, 0.1)},
    }


def _highlight() -> Scene:
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": 29.0}}
    metal = {"type": "roughconductor", "material": "none", "alpha": 0.6, "distribution": "ggx"}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "camera": _camera([0, 0, 6], [0, 0, 0]),
        "lamp": {"type": "sphere", "center": [3, 4, 6], "radius": 0.8, "emitter": lamp},
        "sky": {"type": "constant", "radiance": 0.15},
        "wall": _wall(-2.0, 6.0, facing=1, bsdf=_diffuse(0.4, 0.4, 0.4)),
        "ball": {"type": "sphere", "center": [0, 0, 0], "radius": 1.5, "bsdf": metal},
    }


def _lit(lamp: Scene) -> Scene:
    """Return a ball on a floor that a lamp lights."""
    scene = _shadow() | {"lamp": lamp}
    scene["ball"] = {"type": "sphere", "center": [0, 1, 0], "radius": 0.7}
    return scene


def _point() -> Scene:
    return _lit({"type": "point", "position": [-1.5, 5, 1], "intensity": 30.0})


def _panel() -> Scene:
    import mitsuba as mi

    to_world = mi.ScalarTransform4f().translate([-1.5, 5, 1]).rotate([1, 0, 0], 90).scale(0.5)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": 30.0}}
    return _lit({"type": "rectangle", "to_world": to_world, "emitter": emitter})


def _lens() -> Scene:
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "camera": _camera([0, 0, 6], [0, 0, 0]),
        "lamp": {"type": "point", "position": [2, 4, 6], "intensity": 60.0},
        "sky": {"type": "constant", "radiance": 0.2},
        "wall": _wall(-2.0, 6.0, facing=1, bsdf=_checkers(16)),
        "ball": {"type": "sphere", "center": [0, 0, 1], "radius": 0.6, "bsdf": {"type": "dielectric"}},
    }


SHADOW: Final = _Thing(
    _shadow,
    partial(_moves, "ball", {"x": (1, 0, 0), "z": (0, 0, 1)}),
    start={"x": -1.5, "z": -1.0},
    goal={"x": 1.5, "z": 1.0},
    bounds=(-3.0, 3.0),
    allowed=0.05,
)
PLANE: Final[dict[str, tuple[int, int, int] | None]] = {"x": (1, 0, 0), "y": (0, 1, 0)}
MIRROR: Final = _Thing(
    _mirror,
    partial(_moves, "ball", PLANE),
    start={"x": -2.0, "y": -1.2},
    goal={"x": 2.0, "y": 1.0},
    bounds=(-3.0, 3.0),
    allowed=0.1,
)
LENS: Final = _Thing(
    _lens,
    partial(_moves, "ball", PLANE),
    start={"x": -1.0, "y": -0.6},
    goal={"x": 1.0, "y": 0.7},
    bounds=(-1.5, 1.5),
    allowed=0.07,
)
POINT: Final = _Thing(
    _point,
    lambda: {"place": "lamp.position"},
    start={"place": (-1.5, 5.0, 1.0)},
    goal={"place": (1.5, 4.0, -1.0)},
    bounds=((-3.0, 2.5, -3.0), (3.0, 6.0, 3.0)),
    allowed=0.05,
)
PANEL: Final = _Thing(
    _panel,
    partial(_moves, "lamp", {"place": None}),
    start={"place": (0.0, 0.0, 0.0)},
    goal={"place": (3.0, -1.0, -2.0)},
    bounds=((-1.5, -2.5, -4.0), (4.5, 1.0, 2.0)),
    allowed=0.05,
)
HIGHLIGHT: Final = _Thing(
    _highlight,
    lambda: {"alpha": "ball.bsdf.alpha.value"},
    start={"alpha": 0.6},
    goal={"alpha": 0.1},
    bounds=(0.02, 1.0),
    allowed=0.02,
)

LIGHTS: Final = tuple(
    Problem(
        name,
        partial(seen, thing, gain),
        "tolerances",
        1.0,
        steps=120,
        renders=250,
        starts=starts,
        source="users of the library, with Mitsuba 3",
        licence="none needed",
        missing=needs("mitsuba"),
    )
    for name, thing, gain, starts in (
        ("shadow alone in view", SHADOW, 1.0, 3),
        ("shadow alone in view, x 0.9", SHADOW, 0.9, 3),
        ("a thing in a mirror alone", MIRROR, 1.0, 2),
        ("roughness of a highlight", HIGHLIGHT, 1.0, 2),
        ("glass ball before a wall", LENS, 1.0, 2),
        ("point light that moves", POINT, 1.0, 2),
        ("panel light that moves", PANEL, 1.0, 2),
    )
)

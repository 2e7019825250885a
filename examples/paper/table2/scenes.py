"""The five scenes, with their unknown parameters and bounds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import loi_mitsuba  # noqa: F401 - before Dr.Jit, for an LLVM that works

# isort: split
import mitsuba as mi
import numpy as np

from examples.effects.parts import ball, camera, colour, diffuse, lamp
from examples.paper.table2.shadow import START, TRUTH
from examples.paper.table2.shadow import scene as shadow_scene
from loi_core.renderers.poses import Translate

__all__ = ["SCENES", "Built", "FloatArray"]

FloatArray = np.ndarray[Any, np.dtype[np.float64]]

REACH: Final = 5.0  # bound of every position on a floor
MAX_OFFSET: Final = 2.0  # world units between the start and the target of a primitive, along either axis
VISIBLE_FLOOR: Final = np.array([[-4.6, -3.2], [4.6, 3.2]])  # two opposite corners
SORT_ROWS, SORT_COLUMNS = 5, 13  # of the sorted primitives
HEIGHT_STEP: Final = 0.0012  # half height that each box adds to the last: tops in one plane would flicker
SHADOW_TRUTH: Final = tuple(map(float, TRUTH.values()))


@dataclass(frozen=True)
class Built:
    """A scene for one seed.

    Attributes
    ----------
    scene : dict
        Description for ``mi.load_dict``.
    parameters : dict of Translate
        Translations, each along one axis.
    truth, start : dict of float
        Parameters in world units.
    reach : float
        Bound of the magnitude of every parameter, in world units.
    """

    scene: dict[str, Any]
    parameters: Mapping[str, Translate]
    truth: Mapping[str, float]
    start: Mapping[str, float]
    reach: float = REACH


def shadow(width: int, height: int, seed: int) -> Built:
    """Return a sphere out of view that casts its shadow on a plane with lines, under a point light.

    :mod:`examples.paper.table2.shadow` names the source of the scene. The first start is the published start; the
    others are within 2.5 of the origin.
    """
    start = np.array(START) if seed == 0 else np.random.default_rng(seed).uniform(-2.5, 2.5, 2)
    return _shadow(width, height, 1.0, start)


def shadow_mini(width: int, height: int, seed: int) -> Built:
    """Return the scene of :func:`shadow` with a third of the radius, and a start more than 3 units from the truth."""
    rng = np.random.default_rng(seed)
    while True:
        start = rng.uniform(-2.5, 2.5, 2)
        if np.hypot(*(start - SHADOW_TRUTH)) > 3.0:
            return _shadow(width, height, 1.0 / 3.0, start)


def _shadow(width: int, height: int, radius: float, start: FloatArray) -> Built:
    return _moving(
        shadow_scene(width, height, radius),
        {"ball": SHADOW_TRUTH},
        {"ball": start},
        ((0, 1, 0), (0, 0, 1)),
        "yz",
        reach=3.0,
    )


def caustics(width: int, height: int, seed: int) -> Built:
    """Return two glass spheres that focus the light of two emitters out of view on a floor.

    The camera sees a sphere at every position within the bounds. Starts are uniform within 4 of the origin.
    """
    truth = {"ball_1": (-2.6, -0.9), "ball_2": (2.5, 1.3), "lamp_1": (-3.5, -3.0), "lamp_2": (3.0, 2.0)}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 8},
        "sensor": camera(width, height, [0, 14.5, 11.6], [0, 0, 0.4], 45.0),
        "floor": _floor(17.0, [0.7, 0.7, 0.7]),
    }
    for name in ("ball_1", "ball_2"):
        scene[name] = ball([0, 2.3, 0], 1.3, bsdf={"type": "dielectric", "int_ior": 1.5})
    for name, tint in (("lamp_1", [60.0, 36.0, 20.0]), ("lamp_2", [20.0, 36.0, 60.0])):
        scene[name] = ball([0, 16, 0], 1.15, emitter={"type": "area", "radiance": colour(tint)})
    rng = np.random.default_rng(seed)
    return _on_floor(scene, truth, {name: rng.uniform(-4.0, 4.0, 2) for name in truth})


def sort(width: int, height: int, seed: int) -> Built:
    """Return 65 primitives of 65 colours on a floor, sorted by row and hue; each starts near its target."""
    rng = np.random.default_rng(seed)
    return _primitives(
        width, height, lambda target: np.clip(target + rng.uniform(-MAX_OFFSET, MAX_OFFSET, 2), *VISIBLE_FLOOR)
    )


def scattered(width: int, height: int, seed: int) -> Built:
    """Return the scene of :func:`sort` with starts anywhere on the visible floor."""
    rng = np.random.default_rng(seed)
    return _primitives(width, height, lambda _: rng.uniform(*VISIBLE_FLOOR))


def _primitives(width: int, height: int, start: Callable[[FloatArray], FloatArray]) -> Built:
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": camera(width, height, [0, 13, 4.5], [0, 0, 0.2], 42.0),
        "floor": _floor(20.0, [0.35, 0.35, 0.35]),
        "sky": {"type": "constant", "radiance": 0.5},
        "lamp": lamp([4, 14, 6], 1.0, 40.0),
    }
    truth: dict[str, tuple[float, float]] = {}
    for row in range(SORT_ROWS):
        for column in range(SORT_COLUMNS):
            name = f"one_{row}_{column}"
            bsdf = diffuse(_tint(column / SORT_COLUMNS, row))
            if (row + column) % 2:
                scene[name] = ball([0, 0.27, 0], 0.27, bsdf=bsdf)
            else:
                half_height = 0.24 + HEIGHT_STEP * (len(truth) - SORT_ROWS * SORT_COLUMNS // 2)
                up = mi.ScalarTransform4f().translate([0, half_height, 0]).scale([0.24, half_height, 0.24])
                scene[name] = {"type": "cube", "to_world": up, "bsdf": bsdf}
            truth[name] = (0.72 * (column - (SORT_COLUMNS - 1) / 2), 1.3 * (row - (SORT_ROWS - 1) / 2))
    return _on_floor(scene, truth, {name: start(np.array(target)) for name, target in truth.items()})


def _tint(hue: float, row: int) -> list[float]:
    """Return the linear RGB colour of a hue in [0, 1) and a row, from pale to dark."""
    pure = np.clip(np.abs((6.0 * hue + np.array([0.0, 4.0, 2.0])) % 6.0 - 3.0) - 1.0, 0.0, 1.0)
    white, brightness = ((0.55, 1.0), (0.25, 1.0), (0.05, 0.9), (0.05, 0.5), (0.02, 0.22))[row]
    return [float(value) for value in brightness * (white + (1.0 - white) * pure)]


def envlight(width: int, height: int, seed: int) -> Built:
    """Return a glossy ball in a detailed environment, which reflects a distant emitter as one small highlight."""
    return _highlight(width, height, seed, {"type": "envmap", "bitmap": mi.Bitmap(_surroundings())})


def teaser(width: int, height: int, seed: int) -> Built:
    """Return the ball and emitter of :func:`envlight` in a grey environment, for the paper's first figure."""
    return _highlight(width, height, seed, {"type": "constant", "radiance": colour([0.25] * 3)})


def _highlight(width: int, height: int, seed: int, sky: dict[str, Any]) -> Built:
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": camera(width, height, [0, 0, 6], [0, 0, 0], 36.0),
        "ball": ball([0, 0, 0], 1.6, bsdf={"type": "roughconductor", "alpha": 0.02, "specular_reflectance": 0.9}),
        "sky": sky,
        "lamp": lamp([0, 0, 7], 0.25, 60.0),
    }
    start = {"lamp": np.random.default_rng(seed).uniform(-5.0, 5.0, 2)}
    return _moving(scene, {"lamp": (3.0, 2.0)}, start, ((1, 0, 0), (0, 1, 0)), "xy")


def _surroundings() -> Any:
    """Return an environment of noise at five scales and 60 small bright spots: 128 by 256 texels, linear RGB."""
    rng = np.random.default_rng(7)
    total = np.zeros((128, 256, 3))
    for cells in (4, 8, 16, 32, 64):
        coarse = rng.uniform(0.0, 1.0, (cells, 2 * cells, 3))
        total += np.kron(coarse, np.ones((128 // cells, 128 // cells, 1))) / 5.0
    total = 0.8 * total**2
    rows, columns = rng.integers(4, 124, 60), rng.integers(0, 255, 60)
    for row, column in zip(rows, columns, strict=True):
        total[row : row + 2, column : column + 2] = 4.0
    return total.astype(np.float32)


def _floor(size: float, tint: list[float]) -> dict[str, Any]:
    up = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(size)
    return {"type": "rectangle", "to_world": up, "bsdf": diffuse(tint)}


def _on_floor(scene: dict[str, Any], truth: Mapping[str, Any], start: Mapping[str, Any]) -> Built:
    return _moving(scene, truth, start, ((1, 0, 0), (0, 0, 1)), "xz")


def _moving(
    scene: dict[str, Any],
    truth: Mapping[str, Any],
    start: Mapping[str, Any],
    axes: Any,
    letters: str,
    reach: float = REACH,
) -> Built:
    parameters = {
        f"{name}_{letter}": Translate(name, axis) for name in truth for letter, axis in zip(letters, axes, strict=True)
    }
    return Built(scene, parameters, _by_axis(truth, letters), _by_axis(start, letters), reach)


def _by_axis(positions: Mapping[str, Any], letters: str) -> dict[str, float]:
    """Return every coordinate of some positions by the name of its parameter."""
    return {
        f"{name}_{letter}": float(coordinate)
        for name, position in positions.items()
        for letter, coordinate in zip(letters, position, strict=True)
    }


SCENES: Final[Mapping[str, Callable[[int, int, int], Built]]] = {
    "Shadow": shadow,
    "Shadow Mini": shadow_mini,
    "Caustics and Lights": caustics,
    "Sort": sort,
    "Sort, anywhere": scattered,
    "Envlight": envlight,
    "Teaser": teaser,
}

"""The five scenes: what is there, what of it is unknown, and between which bounds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import loi_mitsuba  # noqa: F401 - before Dr.Jit, so that it gets an LLVM that works

# isort: split
import mitsuba as mi
import numpy as np

from examples.effects.parts import ball, camera, colour, diffuse, lamp
from examples.paper.table2.shadow import START, TRUTH
from examples.paper.table2.shadow import scene as shadow_scene
from loi_core.renderers.poses import Translate

__all__ = ["SCENES", "Built", "FloatArray"]

FloatArray = np.ndarray[Any, np.dtype[np.float64]]

REACH: Final = 5.0  # of everything that moves on a floor
ASTRAY: Final = 2.0  # what is to be sorted is at most this far along either axis from where it belongs
SHOWN: Final = np.array([[-4.6, -3.2], [4.6, 3.2]])  # of the floor, from one corner to the other
ROWS, LINE = 5, 13  # of primitives, when sorted
LADDER: Final = 0.0012  # half of what a box is taller than the one before: tops in one plane would flicker
SHADOW: Final = tuple(map(float, TRUTH.values()))  # where the sphere is


@dataclass(frozen=True)
class Built:
    """A scene for one seed.

    Attributes
    ----------
    scene : dict
        For ``mi.load_dict``.
    parameters : dict of Translate
        Each along one axis.
    truth, start : dict of float
        World units, as the bounds.
    reach : float
        Bounds are this on either side of 0.
    """

    scene: dict[str, Any]
    parameters: Mapping[str, Translate]
    truth: Mapping[str, float]
    start: Mapping[str, float]
    reach: float = REACH


def shadow(width: int, height: int, seed: int) -> Built:
    """A sphere out of view throws its shadow on a plane with lines, under a point light; starts within 2.5.

    :mod:`examples.paper.table2.shadow` says whose scene it is. The first start is the published one.
    """
    start = np.array(START) if seed == 0 else np.random.default_rng(seed).uniform(-2.5, 2.5, 2)
    return _shadow(width, height, 1.0, start)


def shadow_mini(width: int, height: int, seed: int) -> Built:
    """The same with a third of the radius; the start is at least three units from the truth."""
    rng = np.random.default_rng(seed)
    while True:
        start = rng.uniform(-2.5, 2.5, 2)
        if np.hypot(*(start - SHADOW)) > 3.0:
            return _shadow(width, height, 1.0 / 3.0, start)


def _shadow(width: int, height: int, radius: float, start: FloatArray) -> Built:
    return _moving(
        shadow_scene(width, height, radius), {"ball": SHADOW}, {"ball": start}, ((0, 1, 0), (0, 0, 1)), "yz", reach=3.0
    )


def caustics(width: int, height: int, seed: int) -> Built:
    """Two glass spheres throw the light of two lamps, which are out of view, on a floor.

    The unit is such that spheres within the bounds are in view; starts are anywhere within 4.
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
    """65 primitives of 65 colours on a floor, by row and hue; each starts within 2 of its place, along either axis."""
    rng = np.random.default_rng(seed)
    return _primitives(width, height, lambda place: np.clip(place + rng.uniform(-ASTRAY, ASTRAY, 2), *SHOWN))


def scattered(width: int, height: int, seed: int) -> Built:
    """The same, anywhere at the start."""
    rng = np.random.default_rng(seed)
    return _primitives(width, height, lambda _: rng.uniform(*SHOWN))


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
    for row in range(ROWS):
        for place in range(LINE):
            name = f"one_{row}_{place}"
            bsdf = diffuse(_tint(place / LINE, row))
            if (row + place) % 2:
                scene[name] = ball([0, 0.27, 0], 0.27, bsdf=bsdf)
            else:
                tall = 0.24 + LADDER * (len(truth) - ROWS * LINE // 2)
                up = mi.ScalarTransform4f().translate([0, tall, 0]).scale([0.24, tall, 0.24])
                scene[name] = {"type": "cube", "to_world": up, "bsdf": bsdf}
            truth[name] = (0.72 * (place - (LINE - 1) / 2), 1.3 * (row - (ROWS - 1) / 2))
    return _on_floor(scene, truth, {name: start(np.array(place)) for name, place in truth.items()})


def _tint(hue: float, row: int) -> list[float]:
    """A colour of a row: hues go round, rows from pale to dark."""
    wheel = np.clip(np.abs((6.0 * hue + np.array([0.0, 4.0, 2.0])) % 6.0 - 3.0) - 1.0, 0.0, 1.0)
    pale, dark = ((0.55, 1.0), (0.25, 1.0), (0.05, 0.9), (0.05, 0.5), (0.02, 0.22))[row]
    return [float(value) for value in dark * (pale + (1.0 - pale) * wheel)]


def envlight(width: int, height: int, seed: int) -> Built:
    """A shining ball in busy surroundings shows a distant lamp as one small highlight."""
    return _highlight(width, height, seed, {"type": "envmap", "bitmap": mi.Bitmap(_surroundings())})


def teaser(width: int, height: int, seed: int) -> Built:
    """The same ball and lamp before a grey sky: the paper's first figure, and no column of the table."""
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
    """Noise of every size and 60 small bright spots, 128 by 256 texels, linear RGB."""
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
    handles = {
        f"{name}_{letter}": Translate(name, axis) for name in truth for letter, axis in zip(letters, axes, strict=True)
    }
    flat = [
        {f"{name}_{letter}": float(one) for name in some for letter, one in zip(letters, some[name], strict=True)}
        for some in (truth, start)
    ]
    return Built(scene, handles, flat[0], flat[1], reach)


SCENES: Final[Mapping[str, Callable[[int, int, int], Built]]] = {
    "Shadow": shadow,
    "Shadow Mini": shadow_mini,
    "Caustics and Lights": caustics,
    "Sort": sort,
    "Sort, anywhere": scattered,
    "Envlight": envlight,
    "Teaser": teaser,
}

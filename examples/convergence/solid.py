"""Ten scenes of Mitsuba: balls and boxes with their shadows on floors."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import numpy as np

import loi_mitsuba
from examples.convergence.case import Case, Trial
from loi_core import Free
from loi_core.support.arrays import Host, to_numpy

__all__ = ["SOLIDS", "scene_on_floor"]

SAMPLES: Final = 16
TARGET_SAMPLES: Final = 256
MIN_DISTANCE: Final = 2.0  # on a floor of 8 by 8


def _floor(pattern: str) -> Host:
    y, x = np.mgrid[:256, :256] / 256
    if pattern == "wood":
        grain = 0.45 + 0.06 * np.sin(60 * x + 3 * np.sin(8 * y)) + 0.03 * np.sin(200 * y + 5 * x)
        wood: Host = (grain[..., None] * np.array([1.0, 0.75, 0.5])).astype(np.float32)
        return wood
    value = {
        "plain": np.full_like(x, 0.5),
        "checkered": np.where((np.floor(10 * x) + np.floor(10 * y)) % 2 == 0, 0.25, 0.65),
        "noisy": np.clip(0.45 + 0.15 * np.random.default_rng(3).standard_normal(x.shape), 0.0, 1.0),
    }[pattern]
    return np.repeat(value[..., None], 3, axis=-1).astype(np.float32)


def scene_on_floor(pattern: str, things: str) -> dict[str, Any]:
    """Return the dict of a lamp and a sky over a patterned floor, which carries the things that a text names."""
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
    at = mi.ScalarTransform4f
    colours = [0.8, 0.1, 0.1], [0.1, 0.2, 0.7]
    red, blue = ({"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}} for colour in colours)
    light = {"type": "area", "radiance": {"type": "rgb", "value": 50.0}}
    texture: dict[str, Any] = {"type": "bitmap", "bitmap": mi.Bitmap(_floor(pattern)), "raw": True}
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": at().look_at([0, -6.5, 5.5], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 128, "height": 96, "sample_border": True, "rfilter": {"type": "box"}},
        },
        "floor": {
            "type": "rectangle",
            "to_world": at().scale([4, 4, 1]),
            "bsdf": {"type": "diffuse", "reflectance": texture},
        },
        "lamp": {"type": "sphere", "center": [2, -1, 5], "radius": 0.3, "emitter": light},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.15}},
    }
    if "ball" in things:
        scene["ball"] = {"type": "sphere", "radius": 0.5, "center": [0, 0, 0], "bsdf": red}
    if "box" in things:
        scene["box"] = {"type": "cube", "to_world": at().scale([0.6, 0.35, 0.35]), "bsdf": blue}
    if "lamp" in things:
        scene["ball"] = {"type": "sphere", "radius": 0.5, "center": [0, 0, 0.5], "bsdf": red}
    return scene


def _solid(floor: str, things: str, seed: int) -> Trial:
    rng = np.random.default_rng(seed)
    handles: dict[str, Any] = {}
    free, goal, allowed = {}, {}, {}
    for thing, height in (("ball", 0.5), ("box", 0.35), ("lamp", 0.0)):
        if thing not in things or (thing == "lamp" and "ball" in things):
            continue
        handles[thing] = loi_mitsuba.Translate(thing)
        while True:
            start, goal_xy = rng.uniform(-2.2, 2.2, (2, 2))
            if np.hypot(*(start - goal_xy)) >= MIN_DISTANCE:
                break
        free[thing] = Free([*start, height], [-2.6, -2.6, height], [2.6, 2.6, height])
        goal[thing], allowed[thing] = np.array([*goal_xy, height]), 0.06 if thing != "lamp" else 0.3
    if "turned" in things:
        handles["turn"] = loi_mitsuba.Rotate("box", (0, 0, 1))
        free["turn"], goal["turn"], allowed["turn"] = Free(0.0, -60.0, 60.0), np.asarray(rng.uniform(-40, 40)), 4.0
    scene = scene_on_floor(floor, things)
    clean = loi_mitsuba.MitsubaRenderer(scene, handles, spp=TARGET_SAMPLES)
    single = {name: np.asarray(value, np.float32) for name, value in goal.items()}
    target = to_numpy(clean.render(clean.parameters() | single, seed=10**6 + seed))
    return Trial(loi_mitsuba.MitsubaRenderer(scene, handles, spp=SAMPLES), target, free, goal, allowed)


SOLIDS: Final = tuple(
    Case(f"Mitsuba: {name}", partial(_solid, floor, things))
    for name, floor, things in (
        ("ball on a plain floor", "plain", "ball"),
        ("ball on wood", "wood", "ball"),
        ("ball on checkers", "checkered", "ball"),
        ("ball on noise", "noisy", "ball"),
        ("box on a plain floor", "plain", "box"),
        ("box on wood", "wood", "box"),
        ("box on checkers", "checkered", "box"),
        ("box on wood, turned", "wood", "box turned"),
        ("ball and box on a plain floor", "plain", "ball box"),
        ("lamp over wood", "wood", "lamp"),
    )
)

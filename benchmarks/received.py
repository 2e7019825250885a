"""Gradients by shadows that fall on what moves, as a Markdown table.

Slopes of a sum of pixels with a weight on one side, by where a shape is, with their standard errors: by central
differences, by our gradient, and by what is left of that without those shadows, which is all that Mitsuba has.

    python -m benchmarks.received    # minutes
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, Translate  # before mitsuba

# isort: split
import mitsuba as mi

from benchmarks.edges import mean_and_error
from examples.effects.parts import GREY, ball, camera, diffuse, floor, lamp
from loi_core.support.markdown import markdown
from loi_mitsuba.boundary.received_shadows import ReceivedShadowBoundary

__all__ = ["main"]

WIDTH, HEIGHT = 96, 72
AXES: Final = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
STEP: Final = 0.02


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=64, help="per pixel of each part of a gradient (default: 64)")
    parser.add_argument("--draws", type=int, default=12, help="gradients for a mean, at least 2 (default: 12)")
    options = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    warnings.simplefilter("ignore", GradientWarning)
    rows = list(_rows(options.samples, options.draws))
    print("\n".join(markdown(["", "central differences", "ours", "without"], rows)))


def _rows(samples: int, draws: int) -> Iterator[list[str]]:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    bump = np.exp(-((columns - 56.0) ** 2 + (rows - 30.0) ** 2) / 150.0)
    weight = np.asarray(bump[..., None] * np.ones(3), dtype=np.float32)
    moves: dict[str, Any] = {name: Translate("block", axis) for name, axis in AXES.items()}
    at = dict.fromkeys(moves, np.float32(0.0))
    for kind, scene in _scenes().items():
        images = MitsubaRenderer(scene, moves, integrator="scene", spp=512, without_gradient=moves)
        ours = _drawn(scene, moves, weight, samples, draws)
        of, ReceivedShadowBoundary.of = ReceivedShadowBoundary.of, lambda *_: None  # type: ignore[method-assign]
        without = _drawn(scene, moves, weight, samples, draws)
        ReceivedShadowBoundary.of = of  # type: ignore[method-assign]
        for name in moves:
            wanted = []
            for seed in range(4):
                ahead, behind = (images.render(at | {name: np.float32(by)}, seed=seed) for by in (STEP, -STEP))
                wanted.append(float(np.sum((ahead.astype(np.float64) - behind) * weight)) / (2.0 * STEP))
            found = (mean_and_error([float(one[name]) for one in drawn], 1) for drawn in (ours, without))
            yield [f"{kind}, {name}", mean_and_error(wanted, 1), *found]


def _drawn(scene: dict[str, Any], moves: dict[str, Any], weight: Any, samples: int, draws: int) -> list[dict[str, Any]]:
    renderer = PlannedRenderer(scene, moves, spp=samples).unabridged
    at = dict.fromkeys(moves, np.float32(0.0))
    return [renderer.vjp(at, weight, seed=seed) for seed in range(draws)]


def _scenes() -> dict[str, dict[str, Any]]:
    place = mi.ScalarTransform4f
    red, grey = ({"bsdf": diffuse(tint)} for tint in ([0.7, 0.2, 0.1], GREY))
    block = ball([0, 0.8, 0], 0.6, **red)
    box = {"type": "cube", "to_world": place().translate([0, 0.8, 0]).rotate([0, 1, 0], 20).scale(0.5), **red}
    above, beside = ball([0.75, 3, 0.5], 0.4, **grey), ball([1.4, 0.8, 0.2], 0.6, **grey)
    wall = {"type": "rectangle", "to_world": place().translate([0, 0, -1]).scale(5), **grey}
    point = {"type": "point", "position": [1.5, 6, 1], "intensity": 90.0}
    sphere = lamp([1.5, 6, 1], 0.7, 60.0)
    sky = {"type": "constant", "radiance": 0.6}
    common = {
        "type": "scene",
        "integrator": {"type": "direct"},
        "sensor": camera(WIDTH, HEIGHT, [0, 6, 6], [0, 0, 0], 30.0),
        "floor": floor(50.0),
    }
    scenes = {
        "ball under a ball, lamp": (block, above, sphere),
        "ball under a ball, point light": (block, above, point),
        "box under a ball, lamp": (box, above, sphere),
        "ball beside a ball, sky": (block, beside, sky),
        "ball before a wall, sky": (block, wall, sky),
    }
    return {
        kind: {**common, "block": block, "other": other, "light": light}
        for kind, (block, other, light) in scenes.items()
    }


if __name__ == "__main__":
    main()

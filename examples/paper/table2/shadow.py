"""``python -m examples.paper shadow``: the paper's first scene, whose light is a point, from many starts.

A sphere that is itself out of view throws its shadow on an upright plane with a grid of lines, under a point light and
a blue sky. Where the sphere is, is fitted from its shadow, by everything's defaults: Mitsuba has no gradient of such a
shadow, and :class:`loi_mitsuba.PlannedRenderer` takes it from a neighbouring scene. Camera, light, sky, samples, start
and truth are those of the released scene of Fischer and Ritschel (CVPR 2023); its sphere and plane are not published,
and ours stand where the text has them. The first start is the published one, others are drawn within 2.5 of the origin.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from loi_core import Free, LOIObjective, fit
from loi_mitsuba import PlannedRenderer, Translate  # before mitsuba

# isort: split
import mitsuba as mi

__all__ = ["START", "TRUTH", "Outcome", "found_from", "main", "scene"]

START: Final = (-0.5, 2.5)
TRUTH: Final = {"y": np.float32(-1.5), "z": np.float32(1.0)}
REACH: Final = 3.0  # the bounds of a fit
FOUND: Final = 0.05  # of the sphere's radius: what counts as found


@dataclass(frozen=True)
class Outcome:
    """Where one fit began and ended, its mean absolute error, its verdict, and its time."""

    start: tuple[float, float]
    end: tuple[float, float]
    mae: float
    verdict: str
    seconds: float

    @property
    def found(self) -> bool:
        """Whether both numbers are right."""
        return max(abs(self.end[0] - float(TRUTH["y"])), abs(self.end[1] - float(TRUTH["z"]))) < FOUND


def scene(width: int, height: int, radius: float = 1.0) -> dict[str, Any]:
    """The scene, for ``mi.load_dict``, with a sphere of this radius."""
    place = mi.ScalarTransform4f
    lines = np.full((256, 256, 3), 0.5, np.float32)
    for k in range(4):
        lines[k::32] = lines[:, k::32] = 0.15
    grid = {"type": "bitmap", "data": mi.TensorXf(lines), "raw": True}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sensor": {
            "type": "perspective",
            "fov": 39.6,
            "to_world": place().look_at([17.66, 0, 0], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
        },
        "plane": {
            "type": "rectangle",
            "to_world": place().rotate([0, 1, 0], 90).scale(12),
            "bsdf": {"type": "diffuse", "reflectance": grid},
        },
        "ball": {"type": "sphere", "center": [12.0, 6.36, 0.0], "radius": radius},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.6, 0.6, 0.99]}},
        "lamp": {"type": "point", "position": [25.98, 13.78, 0.0], "intensity": 1715.0},
    }


def renderer(width: int, height: int, samples: int) -> PlannedRenderer:
    """The scene, with the sphere's height and depth as parameters."""
    return PlannedRenderer(
        scene(width, height),
        {"y": Translate("ball", (0, 1, 0)), "z": Translate("ball", (0, 0, 1))},
        spp=samples,
    )


def found_from(start: tuple[float, float], *, width: int, samples: int, steps: int, seed: int) -> Outcome:
    """What a fit with default settings finds from a start."""
    height = width * 3 // 4
    target = renderer(width, height, 16 * samples).unabridged.render(TRUTH, seed=10**6)
    planned = renderer(width, height, samples)
    free = {name: Free(value, -REACH, REACH) for name, value in zip(TRUTH, start, strict=True)}
    began = time.perf_counter()
    result = fit(planned, LOIObjective(target), steps=steps, seed=seed, optimise=free)
    y, z = (float(result.params[name]) for name in TRUTH)
    mae = 0.5 * (abs(y - float(TRUTH["y"])) + abs(z - float(TRUTH["z"])))
    return Outcome(
        start, (y, z), mae, result.diagnosis.verdict if result.diagnosis else "", time.perf_counter() - began
    )


def main(words: Sequence[str] | None = None) -> None:
    """Fit from every start, and say what came of it."""
    parser = argparse.ArgumentParser(
        prog="python -m examples.paper shadow",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--quick", action="store_true", help="one start, small, few steps")
    parser.add_argument("--starts", type=int, default=10, help="default: 10")
    parser.add_argument("--width", type=int, default=256, help="of the image, whose height is three quarters (256)")
    parser.add_argument("--samples", type=int, default=32, help="per pixel (32)")
    parser.add_argument("--steps", type=int, default=200, help="of each fit (200)")
    parser.add_argument("--json", action="store_true", help="one line of JSON for each fit")
    options = parser.parse_args(words)
    if min(options.starts, options.width // 4, options.samples, options.steps) < 1:
        parser.error("--starts, --samples and --steps must be 1 or more, --width 4 or more")
    if options.quick:
        options.starts, options.width, options.samples, options.steps = 1, 64, 32, 100
    mi.set_variant("llvm_ad_rgb")
    drawn = np.random.default_rng(0).uniform(-2.5, 2.5, (options.starts - 1, 2))
    starts = [START, *((float(y), float(z)) for y, z in drawn)]
    outcomes = []
    if not options.json:
        print("| start | end | MAE | found | verdict | seconds |\n| --- | --- | --- | --- | --- | --- |")
    for number, start in enumerate(starts):
        one = found_from(start, width=options.width, samples=options.samples, steps=options.steps, seed=10**4 * number)
        outcomes.append(one)
        if options.json:
            print(json.dumps(asdict(one) | {"found": one.found}), flush=True)
            continue
        ends = " | ".join(f"({y:.3f}, {z:.3f})" for y, z in (one.start, one.end))
        print(f"| {ends} | {one.mae:.4f} | {one.found} | {one.verdict} | {one.seconds:.0f} |", flush=True)
    if not options.json:
        mean = np.mean([one.mae for one in outcomes])
        print(f"\nfound: {sum(one.found for one in outcomes)} of {len(outcomes)}; mean MAE {mean:.4f}")


if __name__ == "__main__":
    main()

"""``python -m examples.paper shadow``: fit the paper's first scene, lit by a point light, from many starts.

A sphere out of view casts its shadow on an upright plane with a grid of lines, under a point light and a blue sky. The
fit recovers the position of the sphere from its shadow, with default settings. Mitsuba has no gradient of such a
shadow; :class:`loi_mitsuba.PlannedRenderer` computes it in a proxy scene. Camera, light, sky, samples, start and truth
come from the released scene of Fischer and Ritschel (CVPR 2023). Its sphere and plane are not published; here they
follow the text of that paper. The first start is the published start, and the others are uniform within 2.5 of the
origin.
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

__all__ = ["START", "TRUTH", "Outcome", "fit_from", "main", "scene"]

START: Final = (-0.5, 2.5)
TRUTH: Final = {"y": np.float32(-1.5), "z": np.float32(1.0)}
REACH: Final = 3.0  # bound of both parameters, in world units
MAX_FOUND_ERROR: Final = 0.05  # in radii of the sphere, for a start that counts as found


@dataclass(frozen=True)
class Outcome:
    """Start and end of one fit, its mean absolute error, its verdict, and its time; the keys of its JSON."""

    start: tuple[float, float]
    end: tuple[float, float]
    mae: float
    verdict: str
    seconds: float

    @property
    def found(self) -> bool:
        """Whether both parameters are within `MAX_FOUND_ERROR` of the truth."""
        return max(abs(self.end[0] - float(TRUTH["y"])), abs(self.end[1] - float(TRUTH["z"]))) < MAX_FOUND_ERROR


def scene(width: int, height: int, radius: float = 1.0) -> dict[str, Any]:
    """Return the scene for ``mi.load_dict``, with a sphere of a given radius."""
    transform = mi.ScalarTransform4f
    lines = np.full((256, 256, 3), 0.5, np.float32)
    for offset in range(4):
        lines[offset::32] = lines[:, offset::32] = 0.15
    grid = {"type": "bitmap", "data": mi.TensorXf(lines), "raw": True}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sensor": {
            "type": "perspective",
            "fov": 39.6,
            "to_world": transform().look_at([17.66, 0, 0], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
        },
        "plane": {
            "type": "rectangle",
            "to_world": transform().rotate([0, 1, 0], 90).scale(12),
            "bsdf": {"type": "diffuse", "reflectance": grid},
        },
        "ball": {"type": "sphere", "center": [12.0, 6.36, 0.0], "radius": radius},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.6, 0.6, 0.99]}},
        "lamp": {"type": "point", "position": [25.98, 13.78, 0.0], "intensity": 1715.0},
    }


def renderer(width: int, height: int, samples: int) -> PlannedRenderer:
    """Return a renderer of the scene with the height and the depth of the sphere as parameters."""
    return PlannedRenderer(
        scene(width, height),
        {"y": Translate("ball", (0, 1, 0)), "z": Translate("ball", (0, 0, 1))},
        spp=samples,
    )


def fit_from(start: tuple[float, float], *, width: int, samples: int, steps: int, seed: int) -> Outcome:
    """Return the outcome of a fit with default settings from one start."""
    height = width * 3 // 4
    target = renderer(width, height, 16 * samples).unabridged.render(TRUTH, seed=10**6)
    planned = renderer(width, height, samples)
    free = {name: Free(value, -REACH, REACH) for name, value in zip(TRUTH, start, strict=True)}
    started = time.perf_counter()
    result = fit(planned, LOIObjective(target), steps=steps, seed=seed, optimise=free)
    y, z = (float(result.params[name]) for name in TRUTH)
    mae = 0.5 * (abs(y - float(TRUTH["y"])) + abs(z - float(TRUTH["z"])))
    return Outcome(
        start, (y, z), mae, result.diagnosis.verdict if result.diagnosis else "", time.perf_counter() - started
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit from every start, and print the outcomes."""
    parser = argparse.ArgumentParser(
        prog="python -m examples.paper shadow",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--quick", action="store_true", help="one start, a small image, few steps")
    parser.add_argument("--starts", type=int, default=10, help="number of starts (10)")
    parser.add_argument(
        "--width", type=int, default=256, help="width of the image, whose height is three quarters (256)"
    )
    parser.add_argument("--samples", type=int, default=32, help="samples per pixel (32)")
    parser.add_argument("--steps", type=int, default=200, help="steps of each fit (200)")
    parser.add_argument("--json", action="store_true", help="print one line of JSON for each fit")
    options = parser.parse_args(arguments)
    if min(options.starts, options.width // 4, options.samples, options.steps) < 1:
        parser.error("--starts, --samples and --steps must be 1 or more, --width 4 or more")
    if options.quick:
        options.starts, options.width, options.samples, options.steps = 1, 64, 32, 100
    mi.set_variant("llvm_ad_rgb")
    random_starts = np.random.default_rng(0).uniform(-2.5, 2.5, (options.starts - 1, 2))
    starts = [START, *((float(y), float(z)) for y, z in random_starts)]
    outcomes = []
    if not options.json:
        print("| start | end | MAE | found | verdict | seconds |\n| --- | --- | --- | --- | --- | --- |")
    for number, start in enumerate(starts):
        seed = 10**4 * number
        outcome = fit_from(start, width=options.width, samples=options.samples, steps=options.steps, seed=seed)
        outcomes.append(outcome)
        if options.json:
            print(json.dumps(asdict(outcome) | {"found": outcome.found}), flush=True)
            continue
        positions = " | ".join(f"({y:.3f}, {z:.3f})" for y, z in (outcome.start, outcome.end))
        numbers = f"{outcome.mae:.4f} | {outcome.found} | {outcome.verdict} | {outcome.seconds:.0f}"
        print(f"| {positions} | {numbers} |", flush=True)
    if not options.json:
        mean = np.mean([outcome.mae for outcome in outcomes])
        count = sum(outcome.found for outcome in outcomes)
        print(f"\nfound: {count} of {len(outcomes)}; mean MAE {mean:.4f}")


if __name__ == "__main__":
    main()

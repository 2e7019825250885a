"""The gradient by lights and glass that move, three ways, beside the truth: ``python -m benchmarks.lamps``.

The truth is the cotangent of a loss times central differences of images of many samples, the same on both sides. Beside
it stand the mean of some draws of each gradient, with its standard error: *ratio* is its norm over the truth's,
*cosine* that of the angle between them, *noise* the spread of one draw over the norm of the truth. One thread.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

import numpy as np

from loi_core import LOIObjective
from loi_core.renderers import BlurredRenderer
from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, Translate  # before mitsuba

# isort: split
import drjit as dr
import mitsuba as mi

WIDTH, HEIGHT = 96, 72
SAMPLES: Final = 32
STEP: Final = 0.1
AXES: Final = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
HERE: Final = {"x": 1.5, "y": 0.0, "z": -1.0}
FLOOR_KINDS: Final = ("sphere", "panel", "point", "spot")


def camera(origin: list[float], fov: float) -> dict[str, Any]:
    """A small image towards the middle."""
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": mi.ScalarTransform4f().look_at(origin, [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}},
    }


def lamp(kind: str) -> dict[str, Any]:
    """A light seven units above the floor."""
    place = mi.ScalarTransform4f
    glow = {"type": "area", "radiance": 40.0}
    return {
        "sphere": {"type": "sphere", "center": [0, 7, 0], "radius": 0.5, "emitter": glow},
        "panel": {"type": "rectangle", "to_world": place().translate([0, 7, 0]).rotate([1, 0, 0], 90), "emitter": glow},
        "point": {"type": "point", "position": [0, 7, 0], "intensity": 40.0},
        "spot": {
            "type": "spot",
            "to_world": place().look_at([0, 7, 0], [0, 0, 0], [0, 0, 1]),
            "intensity": 40.0,
            "cutoff_angle": 30.0,
        },
    }[kind]


def over_a_floor(kind: str) -> dict[str, Any]:
    """Two balls, one of them glossy, and their shadows."""
    turned = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(8)
    return {
        "type": "scene",
        "integrator": {"type": "direct"},
        "sensor": camera([0, 7, 7], 45.0),
        "floor": {"type": "rectangle", "to_world": turned},
        "ball": {"type": "sphere", "center": [-1, 1.2, 0], "radius": 0.9},
        "other": {
            "type": "sphere",
            "center": [1.5, 0.8, 1],
            "radius": 0.8,
            "bsdf": {"type": "roughconductor", "alpha": 0.2},
        },
        "lamp": lamp(kind),
    }


def glass() -> dict[str, Any]:
    """A ball of clear glass over a floor, under a wide lamp, so that images of many samples can tell the truth."""
    turned = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(8)
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 7},
        "sensor": camera([0, 7, 7], 45.0),
        "floor": {"type": "rectangle", "to_world": turned},
        "ball": {"type": "sphere", "center": [-1, 1.2, 0], "radius": 0.9, "bsdf": {"type": "dielectric"}},
        "lamp": {"type": "sphere", "center": [1, 7, 2], "radius": 1.5, "emitter": {"type": "area", "radiance": 5.0}},
    }


def highlight() -> dict[str, Any]:
    """A nearly perfect mirror of a ball, in which a small lamp behind the camera can be seen."""
    glow = {"type": "area", "radiance": 60.0}
    return {
        "type": "scene",
        "integrator": {"type": "direct"},
        "sensor": camera([0, 0, 6], 36.0),
        "ball": {"type": "sphere", "radius": 1.6, "bsdf": {"type": "roughconductor", "alpha": 0.02}},
        "sky": {"type": "constant", "radiance": 0.25},
        "lamp": {"type": "sphere", "center": [0, 0, 8], "radius": 0.25, "emitter": glow},
    }


def cells(described: dict[str, Any], moved: str, samples: int, draws: int) -> list[str]:
    """Of one scene, what is said of each way."""
    targets = {name: Translate(moved, axis) for name, axis in AXES.items()}
    here = {name: np.float32(value) for name, value in HERE.items()}
    images = MitsubaRenderer(described, targets, integrator="scene", spp=samples, without_gradient=tuple(targets))
    image = images.render(here, seed=2)
    cotangent = LOIObjective(images.render(images.parameters(), seed=1)).value_and_grad(image)[1]
    truth = np.array([difference(images, here, name, cotangent) for name in targets])
    planned = PlannedRenderer(described, targets, spp=SAMPLES)
    planned.begin(here, cotangent, optimise=targets)
    if not planned.plan.followed:
        msg = f"the {moved} that moves is not followed"
        raise RuntimeError(msg)
    ways: list[Callable[..., Mapping[str, Any]] | None] = [partial(_pulled, planned), None]
    if moved != "lamp" or described["lamp"]["type"] not in ("point", "spot"):
        own = MitsubaRenderer(described, targets, spp=SAMPLES)
        ways[1] = own.vjp
    plain = MitsubaRenderer(described, targets, integrator="scene", spp=SAMPLES, without_gradient=tuple(targets))
    ways.append(BlurredRenderer(plain, "2 px", pairs=4).vjp)
    return ["" if pull is None else measured(pull, here, cotangent, truth, draws) for pull in ways]


def _pulled(planned: PlannedRenderer, here: Mapping[str, Any], cotangent: Any, *, seed: int) -> Mapping[str, Any]:
    return planned.render_vjp(here, seed=seed)[1](cotangent)


def measured(pull: Callable[..., Mapping[str, Any]], here: Any, cotangent: Any, truth: Any, draws: int) -> str:
    """Ratio, cosine, noise and seconds of one way."""
    pull(here, cotangent, seed=0)  # which compiles
    begin = time.perf_counter()
    drawn = [pull(here, cotangent, seed=100 + k) for k in range(draws)]
    seconds = (time.perf_counter() - begin) / draws
    found = np.array([[float(one[name]) for name in AXES] for one in drawn])
    size, mean = float(np.linalg.norm(truth)), found.mean(axis=0)
    noise = float(np.linalg.norm(found.std(axis=0, ddof=1))) / size
    norm = float(np.linalg.norm(mean))
    cosine = float(mean @ truth) / norm / size
    return f"{norm / size:.3f} ± {noise / np.sqrt(draws):.3f} / {cosine:.3f} / {noise:.4f} / {seconds:.2f}"


def difference(images: MitsubaRenderer, here: Mapping[str, Any], name: str, cotangent: Any) -> float:
    """Of what the cotangent makes of the image, for one parameter."""
    total = 0.0
    for seed in range(4):
        ahead, behind = (
            images.render({**here, name: here[name] + np.float32(by)}, seed=seed).astype(np.float64)
            for by in (STEP, -STEP)
        )
        total += float(np.sum((ahead - behind) * cotangent)) / (2.0 * STEP) / 4.0
    return total


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=512, help="per pixel of the truth's images")
    parser.add_argument("--draws", type=int, default=16, help="of each gradient")
    options = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(1)
    warnings.simplefilter("ignore", GradientWarning)
    print("| ratio / cosine / noise / seconds | samples that move | Mitsuba's own | images blurred by 2 px, 4 pairs |")
    print("| --- | --- | --- | --- |")
    scenes = {kind: over_a_floor(kind) for kind in FLOOR_KINDS} | {"highlight": highlight(), "glass": glass()}
    for kind, described in scenes.items():
        moved = "ball" if kind == "glass" else "lamp"
        print(f"| {kind} | " + " | ".join(cells(described, moved, options.samples, options.draws)) + " |", flush=True)


if __name__ == "__main__":
    main()

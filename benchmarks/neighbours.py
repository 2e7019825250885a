"""How far the gradient of a neighbouring scene is from the truth: ``python -m benchmarks.neighbours`` from the root.

The truth is central differences of the loss between images of many samples of the scene as it is. Beside it is the mean
of some draws of the pullback, with its standard error, of neighbours of several sizes: *ratio* is its norm over the
truth's, *cosine* that of the angle between them, *noise* the spread of one draw over its norm. A loss of wide local
histograms is what a fit uses far away, one of narrow ones what it uses near the end.

In the case `mirror` the mirror stands still; in `shiny-mirror` and `shiny-plastic` the ball itself is smooth, and
moves.

The case `caustic` is a glass ball in view, with its caustic. There the neighbour stands beside blurred images, noise is
over the norm of the truth, and the truth is of images: the cotangent of a loss times central differences.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from loi_core import LOIObjective, Objective, PixelL2, ScaleSpace
from loi_core.renderers import BlurredRenderer
from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, Translate  # before mitsuba
from loi_mitsuba.proxy.substitutions import MOVING

# isort: split
import mitsuba as mi

WIDTH, HEIGHT = 96, 72
STEP: Final = 0.04
FAR: Final = 0.1  # of central differences between images, whose noise is not the same
OFF: Final = {"x": 0.5, "z": -0.4}  # of the target, from where the gradient is measured
LAMPS: Final[dict[str, dict[str, Any]]] = {
    "point": {"type": "point", "position": [1.0, 9.0, 2.0], "intensity": 300.0},
    "spot": {"type": "spot", "cutoff_angle": 40.0, "beam_width": 38.0, "intensity": 300.0},
    "directional": {"type": "directional", "direction": [-0.1, -1.0, -0.2], "irradiance": 3.0},
}
SIZES: Final[tuple[float, ...]] = (0.005, 0.01, 0.02, 0.05, 0.1)
MIRRORS: Final = (0.01, 0.02, 0.05, 0.1, 0.2)
SHINY: Final = tuple(alpha / MOVING for alpha in (0.05, 0.1, 0.2, 0.3, 0.4, 0.6))  # by how rough what moves then is


def scene(changes: dict[str, Any]) -> dict[str, Any]:
    """A floor with a ball above it, out of view."""
    place = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": place().look_at([0, 6, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}},
        },
        "floor": {"type": "rectangle", "to_world": place().rotate([1, 0, 0], -90).scale(8)},
        "ball": {"type": "sphere", "center": [0, 4.5, 1.2], "radius": 0.5},
        "sky": {"type": "constant", "radiance": 0.1},
        **changes,
    }


def mirror_scene(material: dict[str, Any]) -> dict[str, Any]:
    """The ball, seen in a mirror only."""
    place = mi.ScalarTransform4f
    return scene(
        {
            "floor": {"type": "rectangle", "to_world": place().translate([0, 0, -1]).scale(8), "bsdf": material},
            "ball": {
                "type": "sphere",
                "center": [0, -4.5, 2],
                "radius": 0.8,
                "emitter": {"type": "area", "radiance": 1.0},
            },
        }
    )


def shiny_scene(material: dict[str, Any]) -> dict[str, Any]:
    """The ball in view, near the floor, under a sun and a sky."""
    return scene(
        {
            "integrator": {"type": "path", "max_depth": 4},
            "ball": {"type": "sphere", "center": [0, 1.2, 0], "radius": 0.8, "bsdf": material},
            "lamp": LAMPS["directional"],
            "sky": {"type": "constant", "radiance": 0.3},
        }
    )


def measured(described: dict[str, Any], sizes: dict[str, float], samples: int, draws: int) -> list[str]:
    """Rows of a table for one scene: the cells of each loss, and of each size."""
    targets = {name: Translate("ball", axis) for name, axis in (("x", (1, 0, 0)), ("z", (0, 0, 1)))}
    here = {name: np.float32(0.0) for name in targets}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GradientWarning)
        exact = MitsubaRenderer(described, targets, integrator="scene", spp=samples)
    target = exact.render({name: np.float32(off) for name, off in OFF.items()}, seed=1)
    losses = {
        "wide": LOIObjective(target, ScaleSpace(1.0, 34.0, 0.125)),
        "narrow": LOIObjective(target, ScaleSpace(1.0, 4.0, 0.125)),
    }
    cells = []
    for objective in losses.values():
        truth = np.array([slope(exact, objective, here, name) for name in targets])
        for settings in sizes.items():
            planned = PlannedRenderer(described, targets, spp=64, proxy=dict([settings]))
            everything = planned.unabridged.with_integrator(planned.everything, spp=samples)
            cotangent = objective.value_and_grad(everything.render(here, seed=2))[1]
            drawn = [everything.vjp(here, cotangent, seed=100 + k) for k in range(draws)]
            found = np.array([[float(one[name]) for name in targets] for one in drawn])
            mean, error = found.mean(axis=0), float(np.linalg.norm(found.std(axis=0, ddof=1)))
            size = float(np.linalg.norm(mean))
            cosine = float(mean @ truth) / size / float(np.linalg.norm(truth))
            ratio = size / float(np.linalg.norm(truth))
            spread = error / np.sqrt(draws) / float(np.linalg.norm(truth))
            cells.append(f"{ratio:.3f} ± {spread:.3f} / {cosine:.4f} / {error / size:.2f}")
    return cells


def caustic_scene() -> dict[str, Any]:
    """The ball, of clear glass, near the floor."""
    glow = {"type": "area", "radiance": 25.0}
    return scene(
        {
            "integrator": {"type": "path", "max_depth": 6},
            "ball": {"type": "sphere", "center": [0, 1.2, 0], "radius": 0.8, "bsdf": {"type": "dielectric"}},
            "lamp": {"type": "sphere", "center": [0, 7, -2], "radius": 1.0, "emitter": glow},
        }
    )


def caustics(samples: int, draws: int) -> None:
    """Print the table of the caustic."""
    targets = {name: Translate("ball", axis) for name, axis in (("x", (1, 0, 0)), ("z", (0, 0, 1)))}
    here = {name: np.float32(0.0) for name in targets}
    described = caustic_scene()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GradientWarning)
        exact = MitsubaRenderer(described, targets, integrator="scene", spp=samples)
    target = exact.render({name: np.float32(off) for name, off in OFF.items()}, seed=1)
    image = exact.render(here, seed=2)
    losses: dict[str, Objective] = {
        "pixels": PixelL2(target),
        "wide scales": LOIObjective(target, ScaleSpace(1.0, 34.0, 0.125)),
        "narrow": LOIObjective(target, ScaleSpace(1.0, 4.0, 0.125)),
    }
    near = PlannedRenderer(described, targets, spp=64, blur=None, attached_glass=False).unabridged
    plain = exact.with_integrator("scene", spp=64)
    blurs = {f"blurred by {width}": BlurredRenderer(plain, width) for width in ("1 px", "2 px", "4 px")}
    ways: dict[str, Callable[..., Mapping[str, Any]]] = {"rough glass, alpha 0.05": near.vjp}
    ways |= {name: one.vjp for name, one in blurs.items()}
    seeds = range(50, 54)
    changes = {
        name: [
            exact.render({**here, name: np.float32(FAR)}, seed=k)
            - exact.render({**here, name: np.float32(-FAR)}, seed=k)
            for k in seeds
        ]
        for name in targets
    }
    print("| caustic: ratio / cosine / noise / seconds | " + " | ".join(ways) + " |")
    print("| --- |" + " --- |" * len(ways))
    for label, objective in losses.items():
        cotangent = objective.value_and_grad(image)[1]
        slopes = np.array([[float(np.sum(one * cotangent)) / (2.0 * FAR) for one in changes[name]] for name in targets])
        truth, size = slopes.mean(axis=1), float(np.linalg.norm(slopes.mean(axis=1)))
        cells = []
        for pull in ways.values():
            pull(here, cotangent, seed=0)  # which compiles
            begin = time.perf_counter()
            drawn = [pull(here, cotangent, seed=100 + k) for k in range(draws)]
            seconds = (time.perf_counter() - begin) / draws
            found = np.array([[float(one[name]) for name in targets] for one in drawn])
            mean, error = found.mean(axis=0), float(np.linalg.norm(found.std(axis=0, ddof=1))) / size
            norm = float(np.linalg.norm(mean))
            cosine = float(mean @ truth) / norm / size
            cells.append(
                f"{norm / size:.2f} ± {error / np.sqrt(draws):.2f} / {cosine:.2f} / {error:.1f} / {seconds:.2f}"
            )
        spread = float(np.linalg.norm(slopes.std(axis=1, ddof=1))) / np.sqrt(len(seeds)) / size
        print(f"| {label} (truth ± {spread:.2f}) | " + " | ".join(cells) + " |", flush=True)


def slope(exact: MitsubaRenderer, objective: LOIObjective, here: dict[str, Any], name: str) -> float:
    """Of the loss, between two images of the same samples."""
    values = [float(objective.value(exact.render({**here, name: np.float32(by)}, seed=3))) for by in (STEP, -STEP)]
    return (values[0] - values[1]) / (2.0 * STEP)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=2048, help="per pixel of the truth's images")
    parser.add_argument(
        "--cases",
        nargs="+",
        help="point, spot, directional, mirror, shiny-mirror, shiny-plastic, caustic (default: all)",
    )
    parser.add_argument("--draws", type=int, default=16, help="of each gradient")
    options = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    place = mi.ScalarTransform4f().look_at([1, 9, 2], [0, 4.5, 1.2], [0, 0, 1])
    lamps = {**LAMPS, "spot": {**LAMPS["spot"], "to_world": place}}
    cases = [(kind, "lights", SIZES, scene({"lamp": lamp})) for kind, lamp in lamps.items()]
    cases.append(("mirror", "mirrors", MIRRORS, mirror_scene({"type": "conductor"})))
    for label, kind in (("shiny-mirror", "conductor"), ("shiny-plastic", "plastic")):
        cases.append((label, "mirrors", SHINY, shiny_scene({"type": kind})))
    for label, switch, sizes, described in cases:
        if options.cases and label not in options.cases:
            continue
        print(f"| {label}: ratio / cosine / noise | " + " | ".join(f"{switch} {size:.3g}" for size in sizes) + " |")
        print("| --- |" + " --- |" * len(sizes))
        columns = [measured(described, {switch: size}, options.samples, options.draws) for size in sizes]
        for row, loss in enumerate(("wide", "narrow")):
            print(f"| {loss} scales | " + " | ".join(cells[row] for cells in columns) + " |", flush=True)
        print()
    if not options.cases or "caustic" in options.cases:
        caustics(options.samples, options.draws)


if __name__ == "__main__":
    main()

"""Gradients by boxes: ours, Mitsuba's own, and central differences of images, as a Markdown table.

A red cube on a floor, or above it, that moves along x and turns, in degrees. The numbers are slopes of a sum of pixels
with a weight on one side of the cube, with their standard errors.

    python -m benchmarks.edges    # minutes
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from loi_mitsuba import MitsubaRenderer, PlannedRenderer, Rotate, Translate  # before mitsuba

# isort: split
import drjit as dr
import mitsuba as mi

from examples.effects.parts import camera, diffuse, lamp
from loi_core.support.markdown import markdown

__all__ = ["main", "mean_and_error", "own_slopes"]

WIDTH, HEIGHT = 96, 72
HALF: Final = 0.45
MOVES: Final[dict[str, Any]] = {"x": Translate("cube", [1, 0, 0]), "turn": Rotate("cube", [0, 1, 0])}
AT: Final = {"x": np.float32(0.0), "turn": np.float32(20.0)}
STEPS: Final = {"x": 0.05, "turn": 1.0}
DIRECT: Final = {"type": "direct_projective", "guiding": "none"}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=64, help="per pixel of each part of a gradient (default: 64)")
    parser.add_argument("--draws", type=int, default=6, help="gradients for a mean, at least 2 (default: 6)")
    options = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    print(
        "\n".join(markdown(["", "central differences", "ours", "Mitsuba"], list(_rows(options.samples, options.draws))))
    )


def _rows(samples: int, draws: int) -> Iterator[list[str]]:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    bump = np.exp(-((columns - 60.0) ** 2 + (rows - 36.0) ** 2) / 200.0)
    weight = np.asarray(bump[..., None] * np.ones(3), dtype=np.float32)
    for light in ("lamp", "lamp and sky"):
        for height, where in ((HALF, "on the floor"), (1.0, "above it")):
            scene = _scene(light, height)
            wanted = _differences(scene, weight)
            planned = PlannedRenderer(scene, MOVES, spp=samples).unabridged
            ours = [planned.vjp(AT, weight, seed=seed) for seed in range(draws)]
            theirs = [_own(scene, weight, samples, seed) for seed in range(draws)]
            for name in MOVES:
                found = (mean_and_error([float(one[name]) for one in drawn]) for drawn in (ours, theirs))
                yield [f"{light}, {where}, {name}", mean_and_error(wanted[name]), *found]


def _scene(light: str, height: float) -> dict[str, Any]:
    pose = mi.ScalarTransform4f()
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": camera(WIDTH, HEIGHT, [0, 6, 2.1], [0, 0, 0.1], 42.0),
        "floor": {"type": "rectangle", "to_world": pose.rotate([1, 0, 0], -90).scale(20), "bsdf": diffuse([0.35] * 3)},
        "lamp": lamp([4, 14, 6], 1.0, 40.0),
        "cube": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().translate([0, height, 0]).scale(HALF),
            "bsdf": diffuse([0.6, 0.2, 0.2]),
        },
    }
    return scene | ({"sky": {"type": "constant", "radiance": 0.5}} if "sky" in light else {})


def _differences(scene: dict[str, Any], weight: Any) -> dict[str, list[float]]:
    """Central differences of images with the same random numbers on both sides, of a few seeds."""
    images = MitsubaRenderer(scene, MOVES, integrator="scene", spp=1024, without_gradient=MOVES)

    def side(name: str, by: float, seed: int) -> Any:
        return images.render(AT | {name: AT[name] + np.float32(by)}, seed=seed).astype(np.float64)

    return {
        name: [
            float(np.sum((side(name, step, seed) - side(name, -step, seed)) * weight)) / (2.0 * step)
            for seed in range(3)
        ]
        for name, step in STEPS.items()
    }


def _own(scene: dict[str, Any], weight: Any, samples: int, seed: int) -> dict[str, float]:
    """What Mitsuba itself says, by its own `mi.render`."""
    loaded = mi.load_dict(scene)
    entries = mi.traverse(loaded)
    start = dr.unravel(mi.Point3f, entries["cube.vertex_positions"])
    middle = mi.Vector3f(0.5 * (dr.min(start, axis=1) + dr.max(start, axis=1)))
    leaves = {name: mi.Float(float(value)) for name, value in AT.items()}
    dr.enable_grad(list(leaves.values()))
    place = mi.Transform4f().translate(mi.Vector3f(leaves["x"], 0.0, 0.0) + middle)
    turned = place @ mi.Transform4f().rotate([0, 1, 0], leaves["turn"]) @ mi.Transform4f().translate(-middle)
    entries["cube.vertex_positions"] = dr.ravel(turned @ start)
    return own_slopes(loaded, entries, leaves, weight, samples, seed)


def own_slopes(
    loaded: Any, entries: Any, leaves: dict[str, Any], weight: Any, samples: int, seed: int
) -> dict[str, float]:
    """The slopes of a weighted sum of pixels by what entries of a loaded scene depend on, by Mitsuba alone."""
    entries.update()
    image = mi.render(loaded, entries, integrator=mi.load_dict(DIRECT), spp=samples, seed=seed, seed_grad=seed + 10**6)
    dr.backward(dr.sum(image * mi.TensorXf(weight), axis=None))
    return {name: float(np.array(dr.grad(leaf)).reshape(-1)[0]) for name, leaf in leaves.items()}


def mean_and_error(values: list[float], digits: int = 3) -> str:
    """The mean, and its standard error."""
    return f"{np.mean(values):.{digits}f} ± {np.std(values, ddof=1) / np.sqrt(len(values)):.{digits}f}"


if __name__ == "__main__":
    main()

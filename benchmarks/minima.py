"""Where losses are least near the truth, if a render lacks some light: ``python -m benchmarks.minima`` from the root.

The scene is that of Table 2's *Shadow*. Its ball goes up and down by the truth, and its image is rendered with direct
light alone, as `PlannedRenderer` plans it, and with all light, as the target has it. Printed is where the parabola
through a loss is least, the mean over several renders of 32 samples, in units of the scene.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from examples.paper.table2.problem import COLUMNS, Problem, images_of, numbers
from examples.paper.table2.scenes import Built
from loi_core import LOIObjective, ScaleSpace
from loi_core.objectives import GaussianPyramid, Objective, PixelL2
from loi_mitsuba import MitsubaRenderer

# isort: split
import mitsuba as mi

SAMPLES: Final = 32
SEEDS: Final = 4
HEIGHTS: Final = (-0.02, -0.01, 0.0, 0.01, 0.02)
VARIANT: Final = "llvm_ad_rgb"


def least(renderer: MitsubaRenderer, problem: Problem, objectives: dict[str, Objective]) -> dict[str, float]:
    """How far from the truth each loss is least."""
    values: dict[str, list[float]] = {name: [] for name in objectives}
    for height in HEIGHTS:
        place = numbers({**problem.built.truth, "ball_y": problem.built.truth["ball_y"] + height})
        images = [renderer.render(place, seed=seed) for seed in range(SEEDS)]
        for name, objective in objectives.items():
            values[name].append(float(np.mean([objective.value(image) for image in images])))
    fits = {name: np.polyfit(HEIGHTS, each, 2) for name, each in values.items()}
    return {name: float(-line / (2.0 * square)) for name, (square, line, _) in fits.items()}


def direct(built: Built) -> Built:
    """The scene with light that comes straight from the lamp."""
    return replace(built, scene={**built.scene, "integrator": {"type": "direct"}})


def main() -> None:
    """Print the table."""
    mi.set_variant(VARIANT)
    problem = Problem.of(COLUMNS[0], 0)
    target = problem.target
    objectives: dict[str, Objective] = {
        "scales of `for_image`": LOIObjective(target, accuracy="balanced"),
        "inner scale 1, extents 1 and 5": LOIObjective(target, ScaleSpace(1.0, (1.0, 5.0), 0.05), accuracy="balanced"),
        "pixel L2": PixelL2(target),
        "Gaussian pyramid": GaussianPyramid(target),
    }
    print(f"| image with | {' | '.join(objectives)} |")
    print("| --- " * (1 + len(objectives)) + "|")
    images = {"direct light alone": direct(problem.built), "all light": problem.built}
    for name, built in images.items():
        found = least(images_of(built, SAMPLES), problem, objectives)
        print(f"| {name} | {' | '.join(f'{one:.4f}' for one in found.values())} |", flush=True)


if __name__ == "__main__":
    main()

"""Which way the gradients of Table 2's *Sort* point: 65 shapes that throw shadows on a floor and on each other.

At half the size of the table. First the cosine of the gradient with the way to where the shapes belong, at the start
and halfway, where our loss compares channels and where it compares differences of colours. Then the cosine of gradients
by boxes with central differences of images, where all boxes have one height, so that their tops lie in one plane, and
as the table has them.

    python -m benchmarks.shadows    # minutes
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, get_args

import numpy as np

import loi_mitsuba  # noqa: F401  # before mitsuba, of which the scenes are made

# isort: split
import mitsuba as mi

from examples.paper.table2.problem import COLUMNS, Problem, images_of, numbers
from examples.paper.table2.scenes import Built, FloatArray
from loi_core import LOIObjective
from loi_core.objectives.loi import default_scales
from loi_core.pixels.colours import Colours
from loi_core.support.markdown import markdown
from loi_mitsuba import PlannedRenderer

__all__ = ["main"]

WIDTH: Final = 128
SAMPLES: Final = 64
MANY: Final = 512  # samples of an image whose difference is taken
PLACES: Final = {"start": 0.0, "halfway": 0.5}
BOXES: Final = 16  # whose gradients are compared with central differences
STEP: Final = 0.03  # of a central difference, units of the scene
TALL: Final = 0.24  # half of what boxes of one height have

Way = Mapping[str, float]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=8, help="gradients for a mean, at least 1 (default: 8)")
    options = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    column = next(one for one in COLUMNS if one.name == "Sort")
    problem = Problem.of(replace(column, width=WIDTH, samples=SAMPLES), 0)
    height, width = problem.target.shape[:2]
    extents = default_scales(height, width).alpha
    heading = ["cosine with the way home", *(f"alpha {alpha:g}" for alpha in extents), "all"]
    print("\n".join(markdown(heading, list(_directions(problem, options.draws)))), end="\n\n")
    print("\n".join(markdown(["boxes", "cosine with central differences"], list(_heights(problem, options.draws)))))


def _directions(problem: Problem, draws: int) -> Iterator[list[str]]:
    built, target = problem.built, problem.target
    height, width = target.shape[:2]
    images = PlannedRenderer(built.scene, built.parameters, spp=SAMPLES)
    for name, share in PLACES.items():
        at = _between(built, share)
        home = np.array([built.truth[one] - at[one] for one in built.truth])
        seen = [images.render(numbers(at), seed=seed) for seed in range(draws)]
        for colours in get_args(Colours):
            usual = default_scales(height, width, colours)
            cosines = []
            for alpha in (*((one,) for one in usual.alpha), usual.alpha):
                objective = LOIObjective(target, replace(usual, alpha=alpha), "balanced", colours=colours)
                cosines.append(_cosine(-_gradient(images, built, at, objective, seen), home))
            yield [f"{name}, {colours}", *(f"{one:.2f}" for one in cosines)]


def _heights(problem: Problem, draws: int) -> Iterator[list[str]]:
    names = [name for name in problem.built.truth if problem.built.scene[name[:-2]]["type"] == "cube"]
    some = [str(one) for one in np.random.default_rng(0).choice(names, BOXES, replace=False)]
    for name, built in (("of one height", _level(problem.built)), ("as in the table", problem.built)):
        images = PlannedRenderer(built.scene, built.parameters, spp=SAMPLES)
        at = _between(built, 0.0)
        objective = LOIObjective(problem.target, accuracy="balanced")
        cotangent = objective.value_and_grad(images.render(numbers(at)))[1]
        pulled = [images.unabridged.vjp(numbers(at), cotangent, seed=seed + 1) for seed in range(draws)]
        yield [name, f"{_cosine(_mean(pulled, some), _differences(built, at, cotangent, some)):.2f}"]


def _between(built: Built, share: float) -> dict[str, float]:
    return {name: (1.0 - share) * built.start[name] + share * built.truth[name] for name in built.truth}


def _gradient(images: PlannedRenderer, built: Built, at: Way, objective: LOIObjective, seen: list[Any]) -> FloatArray:
    pulled = [
        images.unabridged.vjp(numbers(at), objective.value_and_grad(image)[1], seed=seed + len(seen))
        for seed, image in enumerate(seen)
    ]
    return _mean(pulled, built.truth)


def _mean(pulled: Sequence[Mapping[str, Any]], names: Iterable[str]) -> FloatArray:
    return np.array([np.mean([float(one[name]) for one in pulled]) for name in names])


def _differences(built: Built, at: Way, cotangent: FloatArray, names: list[str]) -> FloatArray:
    images = images_of(built, MANY)

    def weighed(name: str, step: float) -> float:
        moved = numbers(dict(at) | {name: at[name] + step})
        drawn = [np.asarray(images.render(moved, seed=seed), dtype=np.float64) for seed in (5, 6)]
        return float(np.sum(np.mean(drawn, axis=0) * cotangent))

    return np.array([(weighed(name, STEP) - weighed(name, -STEP)) / (2.0 * STEP) for name in names])


def _level(built: Built) -> Built:
    up = mi.ScalarTransform4f().translate([0, TALL, 0]).scale(TALL)
    scene: dict[str, Any] = {
        name: one | {"to_world": up} if isinstance(one, dict) and one["type"] == "cube" else one
        for name, one in built.scene.items()
    }
    return replace(built, scene=scene)


def _cosine(one: FloatArray, other: FloatArray) -> float:
    return float(one @ other / np.linalg.norm(one) / np.linalg.norm(other))


if __name__ == "__main__":
    main()

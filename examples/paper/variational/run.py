"""One fit, and what it came to."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from examples.paper.variational import kaleidoscope_scene, orb_scene
from examples.paper.variational.objectives import objective
from examples.paper.variational.problem import FloatArray, Problem, as_arrays
from examples.paper.variational.settings import PAIRS, Name, Setting, Size
from loi_core import Free, fit
from loi_core.pixels.psnr import psnr
from loi_core.renderers import BlurredRenderer

__all__ = ["Outcome", "Run", "blurred", "carry_out", "image_at", "problem_of"]

POINTS: Final = 50  # of a path that are kept


@dataclass(frozen=True)
class Run:
    """One fit of a table: of which scene, how, how large, and from which start."""

    scene: Name
    setting: Setting
    size: Size
    seed: int

    @property
    def parts(self) -> tuple[str, ...]:
        """What it is filed under."""
        return self.scene, self.setting.method, f"rate {self.setting.rate:g} sigma {self.setting.sigma:g}"


@dataclass(frozen=True)
class Outcome:
    """What a run came to.

    Attributes
    ----------
    psnr : float
        Of a render at many samples, beside the target: dB, of values as displays want them.
    errors : tuple of float
        Mean absolute error of each group of parameters, in its unit.
    found : bool
        Whether every number is as near as it has to be.
    seconds : float
        Of a step; what else the machine did is in it.
    path : dict of tuples
        The parameters on the way, and at the end.
    image : array, shape (side, side, 3)
        At the end.
    """

    psnr: float
    errors: tuple[float, ...]
    found: bool
    seconds: float
    path: dict[str, tuple[float, ...]]
    image: FloatArray


def problem_of(scene: Name, size: Size) -> Problem:
    """The scene at a size; made once."""
    made = {"kaleidoscope": kaleidoscope_scene.problem, "orb": orb_scene.problem}[scene]
    return made(size.side, size.samples)


def blurred(problem: Problem, setting: Setting) -> BlurredRenderer:
    """The images, blurred over the parameters."""
    sigma = {name: setting.sigma * problem.span(name) for name in problem.truth}
    last = {name: setting.final * one for name, one in sigma.items()}
    return BlurredRenderer(problem.images, sigma, final_sigma=last, pairs=PAIRS)


def image_at(problem: Problem, params: Mapping[str, float], seed: int = 0) -> FloatArray:
    """What is seen with these parameters, at many samples."""
    return problem.close.render(as_arrays(params), seed=seed)


def carry_out(run: Run) -> Outcome:
    """Fit, and measure the last iterate."""
    problem, setting, steps = problem_of(run.scene, run.size), run.setting, run.size.steps
    renderer = blurred(problem, setting)
    start = problem.start(run.seed)
    free = {
        name: Free(value, problem.low[name], problem.high[name], learning_rate=setting.rate * problem.span(name))
        for name, value in start.items()
    }
    way: list[dict[str, float]] = []

    def note(_: Any, params: Any, __: Any) -> None:
        way.append({name: round(float(params[name]), 4) for name in start})

    began = time.perf_counter()
    result = fit(
        renderer,
        objective(setting.method, problem.target),
        steps=steps,
        seed=10**4 * (run.seed + 1),
        optimise=free,
        callback=note,
    )
    seconds = (time.perf_counter() - began) / steps
    found = {name: float(result.params[name]) for name in start}
    kept = [*way[:: max(1, steps // POINTS)], found]
    image = image_at(problem, found)
    return Outcome(
        psnr(image, problem.target),
        tuple(mean for mean, _ in problem.errors(found)),
        problem.is_found(found),
        seconds,
        {name: tuple(round(one[name], 4) for one in kept) for name in start},
        image,
    )

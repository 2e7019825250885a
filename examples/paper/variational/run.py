"""One fit of a scene and its outcome."""

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

PATH_POINTS: Final = 50  # stored points of a path, about


@dataclass(frozen=True)
class Run:
    """One fit of a table: its scene, setting, size and the seed of its start."""

    scene: Name
    setting: Setting
    size: Size
    seed: int

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the folders that hold the record."""
        return self.scene, self.setting.method, f"rate {self.setting.rate:g} sigma {self.setting.sigma:g}"


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run.

    Attributes
    ----------
    psnr : float
        PSNR of a render at many samples against the target, in dB, for display-referred values.
    errors : tuple of float
        Mean absolute error of each group of parameters, in its unit.
    found : bool
        Whether every parameter is within its tolerance.
    seconds : float
        Wall-clock seconds per step, including any other load of the machine.
    path : dict of tuples
        Parameters during the fit and at its end.
    image : array, shape (side, side, 3)
        Image at the end.
    """

    psnr: float
    errors: tuple[float, ...]
    found: bool
    seconds: float
    path: dict[str, tuple[float, ...]]
    image: FloatArray


def problem_of(scene: Name, size: Size) -> Problem:
    """Return the problem of a scene at a size, cached."""
    build = {"kaleidoscope": kaleidoscope_scene.problem, "orb": orb_scene.problem}[scene]
    return build(size.side, size.samples)


def blurred(problem: Problem, setting: Setting) -> BlurredRenderer:
    """Return the renderer of images blurred over the parameters."""
    sigma = {name: setting.sigma * problem.span(name) for name in problem.truth}
    final_sigma = {name: setting.final * value for name, value in sigma.items()}
    return BlurredRenderer(problem.images, sigma, final_sigma=final_sigma, pairs=PAIRS)


def image_at(problem: Problem, params: Mapping[str, float], seed: int = 0) -> FloatArray:
    """Return the image for parameters at many samples."""
    return problem.reference_images.render(as_arrays(params), seed=seed)


def carry_out(run: Run) -> Outcome:
    """Fit the scene, and measure the last iterate."""
    problem, setting, steps = problem_of(run.scene, run.size), run.setting, run.size.steps
    renderer = blurred(problem, setting)
    start = problem.start(run.seed)
    free = {
        name: Free(value, problem.lower[name], problem.upper[name], learning_rate=setting.rate * problem.span(name))
        for name, value in start.items()
    }
    iterates: list[dict[str, float]] = []

    def record(_: Any, iterate: Any, __: Any) -> None:
        iterates.append({name: round(float(iterate[name]), 4) for name in start})

    started = time.perf_counter()
    result = fit(
        renderer,
        objective(setting.method, problem.target),
        steps=steps,
        seed=10**4 * (run.seed + 1),
        optimise=free,
        callback=record,
    )
    seconds = (time.perf_counter() - started) / steps
    params = {name: float(result.params[name]) for name in start}
    path = [*iterates[:: max(1, steps // PATH_POINTS)], params]
    image = image_at(problem, params)
    return Outcome(
        psnr(image, problem.target),
        tuple(mean for mean, _ in problem.errors(params)),
        problem.is_found(params),
        seconds,
        {name: tuple(round(point[name], 4) for point in path) for name in start},
        image,
    )

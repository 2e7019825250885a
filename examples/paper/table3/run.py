"""One fit of Table 3, and its outcome."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import torch

from examples.paper.lib.results import Fit
from examples.paper.table1.run import structure
from examples.paper.table3.objectives import objective
from examples.paper.table3.problem import Column, FloatArray, Problem, image_of
from examples.paper.table3.settings import FINISH_RATE, Setting
from loi_core import ScaleSpace, fit
from loi_core.fitting.adam import Adam
from loi_core.fitting.loop import FitStep, Free
from loi_core.fitting.optimiser import Memory
from loi_core.fitting.parameters import bounds_of
from loi_core.fitting.schedule import MIN_WINDOW, WINDOW_FRACTION, has_settled
from loi_core.fitting.starts import can_search
from loi_core.renderers.contract import Parameters

__all__ = ["CURVE_STEPS", "Outcome", "Run", "carry_out"]

CURVE_STEPS: Final = 10  # between two points of a convergence curve
STEP_DECAY: Final = 0.999  # factor of the rate in each step of the published protocol


class Run(Fit[Setting, Column]):
    """One fit of the table."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run; its fields are the keys of the record.

    Attributes
    ----------
    psnr, ssim : float
        PSNR in dB for a peak of 1, and SSIM, of all views at the last parameters with anti-aliased outlines.
    mae : float
        Mean absolute error of the parameters, in world units, radians and fractions of 1.
    seconds : float
        Wall-clock time of the fit, including the load of the machine.
    curve : tuple of float
        PSNR in dB of the rendered view of every tenth step.
    image : array, shape (side, side, 3)
        Final image of the first view.
    """

    psnr: float
    ssim: float
    mae: float
    seconds: float
    curve: tuple[float, ...]
    image: FloatArray


class _DecayingAdam(Adam):
    """Adam whose rate decays with every step, including the `done` steps of an earlier fit."""

    def __init__(self, done: int) -> None:
        self._done = done

    def step(
        self, params: Parameters, gradient: Parameters, memory: Memory, rates: Mapping[str, float]
    ) -> tuple[Parameters, Memory]:
        factor = STEP_DECAY ** (self._done + int(memory["count"]))
        return super().step(params, gradient, memory, {name: factor * rate for name, rate in rates.items()})

    def identity(self, params: Parameters) -> str:  # noqa: ARG002  # as in Adam
        return f"Adam with a rate that falls, after {self._done} steps"


def carry_out(run: Run) -> Outcome:
    """Fit, and measure the last iterate."""
    torch.set_num_threads(1)
    setting = run.setting
    problem = Problem.of(run.column, run.seed)
    params = {name: torch.as_tensor(value, dtype=torch.float32) for name, value in problem.start.items()}
    curve: list[float] = []
    main_steps = setting.steps - round(setting.steps * setting.finish)
    started = time.perf_counter()
    params, done = _fit_stage(setting, problem, params, main_steps, 0, curve)
    if setting.finish:
        finish = replace(setting, method="pixel_l2")
        params, _ = _fit_stage(finish, problem, params, setting.steps - done, done, curve)
    seconds = time.perf_counter() - started
    result = {name: value.numpy() for name, value in params.items()}
    images = {name: image_of(view, result) for name, view in problem.views.items()}
    error = np.mean([np.mean((images[name] - target) ** 2) for name, target in problem.targets.items()])
    ssim = np.mean([structure(images[name], target) for name, target in problem.targets.items()])
    return Outcome(
        _decibels(float(error)),
        float(ssim),
        _parameter_error(problem, result),
        seconds,
        tuple(round(decibels, 3) for decibels in curve[::CURVE_STEPS]),
        next(iter(images.values())),
    )


def _fit_stage(
    setting: Setting, problem: Problem, start: Parameters, steps: int, done: int, curve: list[float]
) -> tuple[Parameters, int]:
    """Minimise the objective of a setting; return the parameters and the number of steps.

    By our protocol a fit with the LOI objective ends when its loss settles, as a stage of :func:`loi_core.fit` does,
    unless the fit can search for a start. Its far stages take the exposure as given, since the targets are renders
    of the same renderer.
    """
    matches_pixels = setting.method in ("rgbxy", "rgbxy_finetune")
    views = problem.matching_views if matches_pixels else problem.views
    objectives = {name: objective(setting, target) for name, target in problem.targets.items()}
    options: dict[str, Any] = {"steps": steps, "seed": done, "views_per_step": 1}
    settles, far_scales = False, list[ScaleSpace]()
    if setting.name == "published":
        rates = {name: setting.rate * problem.unit(name) for name in start}
        options |= {"decay": "none", "stages": None, "optimiser": _DecayingAdam(done)}
        free = {name: Free(value, learning_rate=rates[name]) for name, value in start.items()}
    else:
        rate = setting.rate if done == 0 else FINISH_RATE * setting.rate
        free = {name: Free(value, *problem.bounds(name)) for name, value in start.items()}
        settles = setting.method == "loi" and not can_search(bounds_of(start, free))
        options |= {"learning_rate": f"{rate} px", "decay": "none" if settles else "cosine"}
        if settles:
            *far, _, _ = ScaleSpace.far_to_near(problem.column.side, problem.column.side)
            far_scales = [replace(scales, centred=False) for scales in far]
            options["stages"] = far_scales

    window = max(MIN_WINDOW, round(WINDOW_FRACTION * steps))
    values: list[float] = []  # loss of every step of the last stage, if the fit settles

    def record(step: FitStep, __: Parameters, images: Any) -> bool:
        name, image = next(iter(images.items()))
        curve.append(_decibels(float(np.mean((image.numpy()[..., :3] - problem.targets[name]) ** 2))))
        if step.stage == len(far_scales):
            values.append(step.value)
        return settles and has_settled(values, window)

    result = fit(views, objectives, optimise=free, callback=record, **options)
    return result.params, len(result.history)


def _decibels(error: float) -> float:
    return -10.0 * float(np.log10(max(error, 1e-15)))


def _parameter_error(problem: Problem, result: Mapping[str, Any]) -> float:
    """Return the mean absolute error of all numbers in units of the protocol; angles modulo a full turn."""
    errors = []
    for name, value in result.items():
        unit = problem.unit(name)
        difference = (np.asarray(value, dtype=np.float64) - problem.goal[name]) / unit
        if unit != 1.0:
            difference = np.abs((difference + np.pi) % (2.0 * np.pi) - np.pi)
        errors.append(np.abs(difference).ravel())
    return float(np.mean(np.concatenate(errors)))

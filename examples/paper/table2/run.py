"""One fit of Table 2, and its outcome."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
import torch

from examples.paper.lib.lpips import lpips
from examples.paper.lib.results import Fit
from examples.paper.table2.problem import Column, Problem, images_of, numbers
from examples.paper.table2.scenes import FloatArray
from examples.paper.table2.settings import (
    FINISH_MOMENTUM,
    FINISH_RATE,
    FINISH_SAMPLES,
    PAPER_SCALES,
    RATE_WIDTH,
    Setting,
)
from loi_core import Free, LOIObjective, fit
from loi_core.objectives import MSSSIM, GaussianPyramid, Objective, PixelL2
from loi_core.pixels.psnr import psnr
from loi_core.renderers import BlurredRenderer
from loi_core.renderers.contract import (
    LossPullback,
    Parameters,
    Pullback,
    Renderer,
    RendererCapabilities,
    capabilities_of,
    render_loss_vjp,
)
from loi_mitsuba import PlannedRenderer
from loi_torch import TorchOptimiser

# isort: split
import drjit as dr
import mitsuba as mi

__all__ = ["CURVE_STEPS", "Outcome", "Run", "carry_out", "objective", "renderer"]

CURVE_STEPS: Final = 5  # between two points of a convergence curve
ARRIVAL_ERROR: Final = 0.05  # world units, mean over the parameters
IMAGE_PAIRS: Final = 5  # for a gradient from images alone: ten renders
VARIANT: Final = "llvm_ad_rgb"  # default variant of Mitsuba


class Run(Fit[Setting, Column]):
    """One fit of the table."""

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the folders that hold the record: setting, method, and column with its width and samples."""
        setting, method, column = super().parts
        return setting, method, f"{column} {self.column.width} {self.column.samples}"


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run; its fields are the keys of the record.

    Attributes
    ----------
    psnr : float
        PSNR in dB of a converged image at the last parameters, in linear RGB clipped to the range from 0 to 1.
    mae : float
        Mean absolute error of the parameters, in world units.
    verdict : str
        Verdict of the diagnosis of the fit.
    setup, seconds : float
        Wall-clock time of the first step with its set-up, and of the whole fit, including the load of the machine.
    step : float
        Seconds per step after the first.
    near : float
        Seconds until the mean error stays below `ARRIVAL_ERROR`; infinite if it does not.
    curve : tuple of float
        PSNR in dB of the noisy image of every fifth step.
    errors, clock : tuple of float
        MAE before every fifth step, and the elapsed seconds.
    path : dict of tuple of float
        Parameters before every fifth step, and at the end.
    image : array, shape (H, W, 3)
        Final image, display-referred.
    """

    psnr: float
    mae: float
    verdict: str
    setup: float
    seconds: float
    step: float
    near: float
    curve: tuple[float, ...]
    errors: tuple[float, ...]
    clock: tuple[float, ...]
    path: dict[str, tuple[float, ...]]
    image: FloatArray


class _RendererWrapper:
    """Base of renderers for the last steps, which change one method of a renderer and delegate the others."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer

    @property
    def capabilities(self) -> RendererCapabilities:
        wrapped = capabilities_of(self._renderer)
        start = None if wrapped.start is None else self.start
        return replace(wrapped, start=start, revisit=self.revisit, render_loss_vjp=self.render_loss_vjp)

    def parameters(self) -> Parameters:
        return self._renderer.parameters()

    def render(self, params: Parameters, *, seed: int = 0) -> Any:
        return self._renderer.render(params, seed=seed)

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Any, Pullback]:
        image, pullback = self.render_loss_vjp(params, seed=seed)
        return image, partial(pullback, None)

    def render_loss_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Any, LossPullback]:
        return render_loss_vjp(self._renderer, params, seed=seed)

    def start(self, *arguments: Any, **options: Any) -> Renderer:
        start = capabilities_of(self._renderer).start
        return self if start is None else self._of(start(*arguments, **options))

    def revisit(self, *arguments: Any, **options: Any) -> Renderer:
        revisit = capabilities_of(self._renderer).revisit
        return self if revisit is None else self._of(revisit(*arguments, **options))

    def _of(self, renderer: Renderer) -> Renderer:
        changed = copy(self)
        changed._renderer = renderer
        return changed


class _NarrowestBlur(_RendererWrapper):
    """Renderer whose blur over parameters, if any, has its final width in every step."""

    def revisit(self, step: int, steps: int, *arguments: Any, **options: Any) -> Renderer:  # noqa: ARG002
        return super().revisit(steps - 1, steps, *arguments, **options)  # every step is as the last


class _ExactImages(_RendererWrapper):
    """Renderer whose images have all light paths and more samples, with unchanged gradients."""

    def __init__(self, renderer: Renderer, problem: Problem) -> None:
        super().__init__(renderer)
        self._images = images_of(problem.built, FINISH_SAMPLES * problem.column.samples)

    def render(self, params: Parameters, *, seed: int = 0) -> Any:
        return self._images.render(params, seed=seed)

    def render_loss_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Any, LossPullback]:
        _, pullback = super().render_loss_vjp(params, seed=seed)
        return self.render(params, seed=seed), pullback


def carry_out(run: Run, variant: str = VARIANT) -> Outcome:
    """Fit, and measure the last iterate."""
    mi.set_variant(variant)
    dr.set_thread_count(1)  # runs share the cores
    setting = run.setting
    problem = Problem.of(run.column, run.seed)
    curve: list[float] = []
    errors: list[float] = []
    clock: list[float] = []
    path: list[dict[str, float]] = []

    def record(_: Any, params: Parameters, image: Any) -> None:
        clock.append(time.perf_counter() - started)
        errors.append(problem.error(params))
        path.append({name: round(float(value), 4) for name, value in params.items()})
        curve.append(psnr(_clipped(image), _clipped(problem.target)))

    bound = problem.built.reach
    rate: float | str = (
        setting.rate if setting.name == "published" else f"{setting.rate * run.column.width / RATE_WIDTH} px"
    )
    free = {name: Free(value, -bound, bound) for name, value in numbers(problem.built.start).items()}
    options: dict[str, Any] = {} if setting.staged else {"stages": None}
    options |= {"decay": "none"} if setting.name == "published" else {}
    started = time.perf_counter()
    finish_steps = round(run.steps * setting.finish)
    gradient_renderer = renderer(setting, problem)
    result = fit(
        gradient_renderer,
        objective(setting, problem.target),
        steps=run.steps - finish_steps,
        learning_rate=rate,
        seed=10**4 * run.seed,
        optimise=free,
        callback=record,
        **options,
    )
    if finish_steps:
        result = fit(
            _ExactImages(gradient_renderer, problem) if setting.exact else _NarrowestBlur(gradient_renderer),
            PixelL2(problem.target),
            steps=finish_steps,
            learning_rate=f"{FINISH_RATE * setting.rate * run.column.width / RATE_WIDTH} px",
            seed=10**4 * run.seed + run.steps,
            optimise={name: Free(value, -bound, bound) for name, value in result.params.items()},
            optimiser=_finish_adam() if setting.exact else None,
            callback=record,
        )
    seconds = time.perf_counter() - started
    image = problem.picture(result.params)
    recorded_path = [*path[::CURVE_STEPS], {name: float(value) for name, value in result.params.items()}]
    return Outcome(
        psnr(_clipped(image), _clipped(problem.target)),
        problem.error(result.params),
        result.diagnosis.verdict if result.diagnosis else "",
        clock[0],
        seconds,
        (seconds - clock[0]) / (run.steps - 1),
        _arrival(errors, clock),
        tuple(round(decibels, 3) for decibels in curve[::CURVE_STEPS]),
        tuple(round(error, 5) for error in errors[::CURVE_STEPS]),
        tuple(round(elapsed, 2) for elapsed in clock[::CURVE_STEPS]),
        {name: tuple(params[name] for params in recorded_path) for name in problem.built.truth},
        _clipped(image) ** (1.0 / 2.2),
    )


def renderer(setting: Setting, problem: Problem) -> Renderer:
    """Return the renderer of a setting, with its gradient."""
    built, samples = problem.built, problem.column.samples
    if not setting.blurred:
        return PlannedRenderer(built.scene, built.parameters, spp=samples)
    return BlurredRenderer(images_of(built, samples), setting.sigma, final_sigma=setting.final_sigma, pairs=IMAGE_PAIRS)


def _finish_adam() -> TorchOptimiser:
    """Return Adam with less momentum than usual, and an `eps` small enough for losses that are means over pixels."""
    return TorchOptimiser(torch.optim.Adam, betas=(FINISH_MOMENTUM, 0.999), eps=1e-15)


def objective(setting: Setting, target: Any) -> Objective:
    """Return the objective of a setting."""
    name = setting.compares
    if name == "loi":
        scales = PAPER_SCALES if setting.name == "published" else None
        return LOIObjective(target, scales, accuracy="balanced", colours=setting.colours)
    if name == "gaussian_pyramid":
        return GaussianPyramid(target)
    if name == "ms_ssim":
        return MSSSIM(target)
    if name == "pixel_l2":
        return PixelL2(target)
    return lpips(np.clip(target, 0.0, 1.0), "alex")


def _arrival(errors: Sequence[float], clock: Sequence[float]) -> float:
    """Return the seconds until the error stays below `ARRIVAL_ERROR`, else infinity."""
    large_steps = [step for step, error in enumerate(errors) if error >= ARRIVAL_ERROR]
    first = large_steps[-1] + 1 if large_steps else 0
    return clock[first] if first < len(clock) else math.inf


def _clipped(image: Any) -> FloatArray:
    clipped: FloatArray = np.clip(np.asarray(image, dtype=np.float64), 0.0, 1.0)
    return clipped

"""One fit, and what it came to."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
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
    UNIT,
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

CURVE_STEPS: Final = 5  # between two points of a curve
NEAR: Final = 0.05  # units of the scene, mean over the parameters
PAIRS: Final = 5  # of images for a gradient from images alone: ten renders
VARIANT: Final = "llvm_ad_rgb"  # of Mitsuba, by default


class Run(Fit[Setting, Column]):
    """One fit of the table."""

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the folders that hold the record: setting, method, and column with its width and samples."""
        setting, method, column = super().parts
        return setting, method, f"{column} {self.column.width} {self.column.samples}"


@dataclass(frozen=True)
class Outcome:
    """What a run came to.

    Attributes
    ----------
    psnr : float
        Of a converged image at the last parameters, clipped to 0 to 1, linear RGB; dB.
    mae : float
        Mean absolute error of the parameters, units of the scene.
    verdict : str
        What the fit says of itself.
    setup, seconds : float
        Until the first step is done, and of the whole fit; what else the machine did is in both.
    step : float
        Seconds that each step takes but the first.
    near : float
        Seconds until the mean error is below `NEAR` and stays there; infinite if it never is.
    curve : tuple of float
        PSNR of every fifth step's own image, with its noise.
    errors, clock : tuple of float
        MAE before every fifth step, and the seconds that had passed.
    path : dict of tuple of float
        The parameters before every fifth step, and at the end.
    image : array, shape (H, W, 3)
        At the end, as a display wants it.
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


class _Finishing:
    """A renderer as it is: what those of a finish change one thing of."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer

    def __getattr__(self, name: str) -> Any:
        return getattr(self._renderer, name)

    @property
    def capabilities(self) -> RendererCapabilities:
        wrapped = capabilities_of(self._renderer)
        return replace(wrapped, at_step=self.at_step, render_loss_vjp=self.render_loss_vjp)

    def parameters(self) -> Parameters:
        return self._renderer.parameters()

    def render(self, params: Parameters, *, seed: int = 0) -> Any:
        return self._renderer.render(params, seed=seed)

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Any, Pullback]:
        image, pullback = self.render_loss_vjp(params, seed=seed)
        return image, partial(pullback, None)

    def render_loss_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Any, LossPullback]:
        return render_loss_vjp(self._renderer, params, seed=seed)

    def at_step(self, step: int, steps: int, value: float | None) -> None:
        wrapped = capabilities_of(self._renderer).at_step
        if wrapped is not None:
            wrapped(step, steps, value)


class _Sharpest(_Finishing):
    """A renderer whose blur over parameters, if it has any, is as narrow as at the end of a fit, in every step."""

    def at_step(self, step: int, steps: int, value: float | None) -> None:  # noqa: ARG002  # it is always the last
        super().at_step(steps - 1, steps, value)


class _Exact(_Finishing):
    """A renderer with images that have all light and more samples than its own, and the gradient that it has anyway."""

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
    dr.set_thread_count(1)  # runs go side by side
    setting = run.setting
    problem = Problem.of(run.column, run.seed)
    curve: list[float] = []
    errors: list[float] = []
    clock: list[float] = []
    way: list[dict[str, float]] = []

    def note(_: Any, params: Parameters, image: Any) -> None:
        clock.append(time.perf_counter() - began)
        errors.append(problem.error(params))
        way.append({name: round(float(value), 4) for name, value in params.items()})
        curve.append(psnr(_seen(image), _seen(problem.target)))

    reach = problem.built.reach
    rate: float | str = setting.rate if setting.name == "published" else f"{setting.rate * run.column.width / UNIT} px"
    free = {name: Free(value, -reach, reach) for name, value in numbers(problem.built.start).items()}
    options: dict[str, Any] = {} if setting.staged else {"stages": None}
    options |= {"decay": "none"} if setting.name == "published" else {}
    began = time.perf_counter()
    last = round(run.steps * setting.finish)
    gradient = renderer(setting, problem)
    result = fit(
        gradient,
        objective(setting, problem.target),
        steps=run.steps - last,
        learning_rate=rate,
        seed=10**4 * run.seed,
        optimise=free,
        callback=note,
        **options,
    )
    if last:
        result = fit(
            _Exact(gradient, problem) if setting.exact else _Sharpest(gradient),
            PixelL2(problem.target),
            steps=last,
            learning_rate=f"{FINISH_RATE * setting.rate * run.column.width / UNIT} px",
            seed=10**4 * run.seed + run.steps,
            optimise={name: Free(value, -reach, reach) for name, value in result.params.items()},
            optimiser=_calmer() if setting.exact else None,
            callback=note,
        )
    seconds = time.perf_counter() - began
    image = problem.picture(result.params)
    kept = [*way[::CURVE_STEPS], {name: float(value) for name, value in result.params.items()}]
    return Outcome(
        psnr(_seen(image), _seen(problem.target)),
        problem.error(result.params),
        result.diagnosis.verdict if result.diagnosis else "",
        clock[0],
        seconds,
        (seconds - clock[0]) / (run.steps - 1),
        _arrival(errors, clock),
        tuple(round(one, 3) for one in curve[::CURVE_STEPS]),
        tuple(round(one, 5) for one in errors[::CURVE_STEPS]),
        tuple(round(one, 2) for one in clock[::CURVE_STEPS]),
        {name: tuple(one[name] for one in kept) for name in problem.built.truth},
        _seen(image) ** (1.0 / 2.2),
    )


def renderer(setting: Setting, problem: Problem) -> Renderer:
    """What gives images and their gradient to a setting."""
    built, samples = problem.built, problem.column.samples
    if not setting.blurred:
        return PlannedRenderer(built.scene, built.parameters, spp=samples)
    return BlurredRenderer(images_of(built, samples), setting.sigma, final_sigma=setting.final_sigma, pairs=PAIRS)


def _calmer() -> TorchOptimiser:
    """Adam with less momentum than usual, and a floor that suits losses that are means over pixels."""
    return TorchOptimiser(torch.optim.Adam, betas=(FINISH_MOMENTUM, 0.999), eps=1e-15)


def objective(setting: Setting, target: Any) -> Objective:
    """The objective of a setting."""
    kind = setting.compares
    if kind == "loi":
        scales = PAPER_SCALES if setting.name == "published" else None
        return LOIObjective(target, scales, accuracy="balanced", colours=setting.colours)
    if kind == "gaussian_pyramid":
        return GaussianPyramid(target)
    if kind == "ms_ssim":
        return MSSSIM(target)
    if kind == "pixel_l2":
        return PixelL2(target)
    return lpips(np.clip(target, 0.0, 1.0), "alex")


def _arrival(errors: Sequence[float], clock: Sequence[float]) -> float:
    """When the error was below the bound and stayed there."""
    far = [step for step, error in enumerate(errors) if error >= NEAR]
    first = far[-1] + 1 if far else 0
    return clock[first] if first < len(clock) else math.inf


def _seen(image: Any) -> FloatArray:
    clipped: FloatArray = np.clip(np.asarray(image, dtype=np.float64), 0.0, 1.0)
    return clipped

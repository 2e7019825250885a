"""One fit of Table 1, and its outcome."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from examples.paper.lib.results import Fit
from examples.paper.table1.moves import ReleasedMoves
from examples.paper.table1.objectives import objective
from examples.paper.table1.problem import RADIUS, Column, Image, Problem
from examples.paper.table1.renderers import BothOrders, Noisy
from examples.paper.table1.settings import Setting
from loi_core import fit
from loi_core.fitting.loop import FitResult, FitStep, Free
from loi_core.objectives import MSSSIM
from loi_core.pixels.psnr import psnr
from loi_core.renderers import Disks
from loi_core.renderers.contract import Parameters

__all__ = ["Outcome", "Run", "carry_out", "structure"]

CURVE_STEPS: Final = 5  # between two points of a convergence curve
RATE_SIDE: Final = 128  # pixels; settings state rates for an image of this side
MAX_FOUND_DISTANCE: Final = 0.5  # pixels between the target and a disk that counts as found


class Run(Fit[Setting, Column]):
    """One fit of the table."""

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the folders that hold the record: setting, method and column."""
        return self.setting.name, self.setting.method, self.column.name

    @property
    def steps(self) -> int:
        """Number of steps of all stages."""
        return sum(stage.steps for stage in self.setting.stages)


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run; its fields are the keys of the record.

    Attributes
    ----------
    psnr, ssim : float
        PSNR in dB for a peak of 1, and SSIM, of the final image against the target without noise, over RGB.
    found : float
        Fraction of the target's disks with a disk of the same colour within `MAX_FOUND_DISTANCE`.
    seconds : float
        Wall-clock time of the fit, including the load of the machine.
    curve : tuple of float
        PSNR in dB after every fifth step.
    image : array, shape (side, side, 3)
        Final image.
    """

    psnr: float
    ssim: float
    found: float
    seconds: float
    curve: tuple[float, ...]
    image: Image


def carry_out(run: Run) -> Outcome:
    """Fit, and measure the chosen iterate."""
    problem = Problem.of(run.column, run.seed)
    disks = problem.disks(confine=run.column.parted and run.setting.moves == "ours")
    margin = 0.0 if _released(run.setting, run.column) else RADIUS
    params = disks.parameters() | {"positions": np.asarray(np.clip(problem.start, margin, run.column.side - margin))}
    params = _renderer(run.setting, run.column, disks).project(params)
    curve: list[float] = []
    done = 0
    started = time.perf_counter()
    for stage in run.setting.stages:
        result, iterates = _fit_stage(stage, problem, disks, params["positions"], done)
        params = result.best_params if stage.kept == "best" else iterates[-1]
        images = [disks.render(iterate) for iterate in iterates[-done % CURVE_STEPS :: CURVE_STEPS]]
        curve += [round(psnr(image, problem.target), 3) for image in images]
        done += stage.steps
    seconds = time.perf_counter() - started
    image = disks.render(params)
    return Outcome(
        psnr(image, problem.target),
        structure(image, problem.target),
        _found_fraction(problem, params["positions"]),
        seconds,
        tuple(curve),
        image,
    )


def _fit_stage(
    stage: Setting, problem: Problem, disks: Disks, start: Image, done: int
) -> tuple[FitResult, list[Parameters]]:
    """Fit one stage from `start`, after `done` steps; return the result and the parameters of every step."""
    margin = 0.0 if _released(stage, problem.column) else RADIUS
    iterates: list[Parameters] = []

    def record(_: FitStep, params: Parameters, __: Image) -> None:
        iterates.append(params)

    result = fit(
        _renderer(stage, problem.column, disks),
        objective(stage, problem.reference),
        steps=stage.steps,
        learning_rate=stage.rate * problem.column.side / RATE_SIDE,
        seed=done,
        decay=stage.decay,
        stages=None,  # a setting lists its stages itself
        optimise={"positions": Free(start, margin, problem.column.side - margin)},
        callback=record,
    )
    return result, iterates


def _released(setting: Setting, column: Column) -> bool:
    return column.parted and setting.moves == "released"


def _renderer(setting: Setting, column: Column, disks: Disks) -> Disks | ReleasedMoves | Noisy | BothOrders:
    if _released(setting, column):
        return ReleasedMoves(disks)
    if setting.noise:
        return Noisy(disks, setting.noise)
    return BothOrders(disks) if setting.both_orders else disks


def structure(image: Image, target: Image) -> float:
    """Return SSIM with Gaussian windows (Wang et al. 2004), 1 for equal images."""
    reference = np.asarray(target, dtype=np.float64)
    return 1.0 - float(MSSSIM(reference, levels=1).value(np.asarray(image, dtype=np.float64)))


def _found_fraction(problem: Problem, positions: Image) -> float:
    offsets = problem.goal[:, None, :] - np.asarray(positions, dtype=np.float64)[None, :, :]
    distances = np.linalg.norm(offsets, axis=-1)
    same_colour = np.all(problem.colours[:, None, :] == problem.colours[None, :, :], axis=-1)
    return float(np.mean(np.min(np.where(same_colour, distances, np.inf), axis=1) < MAX_FOUND_DISTANCE))

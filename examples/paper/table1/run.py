"""One fit, and what it came to."""

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
UNIT: Final = 128  # side of the image whose pixels a rate is in
FOUND: Final = 0.5  # pixels from its place at which a disk counts as found


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
    """What a run came to.

    Attributes
    ----------
    psnr, ssim : float
        Of the final image against the target without noise; dB for a peak of 1, over RGB.
    found : float
        Share of the target's disks with a disk of the same colour within half a pixel.
    seconds : float
        Of the fit; what else the machine did is in it.
    curve : tuple of float
        PSNR after every fifth step.
    image : array, shape (side, side, 3)
        Final.
    """

    psnr: float
    ssim: float
    found: float
    seconds: float
    curve: tuple[float, ...]
    image: Image


def carry_out(run: Run) -> Outcome:
    """Fit, and measure the iterate that counts."""
    problem = Problem.of(run.column, run.seed)
    disks = problem.disks(confine=run.column.parted and run.setting.moves == "ours")
    low = 0.0 if _released(run.setting, run.column) else RADIUS
    params = disks.parameters() | {"positions": np.asarray(np.clip(problem.start, low, run.column.side - low))}
    params = _renderer(run.setting, run.column, disks).project(params)
    curve: list[float] = []
    done = 0
    started = time.perf_counter()
    for stage in run.setting.stages:
        result, seen = _stage(stage, problem, disks, params["positions"], done)
        params = result.best_params if stage.kept == "best" else seen[-1]
        curve += [round(psnr(disks.render(one), problem.target), 3) for one in seen[-done % CURVE_STEPS :: CURVE_STEPS]]
        done += stage.steps
    seconds = time.perf_counter() - started
    image = disks.render(params)
    return Outcome(
        psnr(image, problem.target),
        structure(image, problem.target),
        _found(problem, params["positions"]),
        seconds,
        tuple(curve),
        image,
    )


def _stage(
    stage: Setting, problem: Problem, disks: Disks, start: Image, done: int
) -> tuple[FitResult, list[Parameters]]:
    """One fit from `start`, after as many steps as are done; with the parameters that each of its own steps saw."""
    low = 0.0 if _released(stage, problem.column) else RADIUS
    seen: list[Parameters] = []

    def note(_: FitStep, params: Parameters, __: Image) -> None:
        seen.append(params)

    result = fit(
        _renderer(stage, problem.column, disks),
        objective(stage, problem.reference),
        steps=stage.steps,
        learning_rate=stage.rate * problem.column.side / UNIT,
        seed=done,
        decay=stage.decay,
        stages=None,  # the settings say what comes before what
        optimise={"positions": Free(start, low, problem.column.side - low)},
        callback=note,
    )
    return result, seen


def _released(setting: Setting, column: Column) -> bool:
    return column.parted and setting.moves == "released"


def _renderer(setting: Setting, column: Column, disks: Disks) -> Disks | ReleasedMoves | Noisy | BothOrders:
    if _released(setting, column):
        return ReleasedMoves(disks)
    if setting.noise:
        return Noisy(disks, setting.noise)
    return BothOrders(disks) if setting.both_orders else disks


def structure(image: Image, target: Image) -> float:
    """SSIM with Gaussian windows (Wang et al. 2004), 1 for equal images."""
    wide = np.asarray(target, dtype=np.float64)
    return 1.0 - float(MSSSIM(wide, levels=1).value(np.asarray(image, dtype=np.float64)))


def _found(problem: Problem, places: Image) -> float:
    distance = np.linalg.norm(problem.goal[:, None, :] - np.asarray(places, dtype=np.float64)[None, :, :], axis=-1)
    same = np.all(problem.colours[:, None, :] == problem.colours[None, :, :], axis=-1)
    return float(np.mean(np.min(np.where(same, distance, np.inf), axis=1) < FOUND))

"""One fit, and what it came to."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from examples.paper.table1.moves import ReleasedMoves
from examples.paper.table1.problem import RADIUS, Column, Image, Problem
from examples.paper.table1.settings import Setting
from loi_core import LOIObjective, ScaleSpace, fit
from loi_core.experiment import psnr
from loi_core.fit import FitStep, Free
from loi_core.objectives import MSSSIM, GaussianPyramid, Objective, PixelL2

__all__ = ["Outcome", "Run", "carry_out", "structure"]

CURVE_STEPS: Final = 5  # between two points of a convergence curve
WIDEST: Final = 0.36  # of the side: 45 pixels of 128
UNIT: Final = 128  # side of the image whose pixels a rate is in
FOUND: Final = 0.5  # pixels from its place at which a disk counts as found


@dataclass(frozen=True)
class Run:
    """One fit of the table: how, of what, and from which start."""

    setting: Setting
    column: Column
    seed: int


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
    setting, problem = run.setting, Problem.of(run.column, run.seed)
    disks = problem.disks(confine=run.column.parted and setting.moves == "ours")
    released = run.column.parted and setting.moves == "released"
    renderer = ReleasedMoves(disks) if released else disks
    curve: list[float] = []
    last: dict[str, Image] = {}

    def watch(step: FitStep, params: dict[str, Any], image: Image) -> None:
        last.update(image=image, places=params["positions"])
        if step.step % CURVE_STEPS == 0:
            curve.append(round(psnr(image, problem.target), 3))

    low = 0.0 if released else RADIUS
    high = run.column.side - low
    start = renderer.project(renderer.parameters() | {"positions": np.asarray(np.clip(problem.start, low, high))})
    started = time.perf_counter()
    result = fit(
        renderer,
        objective(setting, problem.reference),
        steps=setting.steps,
        learning_rate=setting.rate * run.column.side / UNIT,
        decay=setting.decay,
        optimise={"positions": Free(start["positions"], low, high)},
        callback=watch,
    )
    seconds = time.perf_counter() - started
    best = setting.kept == "best"
    image, places = (result.image, result.best_params["positions"]) if best else (last["image"], last["places"])
    return Outcome(
        psnr(image, problem.target),
        structure(image, problem.target),
        _found(problem, places),
        seconds,
        tuple(curve),
        image,
    )


def objective(setting: Setting, reference: Image) -> Objective:
    """The objective of a setting."""
    if setting.method == "loi":
        return LOIObjective(reference, _scales(setting, reference), accuracy=setting.accuracy)
    if setting.method == "gaussian_pyramid":
        return GaussianPyramid(reference)
    if setting.method == "ms_ssim":
        return MSSSIM(reference)
    if setting.method == "pixel_l2":
        return PixelL2(reference)
    from loi_torch import LPIPS  # torch is slow to import, and only this method needs it

    return LPIPS(reference, "alex" if setting.method == "lpips_alex" else "vgg")


def _scales(setting: Setting, reference: Image) -> ScaleSpace:
    """The scales of a setting for images like `reference`.

    Unless they are given, their bounds hold all of the reference: where noise is cut off, its mean is no longer 0.
    """
    if isinstance(setting.scales, ScaleSpace):
        return setting.scales
    side = reference.shape[0]
    if setting.scales == "every":
        widths = [1.0, 5.0, 15.0, 45.0]
        while 2.0 * widths[-1] <= WIDEST * side:
            widths.append(2.0 * widths[-1])
        scales = ScaleSpace(widths, widths, 0.125)
    else:
        scales = ScaleSpace.for_image(side, side)
    return replace(scales, bounds=(min(0.0, float(reference.min())), max(1.0, float(reference.max()))))


def structure(image: Image, target: Image) -> float:
    """SSIM with Gaussian windows (Wang et al. 2004), 1 for equal images."""
    wide = np.asarray(target, dtype=np.float64)
    return 1.0 - float(MSSSIM(wide, levels=1).value(np.asarray(image, dtype=np.float64)))


def _found(problem: Problem, places: Image) -> float:
    distance = np.linalg.norm(problem.goal[:, None, :] - np.asarray(places, dtype=np.float64)[None, :, :], axis=-1)
    same = np.all(problem.colours[:, None, :] == problem.colours[None, :, :], axis=-1)
    return float(np.mean(np.min(np.where(same, distance, np.inf), axis=1) < FOUND))

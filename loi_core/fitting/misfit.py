"""The misfit that a fit leaves in the pixels that its parameters move."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from loi_core.fitting.parameters import Bounds
from loi_core.fitting.starts import free_numbers
from loi_core.fitting.views import View, Views
from loi_core.method.blurs import gaussian_blur
from loi_core.objectives import ImageObjective
from loi_core.renderers.contract import Parameters
from loi_core.renderers.units import measure_units
from loi_core.support.arrays import Host, detached, from_numpy, to_numpy

__all__ = ["Misfit", "measure_misfit"]

MAX_NUMBERS: Final = 16  # each takes a render of each view
BLUR_PX: Final = 1.5  # averages noise, and makes the change of an edge linear in a motion of a pixel
MIN_CHANGE: Final = 0.1  # fraction of the largest change through a number below which a pixel does not move
REGRESSION_STEPS: Final = 8  # of reweighted least squares
MIN_RESIDUAL: Final = 1e-3  # units of intensity: bounds the weight of a pixel


@dataclass(frozen=True)
class Misfit:
    """The differences between render and target in the pixels that the free parameters move.

    Attributes
    ----------
    unexplained : float
        Mean absolute difference, as a fraction of the mean absolute contrast of the render there.
    motion : float
        Largest further motion of a parameter, in pixels, that would make the differences smallest to first order.
    """

    unexplained: float
    motion: float


def measure_misfit(views: Views, params: Parameters, bounds: Bounds, seed: int) -> Misfit | None:
    """Return the misfit at parameters; None for many numbers, without a reference, or if no parameter moves a pixel."""
    compared = [
        (view, objective)
        for view in views.by_name.values()
        if isinstance(objective := view.objectives[-1], ImageObjective)
    ]
    if free_numbers(bounds) > MAX_NUMBERS or len(compared) < len(views.by_name):
        return None
    units, _ = measure_units(list(views.by_name.values()), params, bounds, bounds.lower, seed=seed)
    residual, contrast, changes = [], [], []
    for view, objective in compared:
        planes, reference, weights = _planes(view, objective, params, seed)
        moved = [_planes(view, objective, point, seed)[0] - planes for point in _moved(params, bounds, units)]
        if not moved:
            return None
        change = np.stack(moved, axis=-1) * weights[..., None]
        magnitude = np.abs(change)
        largest = magnitude.max(axis=(0, 1, 2), initial=0.0)
        moves = np.any(magnitude > MIN_CHANGE * np.where(largest > 0.0, largest, math.inf), axis=-1)
        counted = np.where(moves, weights, 0.0)
        mean = np.sum(counted * planes, axis=(1, 2), keepdims=True) / np.maximum(
            np.sum(counted, axis=(1, 2), keepdims=True), np.finfo(np.float64).tiny
        )
        residual.append(((reference - planes) * weights)[moves])
        contrast.append(((planes - mean) * weights)[moves])
        changes.append(change[moves])
    difference, slopes = np.concatenate(residual), np.concatenate(changes)
    scale = float(np.sum(np.abs(np.concatenate(contrast))))
    if scale == 0.0:
        return None
    return Misfit(float(np.sum(np.abs(difference))) / scale, _motion(slopes, difference))


def _planes(view: View, objective: ImageObjective[Any], params: Parameters, seed: int) -> tuple[Host, Host, Host]:
    """Return the blurred planes of image and reference, and the weights, shape (N, H, W) each."""
    compared = objective.compared_planes(detached(view.render(params, seed=seed)))
    image, reference, weights = (np.asarray(to_numpy(planes), dtype=np.float64) for planes in compared)
    height, width = image.shape[-2:]
    blur = gaussian_blur(height, width, BLUR_PX, "reflect", like=image)
    return blur.apply(image), blur.apply(reference), weights


def _moved(params: Parameters, bounds: Bounds, units: dict[str, float]) -> Iterator[Parameters]:
    """Yield the parameters with each free number moved by its unit, away from the nearer bound."""
    for name, unit in units.items():
        value, lower, upper = (
            np.asarray(to_numpy(array), dtype=np.float64)
            for array in (params[name], bounds.lower[name], bounds.upper[name])
        )
        for index in np.ndindex(value.shape) if math.isfinite(unit) else ():
            if lower[index] < upper[index]:
                moved = value.copy()
                moved[index] += unit if upper[index] - value[index] >= value[index] - lower[index] else -unit
                yield params | {name: from_numpy(np.clip(moved, lower, upper), params[name])}


def _motion(slopes: Host, difference: Host) -> float:
    """Return the largest entry of the motion with the least sum of absolute differences."""
    weights = np.ones_like(difference)
    motion = np.zeros(slopes.shape[1])
    for _ in range(REGRESSION_STEPS):
        motion = np.linalg.lstsq(slopes * weights[:, None], difference * weights, rcond=1e-3)[0]
        weights = 1.0 / np.sqrt(np.maximum(np.abs(difference - slopes @ motion), MIN_RESIDUAL))
    return float(np.max(np.abs(motion)))

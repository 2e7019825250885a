"""The misfit that a fit leaves in the pixels that its parameters move."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from loi_core.fitting.parameters import MAX_MOVED_NUMBERS, Bounds, Moved, free_numbers, moved_numbers
from loi_core.fitting.views import View, Views
from loi_core.method.blurs import gaussian_blur
from loi_core.objectives import ImageObjective
from loi_core.renderers.contract import Parameters
from loi_core.renderers.units import measure_units
from loi_core.support.arrays import Host, detached, to_numpy

__all__ = ["Misfit", "measure_misfit"]

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
    inert : tuple of str
        Free parameters, or entries of them such as ``positions[1, 0]``, that change no pixel.
    """

    unexplained: float
    motion: float
    inert: tuple[str, ...] = ()


def measure_misfit(views: Views, params: Parameters, bounds: Bounds, seed: int) -> Misfit | None:
    """Return the misfit at parameters; None for many numbers, without a reference, or if no parameter moves a pixel."""
    compared = [
        (view, objective)
        for view in views.by_name.values()
        if isinstance(objective := view.objectives[-1], ImageObjective)
    ]
    if free_numbers(bounds) > MAX_MOVED_NUMBERS or len(compared) < len(views.by_name):
        return None
    units, _ = measure_units(list(views.by_name.values()), params, bounds, bounds.lower, seed=seed)
    points = list(moved_numbers(params, bounds, units))
    if not points:
        return None
    residual, contrast, changes = [], [], []
    effects = np.zeros(len(points))
    for view, objective in compared:
        image, target, weights = _planes(view, objective, params, seed)
        height, width = image.shape[-2:]
        blur = gaussian_blur(height, width, BLUR_PX, "reflect", like=image)
        planes, reference = blur.apply(image), blur.apply(target)
        moved = [blur.apply(_planes(view, objective, point.params, seed)[0]) - planes for point in points]
        change = np.stack(moved, axis=-1) * weights[..., None]
        magnitude = np.abs(change)
        largest = magnitude.max(axis=(0, 1, 2), initial=0.0)
        effects = np.maximum(effects, largest)
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
    return Misfit(float(np.sum(np.abs(difference))) / scale, _motion(slopes, difference), _inert(points, effects))


def _planes(view: View, objective: ImageObjective[Any], params: Parameters, seed: int) -> tuple[Host, Host, Host]:
    """Return the planes of image and reference that are compared, and the weights, shape (N, H, W) each."""
    compared = objective.compared_planes(detached(view.render(params, seed=seed)))
    image, reference, weights = (np.asarray(to_numpy(planes), dtype=np.float64) for planes in compared)
    return image, reference, weights


def _inert(points: Sequence[Moved], effects: Host) -> tuple[str, ...]:
    """Return the names of parameters whose entries all lack an effect, and of single entries that lack one."""
    idle = [point for point, effect in zip(points, effects, strict=True) if effect == 0.0]
    moving = {point.name for point, effect in zip(points, effects, strict=True) if effect != 0.0}
    labels = [
        f"{point.name}[{', '.join(map(str, point.index))}]" if point.name in moving else point.name for point in idle
    ]
    return tuple(dict.fromkeys(labels))


def _motion(slopes: Host, difference: Host) -> float:
    """Return the largest entry of the motion with the least sum of absolute differences."""
    weights = np.ones_like(difference)
    motion = np.zeros(slopes.shape[1])
    for _ in range(REGRESSION_STEPS):
        motion = np.linalg.lstsq(slopes * weights[:, None], difference * weights, rcond=1e-3)[0]
        weights = 1.0 / np.sqrt(np.maximum(np.abs(difference - slopes @ motion), MIN_RESIDUAL))
    return float(np.max(np.abs(motion)))

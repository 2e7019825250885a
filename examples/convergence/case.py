"""A scene of the suite: what may move, from where, and where it is to end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from loi_core import Free, Renderer
from loi_core.support.arrays import Host

__all__ = ["Case", "Trial", "clouds", "within"]


@dataclass(frozen=True)
class Trial:
    """One scene with one random start and goal.

    Attributes
    ----------
    renderer : Renderer
    target : array, shape (H, W, 3)
    free : dict of Free
        Starts and bounds; no rates.
    goal : dict of arrays
    allowed : dict of float
        How far each parameter may be off, in its own unit: about a pixel.
    """

    renderer: Renderer
    target: Host
    free: Mapping[str, Free]
    goal: Mapping[str, Host]
    allowed: Mapping[str, float]


@dataclass(frozen=True)
class Case:
    """One scene by name, and what makes it for a seed."""

    name: str
    make: Callable[[int], Trial]


def within(trial: Trial, params: Mapping[str, Any]) -> tuple[bool, float]:
    """Whether parameters are those of the goal, and the largest error in units of what is allowed."""
    errors = [
        float(np.max(np.abs(np.asarray(params[name], dtype=np.float64) - goal))) / trial.allowed[name]
        for name, goal in trial.goal.items()
    ]
    return max(errors) <= 1.0, max(errors)


def clouds(height: int, width: int, rng: np.random.Generator) -> Host:
    """A picture with the spectrum of photographs, 1 / frequency, and a few edges; shape (height, width, 3)."""
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)[None, :])
    frequency[0, 0] = 1.0
    spectra = np.fft.fft2(rng.standard_normal((3, height, width))) / frequency
    picture = np.moveaxis(np.fft.ifft2(spectra).real, 0, -1)
    picture = (picture - picture.min()) / (np.ptp(picture) + 1e-12)
    rows, columns = np.mgrid[:height, :width]
    for _ in range(8):
        away = np.hypot(rows - rng.uniform(0, height), columns - rng.uniform(0, width))
        cover = 0.5 * np.clip(0.12 * height + 0.5 - away, 0.0, 1.0)[..., None]
        picture = picture * (1.0 - cover) + cover * rng.uniform(size=3)
    limited: Host = np.clip(picture, 0.0, 1.0)
    return limited

"""A scene of the suite: what may move, from where, and where it is to end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import cbook
from PIL import Image

from loi_core import Free, Renderer
from loi_core.support.arrays import Host

__all__ = ["Case", "Trial", "photograph", "within"]


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


def photograph(height: int, width: int, rng: np.random.Generator) -> Host:
    """A random part of the portrait that Matplotlib ships, shape (height, width, 3), as it is stored."""
    with cbook.get_sample_data("grace_hopper.jpg") as file, Image.open(file) as stored:  # type: ignore[union-attr]  # a file, as it is not asked for as an array
        whole = stored.convert("RGB")
    scale = rng.uniform(max(height / whole.height, width / whole.width), 1.0)
    wide, high = min(round(width / scale), whole.width), min(round(height / scale), whole.height)
    left, top = (int(rng.integers(0, room - part + 1)) for room, part in zip(whole.size, (wide, high), strict=True))
    part = whole.crop((left, top, left + wide, top + high)).resize((width, height), Image.Resampling.LANCZOS)
    picture: Host = np.asarray(part, dtype=np.float64) / 255.0
    return picture

"""A scene of the suite: its free parameters, starts and goals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import cbook
from PIL import Image

from loi_core import Free, Renderer
from loi_core.support.arrays import Host

__all__ = ["Case", "Trial", "photograph", "random_crop", "within"]


@dataclass(frozen=True)
class Trial:
    """A scene with a random start and goal.

    Attributes
    ----------
    renderer : Renderer
    target : array, shape (H, W, 3)
    free : dict of Free
        Starts and bounds; no rates.
    goal : dict of arrays
    allowed : dict of float
        Tolerance of each parameter in its unit, about a pixel.
    """

    renderer: Renderer
    target: Host
    free: Mapping[str, Free]
    goal: Mapping[str, Host]
    allowed: Mapping[str, float]


@dataclass(frozen=True)
class Case:
    """A named scene and its constructor for a seed."""

    name: str
    make: Callable[[int], Trial]


def within(trial: Trial, params: Mapping[str, Any]) -> tuple[bool, float]:
    """Return whether parameters are within their tolerances of the goal, and the largest error in tolerances."""
    errors = [
        float(np.max(np.abs(np.asarray(params[name], dtype=np.float64) - goal))) / trial.allowed[name]
        for name, goal in trial.goal.items()
    ]
    return max(errors) <= 1.0, max(errors)


def photograph(height: int, width: int, rng: np.random.Generator) -> Host:
    """Return a random crop of Matplotlib's portrait, shape (height, width, 3), sRGB."""
    with cbook.get_sample_data("grace_hopper.jpg") as file, Image.open(file) as stored:  # type: ignore[union-attr]  # returns a file by default
        whole = stored.convert("RGB")
    return random_crop(whole, height, width, rng)


def random_crop(whole: Image.Image, height: int, width: int, rng: np.random.Generator) -> Host:
    """Return a crop of a picture at a random place and scale, shape (height, width, 3), sRGB."""
    scale = rng.uniform(max(height / whole.height, width / whole.width), 1.0)
    crop_width, crop_height = min(round(width / scale), whole.width), min(round(height / scale), whole.height)
    left, top = (
        int(rng.integers(0, available - length + 1))
        for available, length in zip(whole.size, (crop_width, crop_height), strict=True)
    )
    crop = whole.crop((left, top, left + crop_width, top + crop_height)).resize(
        (width, height), Image.Resampling.LANCZOS
    )
    picture: Host = np.asarray(crop, dtype=np.float64) / 255.0
    return picture

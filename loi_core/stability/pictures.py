"""Small images that hard cases are made of: float64, exact in float32, so that both dtypes see the same numbers."""

from __future__ import annotations

from typing import Final

import numpy as np

from loi_core.support.arrays import Host

__all__ = ["SHAPE", "board", "flat", "noise", "ramp", "render", "single"]

SHAPE: Final = (16, 20, 3)


def single(values: Host) -> Host:
    """The nearest numbers that float32 holds, in float64."""
    with np.errstate(under="ignore"):  # what float32 cannot hold becomes 0
        rounded: Host = values.astype(np.float32).astype(np.float64)
    return rounded


def flat(level: float, shape: tuple[int, ...] = SHAPE) -> Host:
    """One intensity everywhere."""
    return single(np.full(shape, level))


def render(row: float, column: float, shape: tuple[int, ...] = SHAPE) -> Host:
    """A bright disk with a soft edge on a dark ground, its centre at a share of the height and of the width."""
    height, width, channels = shape
    rows, columns = np.mgrid[:height, :width]
    away = np.hypot(rows - row * height, columns - column * width)
    cover = np.clip(0.2 * min(height, width) + 1.0 - away, 0.0, 1.0)[..., None]
    ground, colour = np.linspace(0.08, 0.2, channels), np.linspace(0.95, 0.5, channels)
    return single(ground + cover * (colour - ground))


def ramp(shape: tuple[int, ...] = SHAPE, low: float = 0.0, high: float = 1.0) -> Host:
    """From `low` at the left to `high` at the right."""
    return single(np.broadcast_to(np.linspace(low, high, shape[-2])[:, None], shape))


def board(shape: tuple[int, ...] = SHAPE, first: float = 0.0, second: float = 1.0) -> Host:
    """A checkerboard of single pixels: the finest pattern that the grid holds."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return single(np.broadcast_to(np.where((rows + columns) % 2 == 0, first, second)[..., None], shape))


def noise(shape: tuple[int, ...] = SHAPE, seed: int = 0, low: float = 0.0, high: float = 1.0) -> Host:
    """Independent pixels, the same for every call."""
    return single(np.random.default_rng(seed).uniform(low, high, shape))

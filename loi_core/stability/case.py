"""The record of a hard case, and the small images that cases are made of.

Images are float64 and exact in float32, so that both dtypes see the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from loi_core.method.scales import ScaleSpace
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import Host

__all__ = [
    "SCALES",
    "SHAPE",
    "HardCase",
    "Pair",
    "as_float32",
    "checkerboard",
    "disk",
    "flat",
    "noise",
    "pair",
    "pair_with_outliers",
    "ramp",
]

Pair: TypeAlias = tuple[Host, Host]
"""An image and its reference."""

SCALES: Final = ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125)
SHAPE: Final = (16, 20, 3)


@dataclass(frozen=True)
class HardCase:
    """One numerically hard input of the loss.

    Attributes
    ----------
    name : str
    danger : str
        The failure that the case could provoke, in one line.
    answer : str
        The library's behaviour, in one line.
    make : callable
        Returns the image and the reference, both float64, shape (*batch, H, W, C).
    scales : ScaleSpace
    nan_policy : {"raise", "mask"}
    error : type of exception, optional
        The error that must be raised; None if there must be a result.
    layout : callable, optional
        Memory layout or type of the image, as a function from an array to another. Such an image is passed to the core
        without conversion.
    half : bool
        Whether images of 16 bits are tried as well.
    """

    name: str
    danger: str
    answer: str
    make: Callable[[], Pair]
    scales: ScaleSpace = SCALES
    nan_policy: NanPolicy = "raise"
    error: type[Exception] | None = None
    layout: Callable[[Host], Host] | None = None
    half: bool = False

    def __str__(self) -> str:
        return self.name


def as_float32(values: Host) -> Host:
    """Return `values` rounded to float32, in float64."""
    with np.errstate(under="ignore"):  # values too small for float32 become 0
        rounded: Host = values.astype(np.float32).astype(np.float64)
    return rounded


def flat(level: float, shape: tuple[int, ...] = SHAPE) -> Host:
    """Return an image of one intensity."""
    return as_float32(np.full(shape, level))


def disk(row: float, column: float, shape: tuple[int, ...] = SHAPE) -> Host:
    """Return a bright disk with a soft edge on a dark ground, its centre at a fraction of the height and width."""
    height, width, channels = shape
    rows, columns = np.mgrid[:height, :width]
    distance = np.hypot(rows - row * height, columns - column * width)
    cover = np.clip(0.2 * min(height, width) + 1.0 - distance, 0.0, 1.0)[..., None]
    ground, colour = np.linspace(0.08, 0.2, channels), np.linspace(0.95, 0.5, channels)
    return as_float32(ground + cover * (colour - ground))


def ramp(shape: tuple[int, ...] = SHAPE, low: float = 0.0, high: float = 1.0) -> Host:
    """Return a ramp from `low` at the left to `high` at the right."""
    return as_float32(np.broadcast_to(np.linspace(low, high, shape[-2])[:, None], shape))


def checkerboard(first: float = 0.0, second: float = 1.0) -> Host:
    """Return a checkerboard of single pixels, the finest pattern on the grid."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return as_float32(np.broadcast_to(np.where((rows + columns) % 2 == 0, first, second)[..., None], SHAPE))


def noise(shape: tuple[int, ...] = SHAPE, seed: int = 0) -> Host:
    """Return independent pixels in [0, 1), the same at every call."""
    return as_float32(np.random.default_rng(seed).uniform(0.0, 1.0, shape))


def pair() -> Pair:
    """Return a disk, and the same disk at another position."""
    return disk(0.35, 0.3), disk(0.6, 0.7)


def pair_with_outliers(value: float, *, count: int = 1) -> Pair:
    """Return the pair of disks with some pixels of the image replaced by `value`."""
    image, reference = pair()
    for index in range(count):
        image[3 + 2 * index, (7 + 5 * index) % SHAPE[1], index % SHAPE[2]] = value
    return as_float32(image), reference

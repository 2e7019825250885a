"""The problems of the one-dimensional figures: what moves, where it belongs, and what the reference looks like."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from examples.paper.figures.signals import DiskRow, Host, Line, Movers

__all__ = ["NOISE", "PROBLEMS", "SUPPORT", "TONAL", "TWO", "Problem"]

RADIUS: Final = 5.7  # no whole number, nor half of one: the two edges never cross borders of pixels at once


@dataclass(frozen=True)
class Problem:
    """Find the parameters that a reference shows.

    Attributes
    ----------
    name : str
    movers : Movers
    target, start : tuple of float
        Parameters of the reference, and those that pictures show beside it, in pixels.
    spacing : float
        Pixels between the starts that are tried.
    noise : float
        Standard deviation of what is added to every pixel of the reference.
    seeds : int
        How many references there are, which differ by their noise.
    """

    name: str
    movers: Movers
    target: tuple[float, ...]
    start: tuple[float, ...]
    spacing: float = 0.05
    noise: float = 0.0
    seeds: int = 1

    def reference(self, seed: int = 0) -> Host:
        """The image to match, shape (H, W)."""
        image: Host = self.movers.images(np.array([self.target]))[0]
        return image + self.noise * np.random.default_rng(seed).standard_normal(image.shape)


def _row(*intensities: float, apart: float = 22.4, background: float = 0.0) -> Line:
    """Intervals that move together."""
    count = len(intensities)
    anchors = tuple(index * apart for index in range(count))
    return Line(128, (RADIUS,) * count, intensities, anchors, (0,) * count, background)


def _passing(intensity: float, other: float) -> Line:
    """An interval that moves, in front of one that does not."""
    return Line(96, (RADIUS, 4.6), (other, intensity), (44.2, 0.0), (None, 0))


def _noisy(strength: float, *, picture: bool) -> Problem:
    grey = {"intensities": (0.75,), "background": 0.25}
    if picture:
        movers: Movers = DiskRow(64, (RADIUS,), **grey)  # type: ignore[arg-type]  # of different types by key
        return Problem(f"picture, noise {strength:g}", movers, (45.3,), (16.3,), 0.25, strength, 5)
    movers = Line(96, (RADIUS,), **grey)  # type: ignore[arg-type]  # likewise
    return Problem(f"signal, noise {strength:g}", movers, (67.3,), (24.3,), 0.1, strength, 10)


SUPPORT: Final = (
    Problem("signal", Line(96, (RADIUS,), (1.0,)), (67.3,), (24.3,)),
    Problem("picture", DiskRow(64, (RADIUS,), (1.0,)), (45.3,), (16.3,), 0.1),
)
TONAL: Final = (
    Problem("three intensities in a row", _row(1.0, 0.3, 0.65), (64.3,), (18.3,)),
    Problem("the same on grey", _row(1.0, 0.0, 0.75, background=0.5), (64.3,), (18.3,)),
    Problem("light and dark in turns", _row(0.9, 0.1, 0.9, 0.1, apart=12.4, background=0.5), (64.3,), (18.3,)),
    Problem("a bright one past a dim one", _passing(1.0, 0.5), (71.3,), (18.3,)),
    Problem("a dim one past a bright one", _passing(0.5, 1.0), (71.3,), (18.3,)),
)
TWO: Final = Problem(
    "two, each its own way",
    Line(80, (RADIUS, RADIUS), (1.0, 0.5), (0.0, 0.0), (0, 1)),
    (26.3, 55.6),
    (12.3, 28.6),
)
NOISE: Final = tuple(_noisy(strength, picture=picture) for picture in (False, True) for strength in (0.1, 0.2))
PROBLEMS: Final = (*SUPPORT, *TONAL, *NOISE)

"""Problems of the one-dimensional figures: the moving objects, their target and the noise of the reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from examples.paper.figures.signals import DiskRow, Host, Line, MovingObjects

__all__ = ["NOISE", "PROBLEMS", "SUPPORT", "TONAL", "TWO", "Problem"]

RADIUS: Final = 5.7  # pixels; twice the radius is no whole number, so the two edges never cross pixel borders at once


@dataclass(frozen=True)
class Problem:
    """Find the parameters that a reference shows.

    Attributes
    ----------
    name : str
    objects : MovingObjects
    target : tuple of float
        Parameters of the reference, in pixels.
    start : tuple of float
        Parameters that the pictures show beside the reference, in pixels.
    spacing : float
        Distance between the starts of the descents, in pixels.
    noise : float
        Standard deviation of the noise on every pixel of the reference.
    seeds : int
        Number of references, which differ in their noise.
    """

    name: str
    objects: MovingObjects
    target: tuple[float, ...]
    start: tuple[float, ...]
    spacing: float = 0.05
    noise: float = 0.0
    seeds: int = 1

    def reference(self, seed: int = 0) -> Host:
        """Return the image to match, shape (H, W)."""
        image: Host = self.objects.images(np.array([self.target]))[0]
        return image + self.noise * np.random.default_rng(seed).standard_normal(image.shape)


def _row(*intensities: float, spacing: float = 22.4, background: float = 0.0) -> Line:
    """Return intervals that move together."""
    count = len(intensities)
    anchors = tuple(index * spacing for index in range(count))
    return Line(128, (RADIUS,) * count, intensities, anchors, (0,) * count, background)


def _passing(moving_intensity: float, fixed_intensity: float) -> Line:
    """Return an interval that moves in front of a fixed one."""
    return Line(96, (RADIUS, 4.6), (fixed_intensity, moving_intensity), (44.2, 0.0), (None, 0))


def _noisy(strength: float, *, picture: bool) -> Problem:
    grey = {"intensities": (0.75,), "background": 0.25}
    if picture:
        objects: MovingObjects = DiskRow(64, (RADIUS,), **grey)  # type: ignore[arg-type]  # types differ by key
        return Problem(f"picture, noise {strength:g}", objects, (45.3,), (16.3,), 0.25, strength, 5)
    objects = Line(96, (RADIUS,), **grey)  # type: ignore[arg-type]  # likewise
    return Problem(f"signal, noise {strength:g}", objects, (67.3,), (24.3,), 0.1, strength, 10)


SUPPORT: Final = (
    Problem("signal", Line(96, (RADIUS,), (1.0,)), (67.3,), (24.3,)),
    Problem("picture", DiskRow(64, (RADIUS,), (1.0,)), (45.3,), (16.3,), 0.1),
)
TONAL: Final = (
    Problem("three intensities in a row", _row(1.0, 0.3, 0.65), (64.3,), (18.3,)),
    Problem("the same on grey", _row(1.0, 0.0, 0.75, background=0.5), (64.3,), (18.3,)),
    Problem("light and dark in turns", _row(0.9, 0.1, 0.9, 0.1, spacing=12.4, background=0.5), (64.3,), (18.3,)),
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

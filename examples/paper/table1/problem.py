"""The problem to solve: move disks from random positions to a grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from loi_core.renderers import Disks

__all__ = ["COLUMNS", "HARDER", "Column", "FloatArray", "Image", "Problem"]

FloatArray: TypeAlias = np.ndarray[Any, np.dtype[np.float64]]
Image: TypeAlias = np.ndarray[Any, Any]  # float32
Colours = Literal["primaries", "random"]

RADIUS: Final = (
    16.0 / 7.0
)  # pixels, of every disk: 3 in the 168 pixels of the released code, whose images have 128 here
FRINGE: Final = 1 / 8  # fraction of the side between the frame and the outermost centres of the grid
SPREAD: Final = 1 / 8  # standard deviation of the start about the centre, as a fraction of the side
PRIMARIES: Final = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # in turn, over black
MIN_BRIGHTEST_CHANNEL: Final = 0.2  # of a random colour


@dataclass(frozen=True)
class Column:
    """One column of the table.

    Attributes
    ----------
    name : str
    disks : int
        Number of disks.
    side : int
        Side of the square image, in pixels.
    colours : {"primaries", "random"}
        Green, red and blue in turn, or a random colour for each disk. A fit knows all colours.
    noise : float
        Standard deviation of the Gaussian noise on the target.
    parted : bool
        Whether each step ends with pushes that separate overlapping disks.
    """

    name: str
    disks: int
    side: int = 128
    colours: Colours = "primaries"
    noise: float = 0.0
    parted: bool = True


COLUMNS: Final = tuple(Column(str(count), count) for count in (4, 16, 32, 64, 256))
HARDER: Final = (
    Column("1024 at 256x256", 1024, side=256),
    Column("64, random colours", 64, colours="random"),
    Column("64, not parted", 64, parted=False),
    Column("64, 10 % noise", 64, noise=0.1),
)


@dataclass(frozen=True)
class Problem:
    """One start and its target.

    Attributes
    ----------
    column : Column
    goal, start : array, shape (n, 2)
        Centres (x, y) in pixels: the grid of the target, and the start of the fit.
    colours : array, shape (n, 3)
        Linear RGB.
    target : array, shape (side, side, 3), float32
        Image without noise, for the measures of the result.
    reference : array, shape (side, side, 3), float32
        Image with noise, for the objective of the fit.
    """

    column: Column
    goal: FloatArray
    start: FloatArray
    colours: FloatArray
    target: Image
    reference: Image

    @classmethod
    def of(cls, column: Column, seed: int) -> Problem:
        """Return the problem of a column and seed; all seeds share the grid."""
        rng = np.random.default_rng([seed, column.disks])
        start = rng.normal(0.5 * column.side, SPREAD * column.side, (column.disks, 2))
        colours = _colours(column, rng)
        goal = _grid(column)
        target = _disks(column, goal, colours, confine=False).render(_parameters(column, goal, colours))
        noise = column.noise * rng.standard_normal(target.shape)
        return cls(column, goal, start, colours, target, (target + noise).astype(np.float32))

    def disks(self, *, confine: bool) -> Disks:
        """Return the renderer at the start; `confine` keeps disks in the frame and, between steps, apart."""
        return _disks(self.column, self.start, self.colours, confine=confine)


def _disks(column: Column, positions: FloatArray, colours: FloatArray, *, confine: bool) -> Disks:
    return Disks(column.side, column.side, positions, RADIUS, colours, dtype="float32", confine=confine)


def _parameters(column: Column, positions: FloatArray, colours: FloatArray) -> dict[str, FloatArray]:
    return {"positions": positions, "radii": np.full(column.disks, RADIUS), "colours": colours}


def _grid(column: Column) -> FloatArray:
    """Return the first `disks` points of the smallest square grid with enough points, column by column."""
    points_per_side = math.isqrt(column.disks - 1) + 1
    line = np.linspace(FRINGE * column.side, (1.0 - FRINGE) * column.side, points_per_side)
    points: FloatArray = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    return points[: column.disks]


def _colours(column: Column, rng: np.random.Generator) -> FloatArray:
    if column.colours == "primaries":
        return np.array(PRIMARIES)[np.arange(column.disks) % len(PRIMARIES)]
    uniform: FloatArray = rng.uniform(size=(column.disks, 3))
    brightest = uniform.max(axis=-1, keepdims=True)
    colours: FloatArray = uniform / brightest * np.maximum(brightest, MIN_BRIGHTEST_CHANNEL)
    return colours

"""What is to be found: disks on a grid, from a random start."""

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

RADIUS: Final = 16.0 / 7.0  # of every disk, pixels: 3 on the 168 pixels of the released code, 128 here
FRINGE: Final = 1 / 8  # of the side, between the frame and the outermost centres of the grid
SPREAD: Final = 1 / 8  # of the side: standard deviation of the start about the middle
PRIMARIES: Final = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # taken in turn, over black
DIMMEST: Final = 0.2  # a random colour's brightest channel is at least this


@dataclass(frozen=True)
class Column:
    """One column of the table.

    Attributes
    ----------
    name : str
        What it is called.
    disks : int
        How many.
    side : int
        Of the square image, in pixels.
    colours : {"primaries", "random"}
        Green, red and blue in turn, or one of its own for each disk. Either way they are known.
    noise : float
        Standard deviation of the Gaussian noise on the target.
    parted : bool
        Whether disks that overlap are pushed apart after each step.
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
    """One start, with its target.

    Attributes
    ----------
    column : Column
        Of the table.
    goal, start : array, shape (n, 2)
        Centres (x, y) in pixels: the target's grid, and where the fit begins.
    colours : array, shape (n, 3)
        Linear RGB.
    target : array, shape (side, side, 3), float32
        Without noise: what the result is measured against.
    reference : array, shape (side, side, 3), float32
        What the fit sees.
    """

    column: Column
    goal: FloatArray
    start: FloatArray
    colours: FloatArray
    target: Image
    reference: Image

    @classmethod
    def of(cls, column: Column, seed: int) -> Problem:
        """The problem of a column and seed; the grid is the same for every seed."""
        rng = np.random.default_rng([seed, column.disks])
        start = rng.normal(0.5 * column.side, SPREAD * column.side, (column.disks, 2))
        colours = _colours(column, rng)
        goal = _grid(column)
        target = _disks(column, goal, colours, confine=False).render(_parameters(column, goal, colours))
        noise = column.noise * rng.standard_normal(target.shape)
        return cls(column, goal, start, colours, target, (target + noise).astype(np.float32))

    def disks(self, *, confine: bool) -> Disks:
        """The renderer, at the start; with `confine` it keeps disks in the frame and, as it goes, apart."""
        return _disks(self.column, self.start, self.colours, confine=confine)


def _disks(column: Column, positions: FloatArray, colours: FloatArray, *, confine: bool) -> Disks:
    return Disks(column.side, column.side, positions, RADIUS, colours, dtype="float32", confine=confine)


def _parameters(column: Column, positions: FloatArray, colours: FloatArray) -> dict[str, FloatArray]:
    return {"positions": positions, "radii": np.full(column.disks, RADIUS), "colours": colours}


def _grid(column: Column) -> FloatArray:
    """The first `disks` places of the smallest square grid that holds them, column by column."""
    across = math.isqrt(column.disks - 1) + 1
    line = np.linspace(FRINGE * column.side, (1.0 - FRINGE) * column.side, across)
    places: FloatArray = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    return places[: column.disks]


def _colours(column: Column, rng: np.random.Generator) -> FloatArray:
    if column.colours == "primaries":
        return np.array(PRIMARIES)[np.arange(column.disks) % len(PRIMARIES)]
    drawn: FloatArray = rng.uniform(size=(column.disks, 3))
    brightest = drawn.max(axis=-1, keepdims=True)
    colours: FloatArray = drawn / brightest * np.maximum(brightest, DIMMEST)
    return colours

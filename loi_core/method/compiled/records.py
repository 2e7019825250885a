"""What the columns of the kernels' tables mean, and the sizes that host and kernels share."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

__all__ = [
    "GROUP",
    "LANES",
    "LINE",
    "NEAR",
    "PAIRS",
    "SIDE",
    "STRIP",
    "TAPS",
    "BandColumn",
    "Box",
    "EdgeColumn",
    "Floats",
    "NodeColumn",
    "Operators",
    "PassColumn",
    "Plane",
    "Results",
    "Table",
    "Tables",
    "Tonal",
    "padded",
]

Floats: TypeAlias = np.ndarray[Any, Any]
Table: TypeAlias = np.ndarray[Any, np.dtype[np.int64]]

GROUP: Final = 4  # rows that are made together, so that what is loaded serves all of them
TAPS: Final = 3  # rows that are combined at once; with GROUP results they fill the registers, but do not spill
PAIRS: Final = 3  # pairs of rows, one above and one below, that are combined at once where weights are symmetric
LINE: Final = 64  # bytes of a vector, where processors have such; others take several of theirs for one
SIDE: Final = 8  # numbers in a row of the squares that are turned
STRIP: Final = 16  # rows that are transposed together: a line of the cache in float32
NEAR: Final = 2**20  # bytes of a plane that are blurred together: few enough for caches, rows long enough to stream
LANES: Final = 16  # columns come in multiples of this, a full vector, so that no remainder is left


def padded(columns: int) -> int:
    """The distance from row to row that leaves room for any full vector that begins inside.

    Never a multiple of 128 elements: rows that far apart share few places in the caches.
    """
    stride = -(-columns // LANES) * LANES + LANES
    return stride if stride % (8 * LANES) else stride + LANES


class BandColumn(IntEnum):
    """A matrix that is 0 away from a band: GROUP rows at a time see `TAPS` columns from a start on."""

    WEIGHTS = 0  # offset of the weights, (groups, taps, GROUP)
    STARTS = 1  # offset of the starts, (groups,)
    TAPS = 2
    HALF = 3  # offset of the weights of pairs, a multiple of `PAIRS` of them
    HALVES = 4
    ABOVE = 5  # from the start of a group: the first of the rows that are above its first `PAIRS` pairs' middle
    BELOW = 6  # and below
    FIRST_ALIKE = 7  # groups of rows to which that applies
    LAST_ALIKE = 8


class PassColumn(IntEnum):
    """One separable blur of a window of a plane: its rows are combined and transposed, and again."""

    BAND = 0
    FIRST = 1  # groups of rows that are made
    LAST = 2
    TOP = 3  # rows and columns outside which the plane is 0
    BOTTOM = 4
    LEFT = 5
    RIGHT = 6
    GROUPS = 7  # how many are made and transposed before the second half goes on with them
    STRIDE = 8  # of what is transposed
    BAND_AFTER = 9
    FIRST_AFTER = 10
    LAST_AFTER = 11


class EdgeColumn(IntEnum):
    """A blur from a node to a node, or to where histograms are compared, and its transpose."""

    SOURCE = 0
    TARGET = 1  # a node, or the number of the extent
    FORTH = 2
    BACK = 2 + len(PassColumn)  # from where it is not 0, which is all that is compared


class NodeColumn(IntEnum):
    """A sampling on which differences of CDFs lie, and what is pulled back to it."""

    DIFFERENCES = 0  # offset
    PULLED = 1  # offset
    STRIDE = 2
    TOP = 3  # rows and columns outside which what is pulled back is 0
    BOTTOM = 4
    LEFT = 5
    RIGHT = 6


class Plane(NamedTuple):
    """A plane in the arena."""

    at: int  # offset of row 0, column 0, whether these are written or not
    stride: int  # from row to row


class Box(NamedTuple):
    """Rows and columns of a plane, without the last of either."""

    top: int
    bottom: int
    left: int
    right: int


class Operators(NamedTuple):
    """What blurs read, and the arena that all planes lie in."""

    weights: Any  # of all bands
    starts: Any  # of all bands
    bands: Any  # (B, 9): see BandColumn
    arena: Any


class Tables(NamedTuple):
    """Which planes there are, and which blurs lead from one to another."""

    nodes: Any  # (N, 7): see NodeColumn
    edges: Any  # (M, 2 + 2 * 12): see EdgeColumn; those within the pyramid come first, then the extents
    places: Any  # (5,): see Places
    spacings: Any  # (E, 2), float64: of the samples of each extent, along both axes; 0 where every pixel is compared


class Tonal(NamedTuple):
    """One tonal scale, in units of the distance of two levels."""

    scale: Any  # one over the tonal scale times the root of 2
    peak: Any  # the logarithm of what a level adds to the CDF at its peak
    least: Any  # the least such logarithm that counts
    tie: Any  # the largest difference that is a tie
    power: Any  # of differences, that is their cost
    weights: Any  # (E,): of every extent


class Results(NamedTuple):
    """What comparing adds to."""

    costs: Any  # (E,), float64
    doubts: Any  # (E, 2), float64: what `loi_core.method.sampling_error.misplaced` gives for each extent
    cotangent: Any  # (h, w), or (0, 0) if it is not wanted
    sums: Any  # float64 zeros: room for `loi_core.method.compiled.misplacement.sum_misplaced`

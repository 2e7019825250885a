"""Tables and structs that the schedule and the kernels share, and the sizes of their blocks.

A schedule (:mod:`loi_core.method.compiled.schedule`) consists of int64 tables. This module is the only description of
their columns: the host writes a column through its enum, and the kernels read it by the same number.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

__all__ = [
    "COLUMN_MULTIPLE",
    "GROUP_ROWS",
    "MAX_CHUNK_BYTES",
    "PAIRS_PER_STEP",
    "SQUARE_SIDE",
    "STRIP_ROWS",
    "TAPS_PER_STEP",
    "VECTOR_BYTES",
    "BandColumn",
    "BlurColumn",
    "Box",
    "Floats",
    "Offset",
    "Operators",
    "PassColumn",
    "Plane",
    "PyramidColumn",
    "Results",
    "Table",
    "Tables",
    "TonalScale",
    "row_stride",
]

Floats: TypeAlias = np.ndarray[Any, Any]
Table: TypeAlias = np.ndarray[Any, np.dtype[np.int64]]

GROUP_ROWS: Final = 4  # rows that are computed together, so that each loaded row serves all of them
TAPS_PER_STEP: Final = 3  # source rows per step; with GROUP_ROWS sums they fill the registers without spilling
PAIRS_PER_STEP: Final = 3  # pairs of source rows per step where a kernel is symmetric
VECTOR_BYTES: Final = 64  # a full AVX-512 vector; other processors split it
SQUARE_SIDE: Final = 8  # side of the squares in which planes are transposed
STRIP_ROWS: Final = 16  # rows that are transposed together: a cache line in float32
MAX_CHUNK_BYTES: Final = 2**20  # of a plane that is blurred together: fits caches, and rows are long enough to stream
COLUMN_MULTIPLE: Final = 16  # columns are padded to a multiple of this, a full float32 vector


def row_stride(columns: int) -> int:
    """Return the distance from row to row that leaves room for a full vector which starts in any column.

    Never a multiple of 128 elements: such rows would compete for the same cache sets.
    """
    stride = -(-columns // COLUMN_MULTIPLE) * COLUMN_MULTIPLE + COLUMN_MULTIPLE
    return stride if stride % (8 * COLUMN_MULTIPLE) else stride + COLUMN_MULTIPLE


class BandColumn(IntEnum):
    """A band matrix: each group of GROUP_ROWS rows has `TAPS` nonzero columns from a start."""

    WEIGHTS = 0  # offset of the weights, (groups, taps, GROUP_ROWS)
    STARTS = 1  # offset of the starts, (groups,)
    TAPS = 2
    KERNEL = 3  # offset of the half kernel of the symmetric groups
    KERNEL_LENGTH = 4  # a multiple of PAIRS_PER_STEP
    ABOVE = 5  # from a group's start to the first row above its first PAIRS_PER_STEP pairs' centre
    BELOW = 6  # likewise below
    FIRST_SYMMETRIC = 7  # groups that share the symmetric kernel
    LAST_SYMMETRIC = 8


class PassColumn(IntEnum):
    """One separable blur of a window: combine rows with the first band, transpose, combine with the second band."""

    BAND = 0
    FIRST = 1  # groups of rows to compute
    LAST = 2
    TOP = 3  # window outside which the source is 0
    BOTTOM = 4
    LEFT = 5
    RIGHT = 6
    GROUPS = 7  # groups that pass through both bands before the next groups start
    STRIDE = 8  # of the transposed rows
    SECOND_BAND = 9
    SECOND_FIRST = 10
    SECOND_LAST = 11


class BlurColumn(IntEnum):
    """A blur between two pyramid levels, or from a level to the grid of an extent, and its adjoint."""

    SOURCE = 0  # pyramid level
    TARGET = 1  # pyramid level, or index of the extent
    FORWARD = 2  # a pass
    ADJOINT = 2 + len(PassColumn)  # a pass; its source window is all that is compared


class PyramidColumn(IntEnum):
    """A pyramid level: where its difference of CDFs and its cotangent lie."""

    DIFFERENCE = 0  # offset
    COTANGENT = 1  # offset
    STRIDE = 2
    TOP = 3  # window outside which the cotangent is 0
    BOTTOM = 4
    LEFT = 5
    RIGHT = 6


class Offset(IntEnum):
    """Offsets of the planes that all blurs of a schedule share."""

    SLOPE = 0  # of the CDF of the image
    TRANSPOSED = 1  # rows between the two bands of a pass
    STRIP = 2  # rows that are transposed next
    COMPARED = 3  # differences at an extent, some rows at a time
    RETURNED = 4  # rows between the two bands of an extent's adjoint
    ACCUMULATED = 5  # the difference of CDFs before it is centred, or pyramid level 0 if it is not centred


class Plane(NamedTuple):
    """A plane in the workspace."""

    offset: int  # of row 0, column 0, which need not be allocated
    stride: int  # from row to row


class Box(NamedTuple):
    """A window of a plane; `bottom` and `right` are exclusive."""

    top: int
    bottom: int
    left: int
    right: int


class Operators(NamedTuple):
    """The band matrices, and the workspace that holds all planes."""

    weights: Any  # of all bands
    starts: Any  # of all bands
    bands: Any  # (B, 9): see BandColumn
    workspace: Any


class Tables(NamedTuple):
    """A schedule."""

    pyramid: Any  # (P, 7): see PyramidColumn
    blurs: Any  # (M, 2 + 2 * 12): see BlurColumn; steps of the pyramid first, then the extents
    offsets: Any  # (6,): see Offset
    spacings: Any  # (E, 2), float64: spacing of the samples of each extent along both axes; 0 if not sampled


class TonalScale(NamedTuple):
    """One tonal scale, in units of the spacing of its levels."""

    inverse_width: Any  # 1 / (sqrt(2) beta)
    log_peak: Any  # logarithm of the largest weight of a level in the CDF
    min_log: Any  # weights with a smaller logarithm are raised to it
    tie: Any  # largest magnitude that counts as a tie
    power: Any  # exponent of the cost
    extent_weights: Any  # (E,)


class Results(NamedTuple):
    """Accumulators of a comparison."""

    costs: Any  # (E,), float64
    sign_errors: Any  # (E, 2), float64: the sums of `loi_core.method.sampling_error.sign_error_sums` by extent
    cotangent: Any  # (h, w), or (0, 0) without gradient
    block_sums: Any  # float64 zeros, scratch of `loi_core.method.compiled.sign_errors.add_sign_errors`

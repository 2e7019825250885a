"""Registry indices of shapes, and tables with a variable number of rows per shape."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["RaggedTable", "hit_shape_index", "shape_index"]


def hit_shape_index(hit: Any) -> Any:
    """Return the registry indices, mi.UInt32, of the shapes that rays have hit; 0 for rays that miss."""
    return dr.select(hit.is_valid(), dr.reinterpret_array(mi.UInt32, hit.shape), 0)


def shape_index(shape: Any) -> int:
    """Return the index of a shape in Dr.Jit's registry, as :func:`hit_shape_index` does."""
    return int(np.array(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))).item())


class RaggedTable:
    """The first row of each shape in a table that concatenates the rows of all shapes.

    Parameters
    ----------
    counts : mapping of int to int
        Number of rows by the index of a shape, in the order of the table.
    """

    def __init__(self, counts: Mapping[int, int]) -> None:
        first = np.zeros(1 + max(counts, default=0), dtype=np.uint32)
        first[list(counts)] = 1 + np.cumsum([0, *counts.values()])[:-1]
        self._first = mi.UInt32(first)

    def first_row(self, shape: Any) -> tuple[Any, Any]:
        """Return the first row of each shape, mi.UInt32, and whether the table has rows of it, mi.Bool."""
        # A literal width would be compiled into kernels, which would then be compiled again for each other width.
        in_table = shape < dr.opaque(mi.UInt32, dr.width(self._first))
        first = dr.gather(mi.UInt32, self._first, shape, in_table)
        return first - 1, first > 0

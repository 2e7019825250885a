"""Shapes by number, and tables with rows for each triangle of some of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["RaggedTable", "hit_shape_index", "shape_index"]


def hit_shape_index(hit: Any) -> Any:
    """The number of the shape that a ray has hit; 0 for none."""
    return dr.select(hit.is_valid(), dr.reinterpret_array(mi.UInt32, hit.shape), 0)


def shape_index(shape: Any) -> int:
    """The number that :func:`shape_of` gives of a shape."""
    return int(np.array(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))).item())


class RaggedTable:
    """Where the rows of each shape begin, in a table of one shape's rows after another's.

    Parameters
    ----------
    counts : mapping
        By the number of a shape, how many rows it has; in the order of the table.
    """

    def __init__(self, counts: Mapping[int, int]) -> None:
        first = np.zeros(1 + max(counts, default=0), dtype=np.uint32)
        first[list(counts)] = 1 + np.cumsum([0, *counts.values()])[:-1]
        self._first = mi.UInt32(first)

    def of(self, number: Any) -> tuple[Any, Any]:
        """Where those of shapes begin, by their numbers; and whether they have any."""
        # As a literal, kernels would be compiled again for each other number.
        known = number < dr.opaque(mi.UInt32, dr.width(self._first))
        first = dr.gather(mi.UInt32, self._first, number, known)
        return first - 1, first > 0

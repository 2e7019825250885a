"""What rays have hit, by number, where a mesh is of several parts that may go through each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.drjit.arrays import HostArray
from loi_mitsuba.drjit.ragged import RaggedTable, hit_shape_index, shape_index
from loi_mitsuba.geometry.mesh import component_bounds, connected_components, has_triangles

__all__ = ["ComponentIds"]

MOST: Final = 1000  # parts of a mesh whose boxes are compared; those of more are taken to meet


class ComponentIds:
    """The numbers of shapes and, where a mesh is of several parts that meet, of each of its parts.

    Parameters
    ----------
    shapes : sequence of mi.Shape
        All of a scene.
    moving : sequence of mi.Shape
        Those of whose parts there is to be told.

    Attributes
    ----------
    meet : bool
        Whether there are meshes whose parts may go through each other.
    """

    def __init__(self, shapes: Sequence[Any], moving: Sequence[Any]) -> None:
        meshes = filter(has_triangles, moving)
        parts = {shape_index(one): part for one in meshes if _meet(one, part := connected_components(one))}
        self.meet = bool(parts)
        self._shapes = 1 + max(map(shape_index, shapes), default=0)
        self._rows = RaggedTable({number: len(one) for number, one in parts.items()})
        self._labels = mi.UInt32(np.concatenate([[], *parts.values()]).astype(np.uint32))

    def of(self, hit: Any) -> Any:
        """The number of the shape that a ray has hit, or of its part; 0 for none."""
        number = hit_shape_index(hit)
        if not self.meet:
            return number
        shapes = dr.opaque(mi.UInt32, self._shapes)  # or kernels would be compiled again for each other number
        first, known = self._rows.of(number)
        part = dr.gather(mi.UInt32, self._labels, first + hit.prim_index, known)
        return number + part * shapes


def _meet(mesh: Any, part: HostArray) -> bool:
    """Whether the boxes of any two of a mesh's parts touch."""
    count = int(part.max(initial=0)) + 1
    if not 1 < count <= MOST:
        return count > 1
    low, high = component_bounds(mesh, part)
    touch = np.all((low[:, None] <= high) & (low <= high[:, None]), axis=-1)
    return bool(np.count_nonzero(touch) > count)

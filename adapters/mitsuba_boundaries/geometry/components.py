"""Ids of connected components on the device, for meshes whose components may intersect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import HostArray
from mitsuba_boundaries.drjit.ragged import RaggedTable, hit_shape_index, shape_index
from mitsuba_boundaries.geometry.mesh import component_bounds, has_triangles
from mitsuba_boundaries.geometry.topology import topology_of

__all__ = ["ComponentIds"]

MAX_COMPARED_COMPONENTS: Final = 1000  # more components of a mesh are assumed to intersect, without comparing all pairs


class ComponentIds:
    """Ids of shapes and, for meshes whose components may intersect, of each component.

    Parameters
    ----------
    shapes : sequence of mi.Shape
        All shapes of a scene.
    moving : sequence of mi.Shape
        The shapes whose components get ids of their own.

    Attributes
    ----------
    may_intersect : bool
        Whether a moving mesh has components that may intersect each other.
    """

    def __init__(self, shapes: Sequence[Any], moving: Sequence[Any]) -> None:
        meshes = filter(has_triangles, moving)
        components = {
            shape_index(mesh): component for mesh in meshes if _overlap(mesh, component := topology_of(mesh).components)
        }
        self.may_intersect = bool(components)
        self._shape_count = 1 + max(map(shape_index, shapes), default=0)
        self._table = RaggedTable({index: len(component) for index, component in components.items()})
        self._components = mi.UInt32(np.concatenate([[], *components.values()]).astype(np.uint32))

    def ids(self, hit: Any) -> Any:
        """Return the id, mi.UInt32, of the shape or component that each ray has hit; 0 for rays that miss."""
        shape = hit_shape_index(hit)
        if not self.may_intersect:
            return shape
        # A literal count would be compiled into kernels, which would then be compiled again for each other count.
        shape_count = dr.opaque(mi.UInt32, self._shape_count)
        first, in_table = self._table.first_row(shape)
        component = dr.gather(mi.UInt32, self._components, first + hit.prim_index, in_table)
        return shape + component * shape_count


def _overlap(mesh: Any, component: HostArray) -> bool:
    """Return whether the bounding boxes of any two components of a mesh overlap."""
    count = int(component.max(initial=0)) + 1
    if not 1 < count <= MAX_COMPARED_COMPONENTS:
        return count > 1
    lower, upper = component_bounds(mesh, component)
    overlap = np.all((lower[:, None] <= upper) & (lower <= upper[:, None]), axis=-1)
    return bool(np.count_nonzero(overlap) > count)

"""Axis-aligned bounding boxes as NumPy arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from mitsuba_boundaries.drjit.arrays import HostArray

__all__ = ["bounding_box"]


def bounding_box(node: Any) -> HostArray:
    """Return the lower and upper corner of the bounding box of a shape or scene: shape (2, 3), float64."""
    box = node.bbox()
    return np.array([np.array(corner, dtype=np.float64).reshape(3) for corner in (box.min, box.max)])

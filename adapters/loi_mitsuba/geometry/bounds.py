"""Boxes around shapes, as NumPy holds them."""

from __future__ import annotations

from typing import Any

import numpy as np

from loi_mitsuba.drjit.arrays import HostArray

__all__ = ["bounding_box"]


def bounding_box(node: Any) -> HostArray:
    """The least and the largest coordinates of a shape, or of a scene: shape (2, 3), float64."""
    box = node.bbox()
    return np.array([np.array(one, dtype=np.float64).reshape(3) for one in (box.min, box.max)])

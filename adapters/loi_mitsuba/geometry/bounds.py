"""Boxes around shapes, as NumPy holds them."""

from __future__ import annotations

from typing import Any

import numpy as np

from loi_core.support.arrays import Host

__all__ = ["corners_of"]


def corners_of(node: Any) -> Host:
    """The least and the largest coordinates of a shape, or of a scene: shape (2, 3), float64."""
    box = node.bbox()
    return np.array([np.array(one, dtype=np.float64).reshape(3) for one in (box.min, box.max)])

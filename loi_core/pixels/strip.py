"""Several images as one picture."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from loi_core.support.arrays import Host

__all__ = ["side_by_side"]

GAP: Final = 4  # pixels


def side_by_side(images: Iterable[Host]) -> Host:
    """Images, shape (H, W, C), next to each other from left to right, with 0 between and below; one as it is."""
    parts = [np.asarray(one) for one in images]
    if len(parts) == 1:
        return parts[0]
    height = max(one.shape[0] for one in parts)
    width = sum(one.shape[1] for one in parts) + GAP * (len(parts) - 1)
    strip, left = np.zeros((height, width, parts[0].shape[2]), np.result_type(*parts)), 0
    for one in parts:
        strip[: one.shape[0], left : left + one.shape[1]] = one
        left += one.shape[1] + GAP
    return strip

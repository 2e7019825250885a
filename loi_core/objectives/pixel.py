"""The mean squared difference of pixels: what most people start with, and the yardstick of every other."""

from __future__ import annotations

import math
from typing import ClassVar

from loi_core.objectives.base import Evaluation, ImageObjective
from loi_core.support.arrays import Array, sum_of_all

__all__ = ["PixelL2"]


class PixelL2(ImageObjective[tuple[Array, Array | None], str]):
    """Mean of ``(image - reference)**2`` over pixels, channels and batch.

    Parameters are those of :class:`ImageObjective`.
    """

    takes_weights: ClassVar[bool] = True

    def prepare_reference(self, reference: Array, weights: Array | None) -> tuple[Array, Array | None]:
        """See :class:`loi_core.ImageObjective`."""
        return reference, weights

    def compare_planes(self, planes: Array, prepared: tuple[Array, Array | None], *, gradient: bool) -> Evaluation[str]:
        """See :class:`loi_core.ImageObjective`."""
        reference, weights = prepared
        weight = 1.0 / math.prod(planes.shape)
        difference = planes - reference
        weighted = difference if weights is None else difference * weights
        term = sum_of_all(difference * weighted) * weight
        return Evaluation({"l2": term}, weighted * (2.0 * weight) if gradient else None)

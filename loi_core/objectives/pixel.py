"""The mean squared difference of pixels: what most people start with, and the yardstick of every other."""

from __future__ import annotations

import math

from loi_core.objectives.base import Evaluation, ImageObjective
from loi_core.support.arrays import Array, sum_of_all

__all__ = ["PixelL2"]


class PixelL2(ImageObjective[Array, str]):
    """Mean of ``(image - reference)**2`` over pixels, channels and batch.

    Parameters are those of :class:`ImageObjective`.
    """

    def prepare_reference(self, reference: Array) -> Array:
        """See :class:`loi_core.ImageObjective`."""
        return reference

    def compare_planes(self, planes: Array, prepared: Array, *, gradient: bool) -> Evaluation[str]:
        """See :class:`loi_core.ImageObjective`."""
        weight = 1.0 / math.prod(planes.shape)
        difference = planes - prepared
        term = sum_of_all(difference * difference) * weight
        return Evaluation({"l2": term}, difference * (2.0 * weight) if gradient else None)

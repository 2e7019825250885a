"""The mean squared difference of pixels: what most people start with, and the yardstick of every other."""

from __future__ import annotations

import math

from loi_core.arrays import Array, sum_of_all
from loi_core.objectives.base import Evaluation, ImageObjective

__all__ = ["PixelL2"]


class PixelL2(ImageObjective[Array, str]):
    """Mean of ``(image - reference)**2`` over pixels, channels and batch.

    Parameters are those of :class:`ImageObjective`.
    """

    def _prepare(self, reference: Array) -> Array:
        return reference

    def _evaluate(self, planes: Array, prepared: Array, *, gradient: bool) -> Evaluation[str]:
        weight = 1.0 / math.prod(planes.shape)
        difference = planes - prepared
        term = sum_of_all(difference * difference) * weight
        return Evaluation({"l2": term}, difference * (2.0 * weight) if gradient else None)

"""The mean squared difference of pixels: the most common loss, and the baseline of every comparison."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from loi_core.objectives.base import ImageObjective
from loi_core.objectives.evaluation import Evaluation, PlaneComparison, ReferencePlanes
from loi_core.support.arrays import Array, sum_of_all
from loi_core.support.keywords import suggest_keywords

__all__ = ["PixelL2"]


@suggest_keywords
class PixelL2(ImageObjective[str]):
    """Mean of ``(image - reference)**2`` over pixels, channels and batch.

    See :class:`ImageObjective` for the parameters.
    """

    takes_weights: ClassVar[bool] = True

    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[str]:
        """See :class:`loi_core.ImageObjective`."""
        return _SquaredDifference(reference.planes, reference.weights)


@dataclass(frozen=True, eq=False)
class _SquaredDifference(PlaneComparison[str]):
    reference: Array
    weights: Array | None

    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[str]:
        factor = 1.0 / math.prod(planes.shape)
        difference = planes - self.reference
        weighted = difference if self.weights is None else difference * self.weights
        term = sum_of_all(difference * weighted) * factor
        return Evaluation({"l2": term}, weighted * (2.0 * factor) if gradient else None)

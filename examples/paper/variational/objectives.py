"""Objectives of the methods."""

from __future__ import annotations

from dataclasses import dataclass

from examples.paper.variational.problem import FloatArray
from examples.paper.variational.settings import INNER_SCALES, PAPER_SCALES, Method
from loi_core import LOIObjective
from loi_core.method.blurs import Blur, gaussian_blur
from loi_core.objectives import Evaluation, ImageObjective, Objective, PixelL2, PlaneComparison, ReferencePlanes
from loi_core.support.arrays import Array, sum_of_all

__all__ = ["BlurredL2", "objective"]


class BlurredL2(ImageObjective[float]):
    """Sum over inner scales of the mean squared difference of the blurred images, without histograms.

    Takes all parameters of :class:`ImageObjective` except `weights`.
    """

    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[float]:
        """See :class:`ImageObjective`."""
        planes = reference.planes
        height, width = planes.shape[-2:]
        blurs = tuple(gaussian_blur(height, width, sigma, "reflect", like=planes) for sigma in INNER_SCALES)
        return _BlurredComparison(blurs, tuple(blur.apply(planes) for blur in blurs))


@dataclass(frozen=True, eq=False)
class _BlurredComparison(PlaneComparison[float]):
    blurs: tuple[Blur, ...]
    references: tuple[Array, ...]

    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[float]:
        terms, slope = {}, None
        for sigma, blur, reference in zip(INNER_SCALES, self.blurs, self.references, strict=True):
            difference = blur.apply(planes) - reference
            weight = 1.0 / difference.size
            terms[sigma] = sum_of_all(difference * difference) * weight
            if gradient:
                term_slope = blur.adjoint(difference) * (2.0 * weight)
                slope = term_slope if slope is None else slope + term_slope
        return Evaluation(terms, slope)


def objective(method: Method, target: FloatArray) -> Objective:
    """Return the objective of a method."""
    if method == "pixels":
        return PixelL2(target)
    if method == "sigma":
        return BlurredL2(target)
    return LOIObjective(target, PAPER_SCALES if method == "paper" else None, accuracy="balanced")

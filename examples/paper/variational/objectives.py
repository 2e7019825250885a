"""The objective of each method."""

from __future__ import annotations

from dataclasses import dataclass

from examples.paper.variational.problem import FloatArray
from examples.paper.variational.settings import INNER, PAPER_SCALES, Method
from loi_core import LOIObjective
from loi_core.method.blurs import Blur, gaussian_blur
from loi_core.objectives import Objective, PixelL2
from loi_core.objectives.base import Evaluation, ImageObjective
from loi_core.support.arrays import Array, sum_of_all

__all__ = ["BlurredL2", "objective"]


@dataclass(frozen=True)
class _Blurred:
    blurs: tuple[Blur, ...]
    references: tuple[Array, ...]


class BlurredL2(ImageObjective[_Blurred, float]):
    """Sum over inner scales of the mean squared difference of the blurred images: the method without histograms.

    Parameters are those of :class:`ImageObjective`, but for `weights`.
    """

    def prepare_reference(self, reference: Array, weights: Array | None) -> _Blurred:  # noqa: ARG002  # has none
        """See :class:`ImageObjective`."""
        height, width = reference.shape[-2:]
        blurs = tuple(gaussian_blur(height, width, sigma, "reflect", like=reference) for sigma in INNER)
        return _Blurred(blurs, tuple(blur.apply(reference) for blur in blurs))

    def compare_planes(self, planes: Array, prepared: _Blurred, *, gradient: bool) -> Evaluation[float]:
        """See :class:`ImageObjective`."""
        terms, slope = {}, None
        for sigma, blur, reference in zip(INNER, prepared.blurs, prepared.references, strict=True):
            difference = blur.apply(planes) - reference
            share = 1.0 / difference.size
            terms[sigma] = sum_of_all(difference * difference) * share
            if gradient:
                one = blur.adjoint(difference) * (2.0 * share)
                slope = one if slope is None else slope + one
        return Evaluation(terms, slope)


def objective(method: Method, target: FloatArray) -> Objective:
    """The objective of a method."""
    if method == "pixels":
        return PixelL2(target)
    if method == "sigma":
        return BlurredL2(target)
    return LOIObjective(target, PAPER_SCALES if method == "paper" else None, accuracy="balanced")

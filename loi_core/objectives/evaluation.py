"""One evaluation of an objective: forward through the pixel pipeline, comparison of planes, pullback.

:meth:`PreparedObjective.evaluate` is the page to read first.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import Generic, TypeVar

from loi_core.method.dispatch import Backend
from loi_core.method.sampling_error import is_within
from loi_core.pixels.pipeline import PixelPipeline
from loi_core.support.arrays import Array, norm

__all__ = ["Evaluation", "PlaneComparison", "PreparedObjective", "ReferencePlanes"]

KeyT = TypeVar("KeyT")


@dataclass(frozen=True)
class Evaluation(Generic[KeyT]):
    """Result of one comparison of planes.

    Attributes
    ----------
    terms : dict
        Terms of the value, 0-d arrays; the value is their sum.
    gradient : array, shape (N, H, W), optional
        Derivative of the value with respect to the planes; None if it was not requested.
    error : float
        Estimated 2-norm error of an approximate gradient; 0 for an exact one.
    """

    terms: dict[KeyT, Array]
    gradient: Array | None
    error: float = 0.0


@dataclass(frozen=True, eq=False)
class ReferencePlanes:
    """A reference that is ready to compare: finite, and past masks, tone curve and clipping.

    Attributes
    ----------
    planes : array, shape (N, H, W)
        One plane for each channel of each image of the batch.
    weights : array, shape (N, H, W), optional
        Weights of pixels in [0, 1]; None if all count alike, and always None unless the objective takes weights.
    backend : Backend
        The backend whose library the planes belong to.
    """

    planes: Array
    weights: Array | None
    backend: Backend


class PlaneComparison(abc.ABC, Generic[KeyT]):
    """Comparison of planes with one reference. Authors of an objective write :meth:`compare`.

    Attributes
    ----------
    tolerance : float
        Largest relative error of the gradient; matters only where :meth:`compare` reports an error.
    """

    tolerance: float = 0.0

    @abc.abstractmethod
    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[KeyT]:
        """Return the terms, means over all planes and pixels, and on request the gradient.

        Parameters
        ----------
        planes : array, shape (N, H, W)
            Of the same library, dtype and device as the reference's planes.
        gradient : bool
            Whether to compute the gradient with respect to `planes`.
        """

    def compare_exactly(self, planes: Array) -> Evaluation[KeyT]:
        """Return the same with an exact gradient; called where the estimated error exceeds the tolerance."""
        return self.compare(planes, gradient=True)


@dataclass(frozen=True, eq=False)
class PreparedObjective(Generic[KeyT]):
    """An objective that is prepared for images of one kind: shape, library, dtype and device."""

    backend: Backend
    pipeline: PixelPipeline
    comparison: PlaneComparison[KeyT]

    def evaluate(
        self, image: Array, *, gradient: bool, check_finite: bool = True
    ) -> tuple[dict[KeyT, Array], Array | None]:
        """Return the terms of the value and, on request, the gradient with respect to `image`, of its library."""
        pixels = self.pipeline.forward(self.backend.to_backend(image), check_finite=check_finite)
        compared = self.comparison.compare(pixels.planes, gradient=gradient)
        terms = {key: self._scaled(term, image) for key, term in compared.terms.items()}
        if not gradient:
            return terms, None
        pulled = self.pipeline.pullback(pixels, compared.gradient)
        if compared.error > 0.0:
            error = self.pipeline.pullback_error(pixels, compared.error)
            if not is_within(error, self.comparison.tolerance, norm(pulled)):
                pulled = self.pipeline.pullback(pixels, self.comparison.compare_exactly(pixels.planes).gradient)
        return terms, self._scaled(pulled, image)

    def _scaled(self, result: Array, image: Array) -> Array:
        largest = self.pipeline.largest_weight
        is_one = isinstance(largest, float) and largest == 1.0
        return self.backend.to_library(result if is_one else result * largest, image)

"""The interface that the array comparison and the compiled comparison share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias

from loi_core.method.sampling_error import SignErrors
from loi_core.support.arrays import Array

__all__ = ["Comparison", "ComparisonResult", "ScaleKey", "Terms"]

ScaleKey: TypeAlias = tuple[float, float, float]
"""(alpha, beta, sigma)."""

Terms: TypeAlias = dict[ScaleKey, Array]


@dataclass(frozen=True)
class ComparisonResult:
    """The result of comparing planes with a reference.

    Attributes
    ----------
    terms : dict
        The cost of each scale.
    cotangent : array, shape (N, H, W), optional
        The gradient with respect to the planes, if requested.
    sign_errors : tuple of SignErrors
        Statistics from which :func:`loi_core.method.sampling_error.estimated_error` estimates the gradient's error.
    """

    terms: Terms
    cotangent: Array | None
    sign_errors: tuple[SignErrors, ...] = ()


class Comparison(Protocol):
    """A comparison of planes with a reference at all scales.

    Implemented by :class:`loi_core.method.array_comparison.ArrayComparison` and
    :class:`loi_core.method.compiled.loop_comparison.LoopComparison`.
    """

    def compare(self, compressed: Array, *, gradient: bool) -> ComparisonResult:
        """Compare planes within the bounds, shape (N, H, W).

        A plan with samplings needs readable values (:func:`loi_core.support.arrays.values_may_decide`).
        """

    def with_weights(self, weights: Array) -> Comparison:
        """Return the comparison with other weights, shape (N, H, W); it shares the prepared reference.

        The plan must be for weighted pixels.
        """

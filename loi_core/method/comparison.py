"""What comparing planes with a reference takes and gives, whichever way it is done."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias

from loi_core.method.sampling_error import Misplaced
from loi_core.support.arrays import Array

__all__ = ["Compared", "Comparison", "ScaleKey", "Terms"]

ScaleKey: TypeAlias = tuple[float, float, float]
"""(alpha, beta, sigma)."""

Terms: TypeAlias = dict[ScaleKey, Array]


@dataclass(frozen=True)
class Compared:
    """What comes of comparing some planes.

    Attributes
    ----------
    terms : dict
        What each scale costs.
    cotangent : array, shape (N, H, W), optional
        The gradient by the planes, if it was asked for.
    misplaced : tuple of Misplaced
        What samplings misplaced on the way to it: :func:`loi_core.method.sampling_error.error_of` estimates its error
        from it.
    """

    terms: Terms
    cotangent: Array | None
    misplaced: tuple[Misplaced, ...] = ()


class Comparison(Protocol):
    """A way to compare planes with a reference at all scales.

    Two do: :class:`loi_core.method.array_comparison.ArrayComparison`, and
    :class:`loi_core.method.compiled.loop_comparison.LoopComparison`.
    """

    def compare(self, clipped: Array, *, gradient: bool) -> Compared:
        """Compare planes within the bounds, shape (N, H, W).

        Where a plan has samplings, values must be at hand (:func:`loi_core.support.arrays.values_may_decide`).
        """

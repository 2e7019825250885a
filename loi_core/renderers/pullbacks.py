"""Pullbacks that look at the loss itself: how they are made, and how any pullback is asked for a loss's gradient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from loi_core.renderers.contract import Loss, LossPullback, Parameters, Pullback
from loi_core.support.arrays import Array

__all__ = ["OfLoss", "pull_of"]


@dataclass(frozen=True)
class OfLoss:
    """A :class:`~loi_core.renderers.contract.LossPullback` from one function.

    Attributes
    ----------
    function : callable
        Of the loss, or None where it is not known, and the cotangent.
    """

    function: Callable[[Loss | None, Array], Parameters]

    def __call__(self, cotangent: Array) -> Parameters:
        """The gradient of the loss that is linear in the image, with this slope."""
        return self.function(None, cotangent)

    def of_loss(self, loss: Loss, cotangent: Array) -> Parameters:
        """The gradient of a loss, whose slope at the image is `cotangent`."""
        return self.function(loss, cotangent)


def pull_of(pullback: Pullback, loss: Loss | None, cotangent: Array) -> Parameters:
    """The gradient that a pullback has of a loss, of which it may look at no more than the cotangent."""
    if loss is not None and isinstance(pullback, LossPullback):
        return pullback.of_loss(loss, cotangent)
    return pullback(cotangent)

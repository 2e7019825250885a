"""When to look again at what a plan has turned off."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

__all__ = ["Schedule"]

FIRST: Final = 20  # gradients until what is off is looked at again; then twice as many, and so on
STALL: Final = 20  # steps in which a loss that still falls reaches a new least value


@dataclass(frozen=True)
class Schedule:
    """Counts of a fit since it was planned; never changed, only replaced.

    Attributes
    ----------
    asked, due, wait : int
        Gradients so far, at how many of them the next look is due, and how many lie between that look and the one
        after it.
    least : float
        The least loss so far.
    since_least, patience : int
        Steps since it was reached, and after how many the loss has stalled.
    """

    asked: int = 0
    due: int = FIRST
    wait: int = 2 * FIRST
    least: float = math.inf
    since_least: int = 0
    patience: int = STALL

    def counted(self) -> Schedule:
        """With one more gradient."""
        return replace(self, asked=self.asked + 1)

    @property
    def is_due(self) -> bool:
        """Whether as many gradients have gone by as a look waits for: 20, 40 more, 80 more and so on."""
        return self.asked >= self.due

    def looked(self) -> Schedule:
        """After a look, for whatever reason: the next is twice as far off."""
        return replace(self, due=self.asked + self.wait, wait=2 * self.wait)

    def watched(self, loss: float | None) -> Schedule:
        """With the loss of one more step; None where a fit begins, whose losses are no longer those of before."""
        if loss is None:
            return replace(self, least=math.inf, since_least=0)
        if loss < self.least:
            return replace(self, least=loss, since_least=0)
        return replace(self, since_least=self.since_least + 1)

    @property
    def stalls(self) -> bool:
        """Whether the loss has reached no new least value for 20 steps, then for 40 more, 80 more and so on."""
        return self.since_least >= self.patience

    def waited(self) -> Schedule:
        """After a stall was answered: a fit that has arrived stalls for good, and looking costs."""
        return replace(self, since_least=0, patience=2 * self.patience)

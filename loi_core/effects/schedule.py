"""Schedule of the probes that measure disabled effects again during a fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

__all__ = ["STALL_STEPS", "Schedule"]

FIRST_PROBE: Final = 20  # gradients before the first probe; each interval is twice the previous one
STALL_STEPS: Final = 20  # a loss that still decreases reaches a new minimum within this many steps


@dataclass(frozen=True)
class Schedule:
    """Counters since the last plan; never changed, only replaced.

    Attributes
    ----------
    gradients : int
        Number of gradients so far.
    next_probe, interval : int
        Number of gradients at the next probe, and between that probe and the one after it.
    min_loss : float
        Least loss so far.
    steps_since_min : int
        Steps since the least loss.
    patience : int
        Steps without a new minimum after which the loss counts as stalled.
    """

    gradients: int = 0
    next_probe: int = FIRST_PROBE
    interval: int = 2 * FIRST_PROBE
    min_loss: float = math.inf
    steps_since_min: int = 0
    patience: int = STALL_STEPS

    def after_gradient(self) -> Schedule:
        """Return the schedule after one more gradient."""
        return replace(self, gradients=self.gradients + 1)

    @property
    def is_due(self) -> bool:
        """Whether a probe is due: after 20 gradients, then after 40, 80, ... more."""
        return self.gradients >= self.next_probe

    def after_probe(self) -> Schedule:
        """Return the schedule after a probe; the interval doubles."""
        return replace(self, next_probe=self.gradients + self.interval, interval=2 * self.interval)

    def after_step(self, loss: float | None) -> Schedule:
        """Return the schedule after a step with this loss; None where a fit restarts and earlier losses are invalid."""
        if loss is None:
            return replace(self, min_loss=math.inf, steps_since_min=0)
        if loss < self.min_loss:
            return replace(self, min_loss=loss, steps_since_min=0)
        return replace(self, steps_since_min=self.steps_since_min + 1)

    @property
    def is_stalled(self) -> bool:
        """Whether the loss has had no new minimum for 20 steps, then for 40, 80, ... more."""
        return self.steps_since_min >= self.patience

    def after_stall(self) -> Schedule:
        """Return the schedule after the reaction to a stall; patience doubles, since a converged fit stays stalled."""
        return replace(self, steps_since_min=0, patience=2 * self.patience)

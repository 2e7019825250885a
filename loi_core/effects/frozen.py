"""Freeze parameters whose gradient cannot be distinguished from noise, and release them when it can."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from loi_core.effects.statistics import Draws
from loi_core.support.arrays import Host, to_numpy

__all__ = ["CLEAR_ERRORS", "MIN_SCORES", "Evidence", "Frozen"]


CLEAR_ERRORS: Final = 4.0
"""Standard errors of a mean beyond which as few as four draws are significant."""
MIN_SCORES: Final = (2.0, 2.5)
"""Scores beyond which draws agree: for a single test, and for a test after every further draw."""


@dataclass(frozen=True)
class Evidence:
    """The agreement of successive draws of one gradient, independent of its unit, size and noise.

    Every draw g_k is multiplied with the sum S_k of the draws before it. Noise points against that sum as often as
    along it; a signal points along it. The score is the sum of the products g_k . S_k over the root of the sum of their
    squares. By chance it exceeds c at most with the probability exp(-c^2 / 2), if each draw is as likely as its
    opposite.

    Attributes
    ----------
    count : int
        Number of draws that were not 0.
    summed : array, shape (size,), float64
        Sum of the draws.
    product, spread : float
        Sum of the products, and root of the sum of their squares.

    References
    ----------
    V. H. de la Pena, A general class of exponential inequalities for martingales and ratios, Annals of Probability 27,
    1999.
    """

    count: int
    summed: Host
    product: float = 0.0
    spread: float = 0.0

    @classmethod
    def of(cls, draws: Host) -> Evidence:
        """Return the evidence of draws, shape (draws, size)."""
        evidence = cls(0, np.zeros(draws.shape[1]))
        for draw in draws:
            evidence = evidence.and_one(draw)
        return evidence

    def and_one(self, draw: Host) -> Evidence:
        """Return the evidence with one more draw, shape (size,)."""
        if not np.any(draw):
            return self
        product = float(draw @ self.summed)
        return Evidence(self.count + 1, self.summed + draw, self.product + product, math.hypot(self.spread, product))

    @property
    def score(self) -> float:
        """The significance of a signal; 0 before the second draw, and less than the root of n after n draws."""
        return self.product / self.spread if self.spread > 0.0 else 0.0


@dataclass(frozen=True)
class Frozen:
    """The frozen parameters, and the evidence for releasing them; never changed, only replaced.

    A step along a noisy gradient is a step of a random walk, as long as any other step under Adam. Frozen parameters do
    not move, but their gradient is still evaluated: draws of a signal agree the more, the more there are. A signal of s
    times the noise of one draw is recognised after about 9 + (2.5 / s)^2 draws.

    Attributes
    ----------
    groups : tuple of tuple of str
        Parameters that are frozen and released together: an object out of view has no gradient for any of them.
    reasons : mapping of str
        Reason for each frozen parameter.
    evidence : mapping of Evidence
        Evidence for releasing each frozen parameter.
    """

    groups: tuple[tuple[str, ...], ...] = ()
    reasons: Mapping[str, str] = field(default_factory=dict)
    evidence: Mapping[str, Evidence] = field(default_factory=dict)

    @classmethod
    def of(cls, draws: Draws, groups: Sequence[Sequence[str]]) -> Frozen:
        """Freeze every group without a significant gradient, given draws of each parameter's gradient."""
        evidence = {name: Evidence.of(gradients) for name, gradients in draws.gradients.items()}
        frozen = [
            tuple(group)
            for group in groups
            if not any(
                draws.is_significant(name, CLEAR_ERRORS) or evidence[name].score > MIN_SCORES[0] for name in group
            )
        ]
        names = [name for group in frozen for name in group]
        reasons = {
            name: f"its gradient is exactly 0 in {draws.count} draws"
            if draws.is_zero(name)
            else f"its gradient cannot be distinguished from noise in {draws.count} draws"
            for name in names
        }
        return cls(tuple(frozen), reasons, {name: evidence[name] for name in names})

    def updated(self, gradient: Mapping[str, Any]) -> Frozen:
        """Add a draw of the gradient, and release each group with a parameter whose draws agree."""
        if not self.groups:
            return self
        evidence = {
            name: previous.and_one(np.asarray(to_numpy(gradient[name]), np.float64).reshape(-1))
            for name, previous in self.evidence.items()
        }
        significant = [name for name, updated in evidence.items() if updated.score > MIN_SCORES[1]]
        return replace(self, evidence=evidence).without(significant)

    def without(self, names: Iterable[str]) -> Frozen:
        """Release the groups of these parameters."""
        released = set(names)
        groups = tuple(group for group in self.groups if not released & set(group))
        frozen = [name for group in groups for name in group]
        return Frozen(
            groups, {name: self.reasons[name] for name in frozen}, {name: self.evidence[name] for name in frozen}
        )

"""Parameters that a fit holds where they are, for their gradient cannot be distinguished from noise, until it can."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from loi_core.effects.statistics import Draws
from loi_core.support.arrays import Host, to_numpy

__all__ = ["AGREE", "CLEAR", "Evidence", "Holding"]


CLEAR: Final = 4.0
"""Errors of a mean above which as few as four draws speak for themselves."""
AGREE: Final = (2.0, 2.5)
"""Scores above which draws agree, at one look and where every further draw is a look of its own."""


@dataclass(frozen=True)
class Evidence:
    """How far successive draws of one gradient agree, whatever its unit, its size, and the noise of each draw.

    Every draw g_k is multiplied with the sum S_k of those before it. Noise points against that sum as often as along
    it, a signal points along it. The score is the sum of the products g_k . S_k over the root of that of their squares;
    it exceeds c by chance at most with the probability exp(-c^2 / 2), if each draw is as likely as its opposite.

    Attributes
    ----------
    count : int
        Draws that were not 0.
    summed : array, shape (size,), float64
        Their sum.
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
        """From draws, shape (draws, size)."""
        evidence = cls(0, np.zeros(draws.shape[1]))
        for one in draws:
            evidence = evidence.and_one(one)
        return evidence

    def and_one(self, draw: Host) -> Evidence:
        """The evidence with one more draw, shape (size,)."""
        if not np.any(draw):
            return self
        product = float(draw @ self.summed)
        return Evidence(self.count + 1, self.summed + draw, self.product + product, math.hypot(self.spread, product))

    @property
    def score(self) -> float:
        """How surely there is a signal; 0 before the second draw, and of n draws less than the root of n."""
        return self.product / self.spread if self.spread > 0.0 else 0.0


@dataclass(frozen=True)
class Holding:
    """Which parameters are held, why, and what speaks for letting them go; never changed, only replaced.

    A step along a gradient that is noise is a step of a random walk, as long as any other under Adam. What is held does
    not move, but its gradient goes on to be looked at: draws agree the more, the more there are, and a signal of s
    times the noise of one draw is told after about 9 + (2.5 / s)^2 of them.

    Attributes
    ----------
    groups : tuple of tuple of str
        What is held and let go together: an object that cannot be seen has no gradient by any of its parameters.
    reasons : mapping of str
        By parameter that is held, why.
    evidence : mapping of Evidence
        By parameter that is held.
    """

    groups: tuple[tuple[str, ...], ...] = ()
    reasons: Mapping[str, str] = field(default_factory=dict)
    evidence: Mapping[str, Evidence] = field(default_factory=dict)

    @classmethod
    def begun(cls, draws: Draws, groups: Sequence[Sequence[str]]) -> Holding:
        """Hold every group of which no parameter has a significant gradient, by draws of each."""
        evidence = {name: Evidence.of(one) for name, one in draws.gradients.items()}
        held = [
            tuple(group)
            for group in groups
            if not any(draws.heard(name, CLEAR) or evidence[name].score > AGREE[0] for name in group)
        ]
        names = [name for group in held for name in group]
        reasons = {
            name: f"its gradient is exactly 0 in {draws.count} draws"
            if draws.zero(name)
            else f"its gradient cannot be distinguished from noise in {draws.count} draws"
            for name in names
        }
        return cls(tuple(held), reasons, {name: evidence[name] for name in names})

    def seen(self, gradient: Mapping[str, Any]) -> Holding:
        """With one more draw of the gradient, by parameter: a group goes free once the draws of one of it agree."""
        if not self.groups:
            return self
        evidence = {
            name: one.and_one(np.asarray(to_numpy(gradient[name]), np.float64).reshape(-1))
            for name, one in self.evidence.items()
        }
        significant = [name for name, one in evidence.items() if one.score > AGREE[1]]
        return replace(self, evidence=evidence).without(significant)

    def without(self, names: Iterable[str]) -> Holding:
        """With the groups of these parameters let go."""
        gone = set(names)
        held = tuple(group for group in self.groups if not gone & set(group))
        kept = [name for group in held for name in group]
        return Holding(held, {name: self.reasons[name] for name in kept}, {name: self.evidence[name] for name in kept})

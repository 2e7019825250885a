"""What part of a gradient carries how much of it: fractions of parts that were drawn apart."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import TypeAlias

from loi_core.effects.statistics import SURE, Draws

__all__ = ["Sizes", "largest_fraction", "most_fraction", "relative_variance", "sizes_of"]

Sizes: TypeAlias = Mapping[str, tuple[float, float]]
"""By parameter, the norm of its gradient and the error of that; a norm of 0 if that is not significant."""


def sizes_of(whole: Draws, significant: Collection[str]) -> Sizes:
    """Norms of a gradient, for :func:`most_fraction`, 0 for all but the `significant` parameters."""
    return {name: (whole.size(name) if name in significant else 0.0, whole.error(name)) for name in whole.gradients}


def most_fraction(part: Draws, sizes: Sizes, sure: float = SURE) -> float:
    """What a part of a gradient surely does not exceed as a fraction of the whole, for any parameter.

    To the fraction that was found, `sure` of its errors are added, which come from both. Where the whole is lost in
    noise, no fraction is small enough but that of a part which was exactly 0 in every draw: the result is infinite.
    """
    fractions = [0.0]
    for name, (size, error) in sizes.items():
        if part.zero(name):
            continue
        if size == 0.0:
            return math.inf
        fraction = part.size(name) / size
        fractions.append(fraction + sure * math.hypot(part.error(name), fraction * error) / size)
    return max(fractions)


def largest_fraction(part: Draws, whole: Draws, significant: Collection[str]) -> float | None:
    """The largest fraction among the parameters `significant`; None if there is none."""
    return max((part.norm(name) / whole.norm(name) for name in significant), default=None)


def relative_variance(part: Draws, whole: Draws, significant: Collection[str]) -> float:
    """Variance of a draw of a part, each parameter `significant` relative to its own gradient: units differ."""
    return sum(part.variance(name) / whole.norm(name) ** 2 for name in significant)

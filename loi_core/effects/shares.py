"""What part of a gradient carries how much of it: shares of parts that were drawn apart."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import TypeAlias

from loi_core.effects.statistics import SURE, Draws

__all__ = ["Sizes", "largest_share", "most_share", "relative_variance", "sizes_of"]

Sizes: TypeAlias = Mapping[str, tuple[float, float]]
"""By parameter, the norm of its gradient and the error of that; a norm of 0 if it cannot be told from noise."""


def sizes_of(whole: Draws, told: Collection[str]) -> Sizes:
    """Norms of a gradient, for :func:`most_share`; `told` are the parameters whose gradient can be told from noise."""
    return {name: (whole.size(name) if name in told else 0.0, whole.error(name)) for name in whole.gradients}


def most_share(part: Draws, sizes: Sizes, sure: float = SURE) -> float:
    """What a part of a gradient surely does not exceed as a share of the whole, for any parameter.

    To the share that was found, `sure` of its errors are added, which come from both. Where the whole cannot be told
    from noise, no share is small enough but that of a part which was exactly 0 in every draw: the result is infinite.
    """
    shares = [0.0]
    for name, (size, error) in sizes.items():
        if part.zero(name):
            continue
        if size == 0.0:
            return math.inf
        share = part.size(name) / size
        shares.append(share + sure * math.hypot(part.error(name), share * error) / size)
    return max(shares)


def largest_share(part: Draws, whole: Draws, told: Collection[str]) -> float | None:
    """The largest share among the parameters `told` from noise; None if there is none."""
    return max((part.norm(name) / whole.norm(name) for name in told), default=None)


def relative_variance(part: Draws, whole: Draws, told: Collection[str]) -> float:
    """Variance of a draw of a part, each parameter `told` from noise relative to its own gradient: units differ."""
    return sum(part.variance(name) / whole.norm(name) ** 2 for name in told)

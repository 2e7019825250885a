"""Neyman allocation: how many samples each part of a sum gets, so that its variance is least for the time."""

from __future__ import annotations

import math
from collections.abc import Sequence

from loi_core.errors import OptionError
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = ["allocate", "whole_samples"]


def allocate(variances: Sequence[float], costs: Sequence[float], budget: float) -> list[float]:
    """Split a budget of time among independent estimators so that the variance of their sum is least.

    With n_k samples, estimator k has the variance v_k / n_k and takes the time c_k n_k. Of all n with a total time
    of `budget`, n_k proportional to sqrt(v_k / c_k) has the least total variance, (sum_k sqrt(v_k c_k))^2 / budget.

    Parameters
    ----------
    variances : sequence of float
        Of one sample of each estimator; 0 or more.
    costs : sequence of float
        Seconds that one sample takes; more than 0.
    budget : float
        Seconds; more than 0.

    Returns
    -------
    list of float
        Samples; 0 where the variance is 0. If all variances are 0, every estimator gets the same time.

    Raises
    ------
    OptionError
        If an argument is not allowed, or lengths differ.

    References
    ----------
    J. Neyman, On the two different aspects of the representative method, 1934.
    """
    spreads = [_number("variances", value, zero=True) for value in variances]
    prices = [_number("costs", value, zero=False) for value in costs]
    whole = _number("budget", budget, zero=False)
    if len(spreads) != len(prices) or not spreads:
        msg = f"`variances` and `costs` must be as many, at least one, got {len(spreads)} and {len(prices)}"
        raise OptionError(msg)
    # Square roots of each factor, for products of small numbers leave the range of floats.
    weights = [math.sqrt(spread) * math.sqrt(price) for spread, price in zip(spreads, prices, strict=True)]
    most = max(weights)
    parts = [weight / most for weight in weights] if most > 0.0 else [1.0] * len(weights)
    return [whole * (part / math.fsum(parts)) / price for part, price in zip(parts, prices, strict=True)]


def whole_samples(
    samples: Sequence[float], costs: Sequence[float], budget: float, *, least: int, most: int
) -> list[int]:
    """Samples as powers of two, within a budget of time.

    A renderer may compile once for each number of samples that it meets, so there should be few. Each is rounded
    down; then the one that lost most is doubled, as long as the time allows.

    Parameters
    ----------
    samples : sequence of float
        As :func:`allocate` gives them.
    costs : sequence of float
        Seconds that one sample of each takes.
    budget : float
        Seconds, which only `least` samples of each may exceed.
    least, most : int
        Powers of two between which the samples stay.
    """
    counts = [min(most, max(least, 2 ** math.floor(math.log2(max(1.0, min(one, most)))))) for one in samples]
    spent = math.fsum(count * cost for count, cost in zip(counts, costs, strict=True))
    for k in sorted(range(len(counts)), key=lambda k: counts[k] / max(samples[k], counts[k])):
        if 2 * counts[k] <= most and spent + counts[k] * costs[k] <= budget:
            spent += counts[k] * costs[k]
            counts[k] *= 2
    return counts


def _number(name: str, value: object, *, zero: bool) -> float:
    number = real_number(value)
    if not (number >= 0.0 if zero else number > 0.0) or not math.isfinite(number):
        msg = f"`{name}` must be finite numbers, {'0 or more' if zero else 'more than 0'}, got {shown(value)}"
        raise OptionError(msg)
    return number

"""Neyman allocation of samples to the terms of a sum: minimal variance for a given time."""

from __future__ import annotations

import math
from collections.abc import Sequence

from loi_core.errors import OptionError
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = ["allocate", "power_of_two_samples"]


def allocate(variances: Sequence[float], costs: Sequence[float], budget: float) -> list[float]:
    """Split a time budget among independent estimators so that the variance of their sum is minimal.

    With n_k samples, estimator k has variance v_k / n_k and takes the time c_k n_k. Among all n with a total time of
    `budget`, n_k proportional to sqrt(v_k / c_k) has the least total variance, (sum_k sqrt(v_k c_k))^2 / budget.

    Parameters
    ----------
    variances : sequence of float
        Variance of one sample of each estimator; 0 or more.
    costs : sequence of float
        Seconds per sample; more than 0.
    budget : float
        Seconds; more than 0.

    Returns
    -------
    list of float
        Number of samples; 0 for an estimator with variance 0. If all variances are 0, every estimator gets the same
        time.

    Raises
    ------
    OptionError
        If an argument is not allowed, or lengths differ.

    References
    ----------
    J. Neyman, On the two different aspects of the representative method, 1934.
    """
    checked_variances = [_number("variances", value, zero=True) for value in variances]
    checked_costs = [_number("costs", value, zero=False) for value in costs]
    seconds = _number("budget", budget, zero=False)
    if len(checked_variances) != len(checked_costs) or not checked_variances:
        msg = (
            f"`variances` and `costs` must have the same length, at least 1, "
            f"got {len(checked_variances)} and {len(checked_costs)}"
        )
        raise OptionError(msg)
    # The root of each factor, since products of small numbers underflow.
    weights = [math.sqrt(v) * math.sqrt(c) for v, c in zip(checked_variances, checked_costs, strict=True)]
    largest = max(weights)
    shares = [weight / largest for weight in weights] if largest > 0.0 else [1.0] * len(weights)
    return [seconds * (share / math.fsum(shares)) / cost for share, cost in zip(shares, checked_costs, strict=True)]


def power_of_two_samples(
    samples: Sequence[float], costs: Sequence[float], budget: float, *, minimum: int, maximum: int
) -> list[int]:
    """Round numbers of samples to powers of two within a time budget.

    A renderer may compile once for each number of samples, so there should be few. Each number is rounded down; then
    they are doubled within the budget, starting with the number that lost most.

    Parameters
    ----------
    samples : sequence of float
        The result of :func:`allocate`.
    costs : sequence of float
        Seconds per sample.
    budget : float
        Seconds; exceeded only if `minimum` samples of each estimator already do.
    minimum, maximum : int
        Powers of two that bound the result.
    """
    counts = [
        min(maximum, max(minimum, 2 ** math.floor(math.log2(max(1.0, min(number, maximum)))))) for number in samples
    ]
    spent = math.fsum(count * cost for count, cost in zip(counts, costs, strict=True))
    for k in sorted(range(len(counts)), key=lambda k: counts[k] / max(samples[k], counts[k])):
        if 2 * counts[k] <= maximum and spent + counts[k] * costs[k] <= budget:
            spent += counts[k] * costs[k]
            counts[k] *= 2
    return counts


def _number(name: str, value: object, *, zero: bool) -> float:
    number = real_number(value)
    if not (number >= 0.0 if zero else number > 0.0) or not math.isfinite(number):
        msg = f"`{name}` must be finite numbers, {'0 or more' if zero else 'more than 0'}, got {shown(value)}"
        raise OptionError(msg)
    return number

"""Statistics of gradients that are known from independent noisy draws: debiased norms and angles."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from loi_core.errors import OptionError
from loi_core.support.arrays import Host

__all__ = ["SIGNIFICANT_ERRORS", "Comparison", "Draws", "compare", "total"]


SIGNIFICANT_ERRORS: Final = 2.0
"""Standard errors of a mean beyond which it is significant; the mean of pure noise rarely is."""


@dataclass(frozen=True)
class Draws:
    """Independent draws of one gradient.

    Attributes
    ----------
    gradients : mapping of arrays, shape (draws, size), float64
        Flattened draws by parameter; every parameter has the same number of draws, 2 or more.
    seconds : float
        Duration of one draw.
    """

    gradients: Mapping[str, Host]
    seconds: float = math.nan

    def __post_init__(self) -> None:
        counts = {array.shape[0] if array.ndim == 2 else 0 for array in self.gradients.values()}
        if len(counts) != 1 or min(counts) < 2:
            msg = f"`gradients` must be arrays of shape (draws, size) with the same 2 or more draws, got {counts}"
            raise OptionError(msg)

    @classmethod
    def of(cls, draws: Sequence[Mapping[str, Any]], seconds: float = math.nan) -> Draws:
        """Stack gradients by parameter, one mapping per draw."""
        names = draws[0] if draws else {}
        stacked = {name: np.stack([np.asarray(draw[name], np.float64).reshape(-1) for draw in draws]) for name in names}
        return cls(stacked, seconds)

    def grouped(self, groups: Sequence[Sequence[str]]) -> Draws:
        """Concatenate parameters of the same unit; each group is named by its parameters, joined by commas."""
        joined = {
            ", ".join(names): np.concatenate([self.gradients[name] for name in names], axis=1) for names in groups
        }
        return Draws(joined, self.seconds)

    def first(self, count: int) -> Draws:
        """Return the first `count` draws."""
        return Draws({name: value[:count] for name, value in self.gradients.items()}, self.seconds)

    def minus(self, subtrahend: Draws) -> Draws:
        """Subtract other draws one by one; with common seeds this cancels most of the noise."""
        return Draws({name: value - subtrahend.gradients[name] for name, value in self.gradients.items()})

    def extended(self, further: Draws) -> Draws:
        """Append further draws of the same gradient; the duration is the shorter of the two."""
        joined = {name: np.concatenate([value, further.gradients[name]]) for name, value in self.gradients.items()}
        return Draws(joined, min(self.seconds, further.seconds))

    @property
    def count(self) -> int:
        """Number of draws."""
        return int(next(iter(self.gradients.values())).shape[0])

    def is_zero(self, name: str) -> bool:
        """Return whether every draw is exactly 0."""
        return not np.any(self.gradients[name])

    def norm(self, name: str) -> float:
        """Return the norm of the mean, which residual noise biases upwards."""
        return float(np.linalg.norm(np.mean(self.gradients[name], axis=0)))

    def debiased_norm(self, name: str) -> float:
        """Return the norm of the mean without the average contribution of residual noise."""
        return math.sqrt(max(0.0, self.norm(name) ** 2 - self.standard_error(name) ** 2))

    def is_significant(self, name: str, n_errors: float = SIGNIFICANT_ERRORS) -> bool:
        """Return whether the norm of the mean exceeds `n_errors` standard errors."""
        return self.norm(name) > n_errors * self.standard_error(name)

    @property
    def significant(self) -> tuple[str, ...]:
        """Parameters whose gradient is significant."""
        return tuple(name for name in self.gradients if self.is_significant(name))

    def variance(self, name: str) -> float:
        """Return the variance of one draw, summed over the elements."""
        return float(np.sum(np.var(self.gradients[name], axis=0, ddof=1)))

    def standard_error(self, name: str) -> float:
        """Return the root-mean-square distance of the mean of the draws from the true mean."""
        return math.sqrt(self.variance(name) / self.count)


@dataclass(frozen=True)
class Comparison:
    """Comparison of a gradient with a reference, both known from noisy draws.

    Attributes
    ----------
    cosine, cosine_error : float
        Cosine of the angle between the expected gradients, each parameter scaled to norm 1 for independence of units,
        and its standard error. It is debiased, and may exceed 1 by chance.
    ratio, ratio_error : float
        Ratio of the norms, gradient to reference, likewise.
    noise, reference_noise : float
        Standard deviation of a single draw over the norm, of the gradient and of the reference.
    insignificant : tuple of str
        Parameters without a significant reference gradient, which are left out.
    """

    cosine: float
    cosine_error: float
    ratio: float
    ratio_error: float
    noise: float
    reference_noise: float
    insignificant: tuple[str, ...] = ()


def total(terms: Sequence[Draws]) -> Draws:
    """Return the sum of independently drawn terms, with the smallest number of draws among them.

    A term that is 0 in all its draws counts as 0 in any number of draws.
    """
    names = terms[0].gradients
    nonzero = [term for term in terms if not all(map(term.is_zero, names))] or terms
    count = min(term.count for term in nonzero)
    summed = {name: np.sum([term.gradients[name][:count] for term in nonzero], axis=0) for name in names}
    return Draws(summed, sum(term.seconds for term in terms))


def compare(gradient: Draws, reference: Draws) -> Comparison:
    """Compare a gradient with a reference.

    Inner products are unbiased estimates: of the two gradients from their means, whose noise is independent; of one
    gradient with itself from pairs of different draws. Standard errors are jackknife estimates.

    Parameters
    ----------
    gradient, reference : Draws
        Independent draws of the same parameters.

    Returns
    -------
    Comparison
        NaN throughout if no parameter has a significant reference gradient.
    """
    significant = reference.significant
    insignificant = tuple(name for name in reference.gradients if name not in significant)
    if not significant:
        return Comparison(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, insignificant)
    scales = {name: 1.0 / reference.norm(name) for name in significant}
    first = np.concatenate([gradient.gradients[name] * scales[name] for name in significant], axis=1)
    second = np.concatenate([reference.gradients[name] * scales[name] for name in significant], axis=1)
    cosine, cosine_error = _jackknife(_cosine, first, second)
    ratio, ratio_error = _jackknife(_ratio, first, second)
    return Comparison(cosine, cosine_error, ratio, ratio_error, _noise(first), _noise(second), insignificant)


def _squared_norm(draws: Host) -> float:
    """Return an unbiased estimate of the squared norm of the mean; it may be negative by chance."""
    count = draws.shape[0]
    summed = np.sum(draws, axis=0)
    pairs = float(summed @ summed) - float(np.sum(draws * draws))
    return pairs / float(count * (count - 1))


def _norm(draws: Host) -> float:
    squared = _squared_norm(draws)
    return math.sqrt(squared) if squared > 0.0 else math.nan


def _cosine(first: Host, second: Host) -> float:
    return float(np.mean(first, axis=0) @ np.mean(second, axis=0)) / (_norm(first) * _norm(second))


def _ratio(first: Host, second: Host) -> float:
    return _norm(first) / _norm(second)


def _noise(draws: Host) -> float:
    return math.sqrt(float(np.sum(np.var(draws, axis=0, ddof=1)))) / _norm(draws)


def _jackknife(function: Callable[[Host, Host], float], first: Host, second: Host) -> tuple[float, float]:
    """Return a function of two sets of draws and its standard error, NaN for fewer than 3 draws."""
    estimate = function(first, second)
    variance = 0.0
    for index, draws in enumerate((first, second)):
        count = draws.shape[0]
        if count < 3:
            return estimate, math.nan
        reduced = [np.delete(draws, k, axis=0) for k in range(count)]
        values = np.array([function(subset, second) if index == 0 else function(first, subset) for subset in reduced])
        variance += (count - 1) / count * float(np.sum((values - np.mean(values)) ** 2))
    return estimate, math.sqrt(variance)

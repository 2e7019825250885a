"""Gradients that are known by independent noisy draws: their norms and angles, with the noise taken out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from loi_core.errors import OptionError
from loi_core.support.arrays import Host

__all__ = ["SURE", "Comparison", "Draws", "compare", "total"]


SURE: Final = 2.0
"""Errors of a mean that a decision has to clear; the mean of pure noise rarely does."""


@dataclass(frozen=True)
class Draws:
    """Independent draws of one gradient.

    Attributes
    ----------
    gradients : mapping of arrays, shape (draws, size), float64
        By parameter, each draw flattened; all have the same number of draws, 2 or more.
    seconds : float
        That one draw took.
    """

    gradients: Mapping[str, Host]
    seconds: float = math.nan

    def __post_init__(self) -> None:
        counts = {one.shape[0] if one.ndim == 2 else 0 for one in self.gradients.values()}
        if len(counts) != 1 or min(counts) < 2:
            msg = f"`gradients` must be arrays of shape (draws, size) with the same 2 or more draws, got {counts}"
            raise OptionError(msg)

    @classmethod
    def of(cls, drawn: Sequence[Mapping[str, Any]], seconds: float = math.nan) -> Draws:
        """From gradients by parameter, one mapping a draw."""
        names = drawn[0] if drawn else {}
        stacked = {name: np.stack([np.asarray(one[name], np.float64).reshape(-1) for one in drawn]) for name in names}
        return cls(stacked, seconds)

    def grouped(self, groups: Sequence[Sequence[str]]) -> Draws:
        """The same with parameters of one unit put together, under their names joined by commas."""
        joined = {
            ", ".join(names): np.concatenate([self.gradients[name] for name in names], axis=1) for names in groups
        }
        return Draws(joined, self.seconds)

    def first(self, count: int) -> Draws:
        """Only so many of the draws."""
        return Draws({name: value[:count] for name, value in self.gradients.items()}, self.seconds)

    def less(self, other: Draws) -> Draws:
        """The difference from other draws, one by one; with the same seeds, most of the noise goes as well."""
        return Draws({name: value - other.gradients[name] for name, value in self.gradients.items()})

    def and_more(self, other: Draws) -> Draws:
        """These draws and further ones of the same gradient; the time is that of the faster."""
        both = {name: np.concatenate([value, other.gradients[name]]) for name, value in self.gradients.items()}
        return Draws(both, min(self.seconds, other.seconds))

    @property
    def count(self) -> int:
        """How many draws there are."""
        return int(next(iter(self.gradients.values())).shape[0])

    def zero(self, name: str) -> bool:
        """Whether every draw is exactly 0."""
        return not np.any(self.gradients[name])

    def norm(self, name: str) -> float:
        """Norm of the mean; the noise that is left in the mean makes it too large, if anything."""
        return float(np.linalg.norm(np.mean(self.gradients[name], axis=0)))

    def size(self, name: str) -> float:
        """Norm of the mean less what the noise that is left in it adds on average."""
        return math.sqrt(max(0.0, self.norm(name) ** 2 - self.error(name) ** 2))

    def heard(self, name: str, sure: float = SURE) -> bool:
        """Whether the gradient is significant: its mean exceeds so many of its errors."""
        return self.norm(name) > sure * self.error(name)

    @property
    def significant(self) -> tuple[str, ...]:
        """The parameters whose gradient can be distinguished from noise."""
        return tuple(name for name in self.gradients if self.heard(name))

    def variance(self, name: str) -> float:
        """Variance of one draw, summed over the elements."""
        return float(np.sum(np.var(self.gradients[name], axis=0, ddof=1)))

    def error(self, name: str) -> float:
        """Root mean square of the distance between the mean of the draws and the true mean."""
        return math.sqrt(self.variance(name) / self.count)


@dataclass(frozen=True)
class Comparison:
    """A gradient beside the one it should be, both known by noisy draws.

    Attributes
    ----------
    cosine, cosine_error : float
        Cosine of the angle between the expected gradients, each parameter scaled to norm 1 so that units do not
        matter, and its standard error. The noise is taken out, so that chance may make it exceed 1.
    ratio, ratio_error : float
        Norm of the one over that of the other, likewise.
    noise, wanted_noise : float
        Standard deviation of a single draw over the norm, of the one and of the other.
    silent : tuple of str
        Parameters that are left out, for their gradient cannot be distinguished from noise.
    """

    cosine: float
    cosine_error: float
    ratio: float
    ratio_error: float
    noise: float
    wanted_noise: float
    silent: tuple[str, ...] = ()


def total(parts: Sequence[Draws]) -> Draws:
    """The sum of gradients that were drawn independently; with as many draws as the one that has fewest.

    A part that is 0 in all its draws is 0 in any, however few they are.
    """
    names = parts[0].gradients
    there = [one for one in parts if not all(map(one.zero, names))] or parts
    count = min(one.count for one in there)
    summed = {name: np.sum([one.gradients[name][:count] for one in there], axis=0) for name in names}
    return Draws(summed, sum(one.seconds for one in parts))


def compare(found: Draws, wanted: Draws) -> Comparison:
    """How far a gradient is from the one it should be.

    Inner products are estimated without bias: of the two with each other from their means, whose noises are
    independent; of one with itself from pairs of different draws. Standard errors are those of the jackknife.

    Parameters
    ----------
    found, wanted : Draws
        Independent of each other, with the same parameters.

    Returns
    -------
    Comparison
        NaN throughout if no parameter has a gradient that can be distinguished from noise.
    """
    heard = wanted.significant
    silent = tuple(name for name in wanted.gradients if name not in heard)
    if not heard:
        return Comparison(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, silent)
    scales = {name: 1.0 / wanted.norm(name) for name in heard}
    one = np.concatenate([found.gradients[name] * scales[name] for name in heard], axis=1)
    other = np.concatenate([wanted.gradients[name] * scales[name] for name in heard], axis=1)
    cosine, cosine_error = _jackknife(_cosine, one, other)
    ratio, ratio_error = _jackknife(_ratio, one, other)
    return Comparison(cosine, cosine_error, ratio, ratio_error, _noise(one), _noise(other), silent)


def _square(draws: Host) -> float:
    """Squared norm of the expected draw, without bias; may be below 0 by chance."""
    count = draws.shape[0]
    summed = np.sum(draws, axis=0)
    pairs = float(summed @ summed) - float(np.sum(draws * draws))
    return pairs / float(count * (count - 1))


def _root(draws: Host) -> float:
    square = _square(draws)
    return math.sqrt(square) if square > 0.0 else math.nan


def _cosine(one: Host, other: Host) -> float:
    return float(np.mean(one, axis=0) @ np.mean(other, axis=0)) / (_root(one) * _root(other))


def _ratio(one: Host, other: Host) -> float:
    return _root(one) / _root(other)


def _noise(draws: Host) -> float:
    return math.sqrt(float(np.sum(np.var(draws, axis=0, ddof=1)))) / _root(draws)


def _jackknife(function: Callable[[Host, Host], float], one: Host, other: Host) -> tuple[float, float]:
    """The value of a function of two sets of draws, and its standard error; NaN where there are too few draws."""
    whole = function(one, other)
    variance = 0.0
    for index, draws in enumerate((one, other)):
        count = draws.shape[0]
        if count < 3:
            return whole, math.nan
        without = [np.delete(draws, k, axis=0) for k in range(count)]
        values = np.array([function(left, other) if index == 0 else function(one, left) for left in without])
        variance += (count - 1) / count * float(np.sum((values - np.mean(values)) ** 2))
    return whole, math.sqrt(variance)

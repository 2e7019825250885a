"""Where gradient descent ends on an error landscape: along one parameter exactly, in several by small steps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from examples.paper.figures.signals import Host, Movers
from examples.paper.lib.methods import Comparison

__all__ = ["FOUND", "NEAR", "Descents", "Landscape", "descend", "landscape"]

FOUND: Final = 0.1  # pixels from the target
NEAR: Final = 0.5  # pixels: noise moves the minimum itself
PLATEAU: Final = 1e-6  # a slope of less than this share of the steepest is none: float32 could not tell it from 0
HALVINGS: Final = 8  # of the interval between two values in which the slope changes its sign


@dataclass(frozen=True)
class Descents:
    """Where descent ends from each of many starts, for one parameter.

    Attributes
    ----------
    starts, ends : arrays, shape (N,)
        In pixels; the starts increase evenly.
    target : float
        The value that the reference shows.
    """

    starts: Host
    ends: Host
    target: float

    def reached(self, within: float) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Whether the descent from each start ends `within` so many pixels of the target."""
        return np.abs(self.ends - self.target) <= within

    def share(self, within: float) -> float:
        """The share of starts from which it does."""
        return float(np.mean(self.reached(within)))

    def basin(self, within: float) -> tuple[float, float]:
        """The interval of such starts, by their distances from the target; (0, 0) if there are none.

        It has no gaps: what starts between two starts ends between their ends.
        """
        found = self.starts[self.reached(within)] - self.target
        if not found.size:
            return 0.0, 0.0
        half = 0.5 * (self.starts[1] - self.starts[0])
        return float(found[0] - half), float(found[-1] + half)

    @property
    def offset(self) -> float:
        """From the target to where descent from next to it ends, in pixels."""
        return float(self.ends[np.argmin(np.abs(self.starts - self.target))] - self.target)

    def followed_by(self, other: Descents) -> Descents:
        """Descents on another landscape from where these end."""
        nearest = np.argmin(np.abs(self.ends[:, None] - other.starts), axis=1)
        return Descents(self.starts, other.ends[nearest], self.target)


@dataclass(frozen=True)
class Landscape:
    """The error of one parameter, by its slopes.

    Attributes
    ----------
    places : array, shape (N,)
        Values of the parameter, in pixels, increasing and evenly spaced.
    slopes : array, shape (N,)
        Derivative of the error there.
    minima : dict of float
        By the index of the value before it, where the slope goes from below 0 to above.
    target : float
        The value that the reference shows.
    """

    places: Host
    slopes: Host
    minima: dict[int, float]
    target: float

    @cached_property
    def descents(self) -> Descents:
        """Descent from every value: to a minimum, to where a plateau begins, or to a bound."""
        ways = _ways(self.slopes)
        ends = self.places.copy()
        last = len(ends) - 1
        for way, order in ((1, range(last - 1, -1, -1)), (-1, range(1, last + 1))):
            for index in order:
                if ways[index] == way:
                    after = index + way
                    ends[index] = self.minima[min(index, after)] if ways[after] == -way else ends[after]
        return Descents(self.places, ends, self.target)


def landscape(movers: Movers, comparison: Comparison, target: float, spacing: float) -> Landscape:
    """The landscape over all places that the only parameter may have, about `spacing` pixels apart."""
    low, high = (float(one[0]) for one in movers.bounds)
    count = round((high - low) / spacing)
    places = low + (high - low) * (np.arange(count) + 0.5) / count
    slopes = _slopes(movers, comparison, places[:, None])[:, 0]
    ways = _ways(slopes)
    before = np.flatnonzero((ways[:-1] == 1) & (ways[1:] == -1))
    left, right = places[before], places[before + 1]
    for _ in range(HALVINGS if before.size else 0):
        middle = 0.5 * (left + right)
        rising = _slopes(movers, comparison, middle[:, None])[:, 0] > 0.0
        left, right = np.where(rising, left, middle), np.where(rising, middle, right)
    minima = dict(zip(before.tolist(), (0.5 * (left + right)).tolist(), strict=True))
    return Landscape(places, slopes, minima, target)


def descend(movers: Movers, comparison: Comparison, starts: Host, steps: int) -> Host:
    """Where descent ends from each start; `starts` and the result have shape (N, P).

    Every step goes down the gradient, over all parameters together, from one pixel at first to a hundredth at last.
    """
    low, high = movers.bounds
    places, steepest = starts.copy(), 0.0
    for step in range(steps):
        length = 0.01 ** (step / max(steps - 1, 1))
        slopes = _slopes(movers, comparison, places)
        sizes = np.linalg.norm(slopes, axis=1, keepdims=True)
        steepest = max(steepest, float(sizes.max()))
        steep = sizes > PLATEAU * steepest
        places = np.clip(places - length * np.where(steep, slopes / np.where(steep, sizes, 1.0), 0.0), low, high)
    return places


def _ways(slopes: Host) -> Host:
    """Where descent goes: 1 to greater values, -1 to smaller ones, 0 where it stays."""
    steepest = float(np.max(np.abs(slopes)))
    return np.where(np.abs(slopes) <= PLATEAU * steepest, 0.0, -np.sign(slopes))


def _slopes(movers: Movers, comparison: Comparison, places: Host) -> Host:
    """Derivatives of the error by the parameters, shape (N, P)."""
    return movers.slopes(places, comparison.gradients(movers.images(places)))

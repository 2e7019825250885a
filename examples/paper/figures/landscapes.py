"""Endpoints of gradient descent on an error landscape: exact along one parameter, by small steps in several."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from examples.paper.figures.signals import Host, MovingObjects
from examples.paper.lib.methods import Comparison

__all__ = ["NEAR_DISTANCE_PX", "REACHED_DISTANCE_PX", "Descents", "Landscape", "descend", "landscape"]

REACHED_DISTANCE_PX: Final = 0.1  # from the target
NEAR_DISTANCE_PX: Final = 0.5  # from the target: noise moves the minimum itself
PLATEAU_SHARE: Final = 1e-6  # of the steepest slope: in float32 a smaller slope is indistinguishable from 0
MINIMUM_BISECTIONS: Final = 8  # of the interval between two values where the slope changes its sign


@dataclass(frozen=True)
class Descents:
    """Gradient descents from many starts, for one parameter.

    Attributes
    ----------
    starts : array, shape (N,)
        Parameter at the start, in pixels, increasing and evenly spaced.
    endpoints : array, shape (N,)
        Parameter at the end, in pixels.
    target : float
        Parameter of the reference.
    """

    starts: Host
    endpoints: Host
    target: float

    def reached(self, distance: float) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Return whether each descent ends within `distance` pixels of the target."""
        return np.abs(self.endpoints - self.target) <= distance

    def share(self, distance: float) -> float:
        """Return the share of descents that end within `distance` pixels of the target."""
        return float(np.mean(self.reached(distance)))

    def basin(self, distance: float) -> tuple[float, float]:
        """Return the interval of starts whose descents reach the target, relative to it; (0, 0) if none does.

        The interval has no gaps, because descents from two starts keep their order.
        """
        offsets = self.starts[self.reached(distance)] - self.target
        if not offsets.size:
            return 0.0, 0.0
        half = 0.5 * (self.starts[1] - self.starts[0])
        return float(offsets[0] - half), float(offsets[-1] + half)

    @property
    def offset(self) -> float:
        """Signed distance from the target to the endpoint of the descent that starts closest to it, in pixels."""
        return float(self.endpoints[np.argmin(np.abs(self.starts - self.target))] - self.target)

    def followed_by(self, descents: Descents) -> Descents:
        """Return descents that continue on another landscape from the endpoints of these."""
        nearest = np.argmin(np.abs(self.endpoints[:, None] - descents.starts), axis=1)
        return Descents(self.starts, descents.endpoints[nearest], self.target)


@dataclass(frozen=True)
class Landscape:
    """Error as a function of one parameter, represented by its slopes.

    Attributes
    ----------
    positions : array, shape (N,)
        Values of the parameter, in pixels, increasing and evenly spaced.
    slopes : array, shape (N,)
        Derivative of the error at each value.
    minima : dict of float
        Minima by the index of the value before them, where the slope changes from negative to positive.
    target : float
        Parameter of the reference.
    """

    positions: Host
    slopes: Host
    minima: dict[int, float]
    target: float

    @cached_property
    def descents(self) -> Descents:
        """Descents from every value: each ends at a minimum, at the border of a plateau, or at a bound."""
        signs = _descent_signs(self.slopes)
        endpoints = self.positions.copy()
        last = len(endpoints) - 1
        for sign, order in ((1, range(last - 1, -1, -1)), (-1, range(1, last + 1))):
            for index in order:
                if signs[index] == sign:
                    neighbour = index + sign
                    is_across_minimum = signs[neighbour] == -sign
                    endpoints[index] = self.minima[min(index, neighbour)] if is_across_minimum else endpoints[neighbour]
        return Descents(self.positions, endpoints, self.target)


def landscape(objects: MovingObjects, comparison: Comparison, target: float, spacing: float) -> Landscape:
    """Return the landscape over the range of the only parameter, sampled about every `spacing` pixels."""
    lower, upper = (float(bound[0]) for bound in objects.bounds)
    count = round((upper - lower) / spacing)
    positions = lower + (upper - lower) * (np.arange(count) + 0.5) / count
    slopes = _slopes(objects, comparison, positions[:, None])[:, 0]
    signs = _descent_signs(slopes)
    brackets = np.flatnonzero((signs[:-1] == 1) & (signs[1:] == -1))
    left, right = positions[brackets], positions[brackets + 1]
    for _ in range(MINIMUM_BISECTIONS if brackets.size else 0):
        middle = 0.5 * (left + right)
        is_rising = _slopes(objects, comparison, middle[:, None])[:, 0] > 0.0
        left, right = np.where(is_rising, left, middle), np.where(is_rising, middle, right)
    minima = dict(zip(brackets.tolist(), (0.5 * (left + right)).tolist(), strict=True))
    return Landscape(positions, slopes, minima, target)


def descend(objects: MovingObjects, comparison: Comparison, starts: Host, steps: int) -> Host:
    """Return the endpoint of descent from each start, shape (N, P), as the starts.

    Every step follows the gradient over all parameters together. Its length falls from one pixel to a hundredth.
    """
    lower, upper = objects.bounds
    params, steepest = starts.copy(), 0.0
    for step in range(steps):
        length = 0.01 ** (step / max(steps - 1, 1))
        slopes = _slopes(objects, comparison, params)
        norms = np.linalg.norm(slopes, axis=1, keepdims=True)
        steepest = max(steepest, float(norms.max()))
        is_steep = norms > PLATEAU_SHARE * steepest
        directions = np.where(is_steep, slopes / np.where(is_steep, norms, 1.0), 0.0)
        params = np.clip(params - length * directions, lower, upper)
    return params


def _descent_signs(slopes: Host) -> Host:
    """Return the direction of descent: 1 to greater values, -1 to smaller ones, 0 on a plateau."""
    steepest = float(np.max(np.abs(slopes)))
    return np.where(np.abs(slopes) <= PLATEAU_SHARE * steepest, 0.0, -np.sign(slopes))


def _slopes(objects: MovingObjects, comparison: Comparison, params: Host) -> Host:
    """Return derivatives of the error with respect to the parameters, shape (N, P)."""
    return objects.vjp(params, comparison.gradients(objects.images(params)))

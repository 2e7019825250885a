"""Starting parameters: quasi-random draws within the bounds, a search among them, and successive halving."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final, Protocol, TypeAlias

import numpy as np

from loi_core.errors import OptionError
from loi_core.fitting.parameters import Bounds, free_numbers, host_values
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import from_numpy, to_numpy

__all__ = [
    "RACE_ROUNDS",
    "ROUND_STEPS",
    "SEARCH_DRAWS",
    "RaceSize",
    "Reached",
    "can_search",
    "draw_starts",
    "race",
    "search",
    "successive_halving",
    "unbounded_parameters",
]

ROUND_FRACTION: Final = 1.0 / 6.0  # of the steps of a fit, in each round of successive halving
MAX_FINALISTS: Final = 4
AGREEMENT: Final = 0.05  # of the range: finalists within this distance of the best agree with it
SEARCH_DRAWS: Final = 48  # 16 are too few for an object that is out of view
LOCAL_SEARCH_DRAWS: Final = 32
LOCAL_RADIUS: Final = 0.15  # of the range, to either side
DRAWS_PER_STEP: Final = 1.2  # of a race, for each step of the fit
SHORT_FIT_STEPS: Final = 100  # a shorter fit has no renders to spare
SHORT_FIT_DRAWS_PER_STEP: Final = 0.3
MAX_RACE_DRAWS: Final = 128
DRAWS_PER_RACER: Final = 16  # a point near the target is seldom below the best sixteenth
RACE_ROUNDS: Final = 3  # after each, the half with the larger losses drops out
ROUND_STEPS: Final = 4  # at a high rate
WINNING_FRACTION: Final = 0.2  # of the loss at the current parameters: if the descent from them reaches it, it has won
DECISIVE_FRACTION: Final = 0.1  # of the least loss at the start of a race: another racer that reaches it has won
NEAR_FRACTION: Final = 0.05  # of the loss at earlier parameters of the fit: a descent below it is near its target
LEAD_FRACTION: Final = 0.9  # of the loss of the descent from the current parameters, which another racer must reach
GAIN_FRACTION: Final = 0.7  # of the loss at the current parameters, which the descent from them must reach
LOW_FRACTION: Final = 0.25  # of the least loss of all draws: a descent that gains below it needs no race
MAX_COVERED_NUMBERS: Final = 3  # in more dimensions hardly a draw has all numbers near the target
MAX_SEARCH_NUMBERS: Final = 8  # in more dimensions so few draws cover next to nothing


@dataclass(frozen=True)
class Reached:
    """The least loss of a descent so far.

    Attributes
    ----------
    value : float
    params : dict of arrays
    rates : dict of float
        Learning rates of the last steps; empty before the first.
    """

    value: float
    params: Parameters
    rates: Mapping[str, float] = field(default_factory=dict)


Evaluate: TypeAlias = Callable[[Parameters], float]
"""Returns the loss of parameters."""


class Descend(Protocol):
    """Descends from parameters, at a high rate or not; yields its least loss after each round of steps."""

    def __call__(self, start: Parameters, /, *, fast: bool) -> Iterator[Reached]: ...


RunRound: TypeAlias = Callable[[Parameters, int, int], tuple[float, Parameters]]
"""Fits from a start for a stage and a number of steps; returns the last objective's value, and the parameters."""


def draw_starts(params: Parameters, bounds: Bounds, count: int, *, first: int = 1) -> list[Parameters]:
    """Return `params` and ``count - 1`` points that fill their bounds evenly, from point `first` of a sequence on.

    The sequence is an additive recurrence on powers of the generalised golden ratio (M. Roberts, The unreasonable
    effectiveness of quasirandom sequences, 2018): its first points are well spread for any count, in any dimension.

    Raises
    ------
    OptionError
        If a bound is infinite.
    """
    lowest, highest = (
        {name: np.asarray(to_numpy(limit), dtype=np.float64) for name, limit in limits.items()}
        for limits in (bounds.lower, bounds.upper)
    )
    for name in lowest:
        if not (np.all(np.isfinite(lowest[name])) and np.all(np.isfinite(highest[name]))):
            msg = f"`starts` draws within bounds, and {name!r} has none; give it `lower` and `upper`"
            raise OptionError(msg)
    movable = {name: lowest[name] < highest[name] for name in lowest}
    size = sum(int(np.sum(mask)) for mask in movable.values())
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (size + 1))
    steps = ratio ** -np.arange(1.0, size + 1.0)
    starts = [params]
    for index in range(first, first + count - 1):
        point, offset = np.mod(0.5 + index * steps, 1.0), 0
        start = dict(params)
        for name, floor in lowest.items():
            value, mask = floor.copy(), movable[name]
            fractions = point[offset : offset + int(np.sum(mask))]
            offset += fractions.size
            value[mask] += fractions * (highest[name] - floor)[mask]
            start[name] = from_numpy(value, params[name])
        starts.append(start)
    return starts


def unbounded_parameters(bounds: Bounds) -> list[str]:
    """Return the free parameters with an entry that lacks a lower or an upper bound."""
    return [
        name
        for name, lower in bounds.lower.items()
        if not (np.all(np.isfinite(to_numpy(lower))) and np.all(np.isfinite(to_numpy(bounds.upper[name]))))
    ]


def can_search(bounds: Bounds) -> bool:
    """Return whether the free parameters are few enough, and all bounded, for a search."""
    return not unbounded_parameters(bounds) and free_numbers(bounds) <= MAX_SEARCH_NUMBERS


def search(
    evaluate: Evaluate, params: Parameters, bounds: Bounds, attempt: int, *, local: bool = False
) -> tuple[float, Parameters] | None:
    """Return the least loss at some points within the bounds, and its parameters; each attempt draws other points.

    With `local`, every other point lies in a box around the parameters. If there are several parameters, only one of
    them moves at three of four points, each in turn, since the others may be right.
    """
    points = _local_draws(params, bounds, attempt) if local else _draws(params, bounds, SEARCH_DRAWS, attempt)
    return min(_evaluated(evaluate, points), key=_loss, default=None)


@dataclass(frozen=True)
class RaceSize:
    """The size of a race.

    Attributes
    ----------
    draws : int
        Number of points within the bounds whose loss is evaluated.
    racers : int
        Number of descents, which start at the points with the least loss.
    """

    draws: int
    racers: int

    @classmethod
    def of(cls, steps: int) -> RaceSize:
        """Return the size for a fit of a number of steps; such a race renders at most 1.9 times as often."""
        density = DRAWS_PER_STEP if steps >= SHORT_FIT_STEPS else SHORT_FIT_DRAWS_PER_STEP
        draws = min(max(round(density * steps), DRAWS_PER_RACER), MAX_RACE_DRAWS)
        return cls(draws, draws // DRAWS_PER_RACER)


def race(
    evaluate: Evaluate,
    descend: Descend,
    params: Parameters,
    bounds: Bounds,
    size: RaceSize,
    earlier: Iterable[Parameters] = (),
) -> Reached | None:
    """Return parameters with a far lower loss, a few steps from the current ones or from another point.

    The descents from the current parameters, and from earlier ones of the fit with a lower loss, run first, and end the
    race if they come near the target: a loss often no longer falls because the steps are too long. The other racers
    start at the other earlier parameters, and at those with the least loss among some points within the bounds. A point
    near the target may have a larger loss than a point with a wrong side in view; a few steps distinguish them. Only
    such points descend at a high rate, which would lead far away from the others. The result is None if no racer gains
    much.
    """
    first = evaluate(params)
    tried = list(_evaluated(evaluate, earlier))
    near = NEAR_FRACTION * max((value for value, _ in tried), default=0.0)
    leaders = [Reached(first, params), *(Reached(*entry) for entry in tried if entry[0] < first)]
    tried = [entry for entry in tried if not entry[0] < first]
    ran = []
    for leader in leaders:
        racer = _Racer(descend(leader.params, fast=False), leader)
        for _ in range(RACE_ROUNDS):
            racer.run()
        if racer.reached.value < max(WINNING_FRACTION * leader.value, near):
            return racer.reached
        ran.append(racer.reached)
    current = min(ran, key=lambda reached: reached.value)
    points: Iterable[Parameters] = _draws(params, bounds, size.draws, 0)
    if free_numbers(bounds) > MAX_COVERED_NUMBERS:
        points = _mixed(points, params, list(bounds.lower))
    drawn = sorted(_evaluated(evaluate, points), key=_loss)[: size.racers]
    gained = current if current.value < GAIN_FRACTION * first else None
    if gained is not None and drawn and current.value < LOW_FRACTION * drawn[0][0]:
        return gained
    winning_loss = DECISIVE_FRACTION * min([first, *(value for value, _ in (*tried, *drawn))])
    others = [
        _Racer(descend(point, fast=is_drawn), Reached(value, point))
        for points, is_drawn in ((tried, False), (drawn, True))
        for value, point in points
    ]
    for _ in range(RACE_ROUNDS):
        for racer in others:
            racer.run()
            if racer.reached.value < winning_loss:
                return racer.reached
        others.sort(key=lambda racer: racer.reached.value)
        others = others[: max(len(others) // 2, 1)]
    if others and others[0].reached.value < LEAD_FRACTION * current.value:
        return others[0].reached
    return gained


@dataclass
class _Racer:
    """A descent, and the least loss that it has reached."""

    rounds: Iterator[Reached]
    reached: Reached

    def run(self) -> None:
        """Take the steps of one round."""
        with suppress(Exception):  # as in a search
            self.reached = min(self.reached, next(self.rounds), key=lambda reached: reached.value)


def _loss(entry: tuple[float, Parameters]) -> float:
    return entry[0]


def _evaluated(evaluate: Evaluate, points: Iterable[Parameters]) -> Iterator[tuple[float, Parameters]]:
    """Yield the finite losses and their points."""
    for point in points:
        value = math.inf
        with suppress(Exception):  # a renderer need not accept every point within the bounds
            value = evaluate(point)
        if math.isfinite(value):
            yield value, point


def _draws(params: Parameters, bounds: Bounds, count: int, attempt: int) -> list[Parameters]:
    return draw_starts(params, bounds, count + 1, first=1 + attempt * count)[1:]


def _local_draws(params: Parameters, bounds: Bounds, attempt: int) -> Iterator[Parameters]:
    everywhere, nearby = (
        _draws(params, box, LOCAL_SEARCH_DRAWS, attempt) for box in (bounds, _box_around(params, bounds))
    )
    names, singles = list(bounds.lower), 0
    for index, (anywhere, near_by) in enumerate(zip(everywhere, nearby, strict=True)):
        if len(names) > 1 and index % 8 > 1:
            name, singles = names[singles % len(names)], singles + 1
            yield params | {name: anywhere[name]}
        else:
            yield near_by if index % 2 else anywhere


def _mixed(points: Iterable[Parameters], params: Parameters, names: Sequence[str]) -> Iterator[Parameters]:
    """Yield every other point as it is, and the others with some parameters, in turn, that stay: they may be right."""
    subsets = 2 ** len(names) - 2
    for index, point in enumerate(points):
        subset = 1 + index // 2 % subsets if index % 2 and subsets else 0
        yield point | {name: params[name] for number, name in enumerate(names) if subset >> number & 1}


def _box_around(params: Parameters, bounds: Bounds) -> Bounds:
    lower, upper = {}, {}
    for name in bounds.lower:
        centre, lowest, highest = host_values(params, bounds, name)
        radius = LOCAL_RADIUS * (highest - lowest)
        lower[name] = from_numpy(np.maximum(lowest, centre - radius), params[name])
        upper[name] = from_numpy(np.minimum(highest, centre + radius), params[name])
    return Bounds(lower, upper)


def successive_halving(
    params: Parameters, bounds: Bounds, count: int, stages: int, steps: int, run: RunRound
) -> tuple[Parameters, int]:
    """Return the best of `count` starts, and how many finalists agree with it.

    In every round each candidate takes a sixth of the steps, with the objectives from far to near in turn, and the half
    with the larger values of the last objective drops out.
    """
    candidates = draw_starts(params, bounds, count)
    round_steps, rounds = max(round(ROUND_FRACTION * steps), 2), 0
    while len(candidates) > 1:
        runs = [run(start, min(rounds, stages - 1), round_steps) for start in candidates]
        runs.sort(key=lambda outcome: outcome[0])
        rounds += 1
        if len(runs) <= MAX_FINALISTS and rounds >= stages:
            best = runs[0][1]
            return best, sum(_agree(best, finalist, bounds) for _, finalist in runs)
        candidates = [params for _, params in runs[: max(len(runs) // 2, 1)]]
    return candidates[0], 1


def _agree(best: Parameters, finalist: Parameters, bounds: Bounds) -> bool:
    for name, floor in bounds.lower.items():
        lowest, highest, first, second = (
            to_numpy(value) for value in (floor, bounds.upper[name], best[name], finalist[name])
        )
        if not np.all(np.abs(first - second) <= AGREEMENT * (highest - lowest)):
            return False
    return True

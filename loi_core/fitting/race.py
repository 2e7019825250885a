"""Several starts: they race by successive halving, and the winner is fitted in full."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Final, TypeAlias

import numpy as np

from loi_core.errors import OptionError
from loi_core.fitting.parameters import Bounds
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import from_numpy, to_numpy

__all__ = ["PLACES", "can_search", "draw_starts", "moving", "race", "search", "unbounded"]

LAP: Final = 1.0 / 6.0  # of the steps of a fit
PLACES: Final = 48  # that a search looks at; of 16, too few show an object that the views of a scene have lost
NEAR: Final = 32  # that a search near the parameters looks at
BOX: Final = 0.15  # of the range, to either side: what is near
Value: TypeAlias = Callable[[Parameters], float]
"""What the loss is somewhere."""

FEW: Final = 8  # numbers: in more dimensions so few places say next to nothing
AGREE: Final = 0.05  # of the range: finalists that end so near the best agree with it


def draw_starts(params: Parameters, bounds: Bounds, count: int, *, first: int = 1) -> list[Parameters]:
    """`params` themselves, and others that fill their bounds evenly: points of a sequence, from the `first` on.

    An additive recurrence on powers of the generalised golden ratio (M. Roberts, The unreasonable effectiveness of
    quasirandom sequences, 2018): any number of points of it is spread well, in any dimension.

    Raises
    ------
    OptionError
        If a bound is infinite.
    """
    low, high = (
        {name: np.asarray(to_numpy(one), dtype=np.float64) for name, one in side.items()}
        for side in (bounds.lower, bounds.upper)
    )
    for name in low:
        if not (np.all(np.isfinite(low[name])) and np.all(np.isfinite(high[name]))):
            msg = f"`starts` draws within bounds, and {name!r} has none; give it `lower` and `upper`"
            raise OptionError(msg)
    moving = {name: low[name] < high[name] for name in low}
    size = sum(int(np.sum(one)) for one in moving.values())
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (size + 1))
    steps = ratio ** -np.arange(1.0, size + 1.0)
    starts = [params]
    for index in range(first, first + count - 1):
        place, at = np.mod(0.5 + index * steps, 1.0), 0
        drawn = dict(params)
        for name, floor in low.items():
            value, where = floor.copy(), moving[name]
            part = place[at : at + int(np.sum(where))]
            at += part.size
            value[where] += part * (high[name] - floor)[where]
            drawn[name] = from_numpy(value, params[name])
        starts.append(drawn)
    return starts


def moving(bounds: Bounds) -> int:
    """How many numbers may move."""
    return sum(
        int(np.sum(np.asarray(to_numpy(low)) < np.asarray(to_numpy(bounds.upper[name]))))
        for name, low in bounds.lower.items()
    )


def unbounded(bounds: Bounds) -> list[str]:
    """The free parameters that have an entry without a lower or an upper bound."""
    return [
        name
        for name, lower in bounds.lower.items()
        if not (np.all(np.isfinite(to_numpy(lower))) and np.all(np.isfinite(to_numpy(bounds.upper[name]))))
    ]


def can_search(bounds: Bounds) -> bool:
    """Whether there are few enough parameters, all bounded, for a few places to say something about the others."""
    return not unbounded(bounds) and moving(bounds) <= FEW


def search(
    value: Value, params: Parameters, bounds: Bounds, turn: int, *, near: bool = False
) -> tuple[float, Parameters] | None:
    """The least value at some places within the bounds, and where that is; others in every turn.

    With `near`, every other place is in a smaller box about where the parameters are; and if there are several
    parameters, at three of four places only one of them is elsewhere, each in turn: the others may be right.
    """
    best: tuple[float, Parameters] | None = None
    for place in _near_places(params, bounds, turn) if near else _places(params, bounds, PLACES, turn):
        found = math.inf
        with suppress(Exception):  # a renderer need not take every place within the bounds
            found = value(place)
        if not math.isfinite(found):
            continue
        if best is None or found < best[0]:
            best = found, place
    return best


def _places(params: Parameters, bounds: Bounds, count: int, turn: int) -> list[Parameters]:
    """Some places within the bounds, others in every turn."""
    return draw_starts(params, bounds, count + 1, first=1 + turn * count)[1:]


def _near_places(params: Parameters, bounds: Bounds, turn: int) -> Iterator[Parameters]:
    far, close = (_places(params, box, NEAR, turn) for box in (bounds, _about(params, bounds)))
    names, alone = list(bounds.lower), 0
    for index, (there, here) in enumerate(zip(far, close, strict=True)):
        if len(names) > 1 and index % 8 > 1:
            name, alone = names[alone % len(names)], alone + 1
            yield params | {name: there[name]}
        else:
            yield here if index % 2 else there


def _about(params: Parameters, bounds: Bounds) -> Bounds:
    """A box about the parameters, within their bounds."""
    lower, upper = {}, {}
    for name, floor in bounds.lower.items():
        at, low, high = (
            np.asarray(to_numpy(one), dtype=np.float64) for one in (params[name], floor, bounds.upper[name])
        )
        reach = BOX * (high - low)
        lower[name] = from_numpy(np.maximum(low, at - reach), params[name])
        upper[name] = from_numpy(np.minimum(high, at + reach), params[name])
    return Bounds(lower, upper)


def race(
    params: Parameters,
    bounds: Bounds,
    count: int,
    stages: int,
    steps: int,
    run: Callable[[Parameters, int, int], tuple[float, Parameters]],
) -> tuple[Parameters, int]:
    """Where to start: the winner's place, and how many of the finalists came to where it is.

    In every lap all that are left take a sixth of the steps, with the objectives from far to near in turn, and the half
    with the larger values of the last objective drops out. `run` takes a start, a stage and a number of steps, and
    gives the value of the last objective where they led, and that place.
    """
    field = draw_starts(params, bounds, count)
    lap, turn = max(round(LAP * steps), 2), 0
    while len(field) > 1:
        runs = [run(start, min(turn, stages - 1), lap) for start in field]
        runs.sort(key=lambda one: one[0])
        turn += 1
        if len(runs) <= 4 and turn >= stages:
            best = runs[0][1]
            return best, sum(_near(best, other, bounds) for _, other in runs)
        field = [one for _, one in runs[: max(len(runs) // 2, 1)]]
    return field[0], 1


def _near(best: Parameters, other: Parameters, bounds: Bounds) -> bool:
    for name, floor in bounds.lower.items():
        low, high, one, two = (to_numpy(each) for each in (floor, bounds.upper[name], best[name], other[name]))
        if not np.all(np.abs(one - two) <= AGREE * (high - low)):
            return False
    return True

"""Where a fit is stuck, several points race, and the search begins where the far stage runs out of steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from loi_core.fitting.parameters import Bounds
from loi_core.fitting.rates import racing_factors
from loi_core.fitting.schedule import Schedule
from loi_core.fitting.starts import RACE_ROUNDS, RACERS, SEARCH_DRAWS, race

BOUNDS = Bounds({"angle": np.asarray(-180.0)}, {"angle": np.asarray(180.0)})
GOAL = 100.0

Params = dict[str, Any]


def loss(params: Params) -> float:
    """A wide basin around the wrong angle, -60, and a narrow, deeper basin around the goal."""
    angle = float(params["angle"])
    return 1.0 - 0.7 * float(np.exp(-(((angle + 60.0) / 60.0) ** 2))) - float(np.exp(-(((angle - GOAL) / 15.0) ** 2)))


def descent(rate: float) -> Callable[[Params], Iterator[tuple[float, Params]]]:
    """Return a descent by differences that yields after every four steps."""

    def descend(params: Params) -> Iterator[tuple[float, Params]]:
        angle, best = float(params["angle"]), (loss(params), params)
        while True:
            for _ in range(4):
                slope = loss({"angle": angle + 0.5}) - loss({"angle": angle - 0.5})
                angle -= rate * float(np.sign(slope))
                best = min(best, (loss({"angle": angle}), {"angle": np.asarray(angle)}), key=lambda entry: entry[0])
            yield best

    return descend


def test_a_race_finds_the_deeper_of_two_basins_though_most_points_lead_to_the_other() -> None:
    found = race(loss, descent(3.0), {"angle": np.asarray(-60.0)}, BOUNDS)
    assert found is not None
    assert abs(float(found["angle"]) - GOAL) < 3.0


def test_a_race_from_the_goal_stays_there() -> None:
    found = race(loss, descent(3.0), {"angle": np.asarray(GOAL)}, BOUNDS)
    assert found is None or float(found["angle"]) == GOAL


def test_a_racer_that_nearly_reaches_zero_ends_the_race() -> None:
    rounds = 0

    def descend(params: Params) -> Iterator[tuple[float, Params]]:
        nonlocal rounds
        while True:
            rounds += 1
            yield (1e-6, {"angle": np.asarray(GOAL)})

    found = race(loss, descend, {"angle": np.asarray(0.0)}, BOUNDS)
    assert found is not None
    assert rounds == 1


def test_half_of_the_racers_drop_out_after_each_round() -> None:
    rounds = 0

    def descend(params: Params) -> Iterator[tuple[float, Params]]:
        nonlocal rounds
        while True:
            rounds += 1
            yield loss(params) + 1.0, params

    race(lambda params: loss(params) + 1.0, descend, {"angle": np.asarray(0.0)}, BOUNDS)
    assert rounds == RACE_ROUNDS + RACERS + RACERS // 2 + RACERS // 4


def test_points_and_descents_that_fail_drop_out() -> None:
    calls = 0

    def evaluate(params: Params) -> float:
        nonlocal calls
        calls += 1
        if calls > 1 and calls % 2:
            raise ValueError
        return loss(params)

    def descend(params: Params) -> Iterator[tuple[float, Params]]:
        if float(params["angle"]) < 0.0:
            raise ValueError
        yield from descent(3.0)(params)

    found = race(evaluate, descend, {"angle": np.asarray(-60.0)}, BOUNDS)
    assert calls == 1 + SEARCH_DRAWS
    assert found is None or abs(float(found["angle"]) - GOAL) < 3.0


def test_a_far_stage_that_runs_out_of_steps_at_a_high_loss_is_stuck_once() -> None:
    schedule = Schedule(stages=2, steps=100, restarts=3, noise_floor=0.1)
    stuck = []
    for step in range(100):
        schedule = schedule.after(1.0 - 0.005 * step)  # falls steadily, too slowly
        if schedule.stuck:
            stuck.append(step)
            schedule = schedule.restart()
    assert stuck == [59]
    assert schedule.stage == 1


def test_a_far_stage_that_runs_out_of_steps_at_a_low_loss_is_not_stuck() -> None:
    schedule = Schedule(stages=2, steps=100, restarts=3, noise_floor=0.1)
    for step in range(100):
        schedule = schedule.after(0.97**step)
        assert not schedule.stuck
    assert schedule.stage == 1


def test_the_main_stage_begins_where_a_race_has_ended() -> None:
    schedule = Schedule(stages=3, steps=100, restarts=3, noise_floor=0.1)
    for _ in range(30):
        schedule = schedule.after(1.0)
        if schedule.stuck:
            break
    started = schedule.in_main_stage()
    assert (started.stage, started.stuck, started.restarts, started.stage_start) == (2, False, 2, schedule.step)


@pytest.mark.parametrize(("steps", "factor"), [(8, 1.0), (32, 1.0), (64, 2.0), (200, 6.25)])
def test_racers_move_at_the_highest_rate_but_for_rates_that_were_asked_for(steps: int, factor: float) -> None:
    assert racing_factors({"angle": None, "size": 0.1, "place": "1 px"}, steps) == pytest.approx(
        {"angle": factor, "size": 1.0, "place": 1.0}
    )

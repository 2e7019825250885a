"""Where a fit is stuck, several points race, and the search begins where the far stage runs out of steps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from loi_core.fitting.parameters import Bounds
from loi_core.fitting.rates import racing_factors
from loi_core.fitting.schedule import Schedule
from loi_core.fitting.starts import RACE_ROUNDS, ROUND_STEPS, Descend, RaceSize, Reached, race

BOUNDS = Bounds({"angle": np.asarray(-180.0)}, {"angle": np.asarray(180.0)})
GOAL = 100.0
SIZE = RaceSize(draws=48, racers=8)

Params = dict[str, Any]


def loss(params: Params) -> float:
    """A wide basin around the wrong angle, -60, and a narrow, deeper basin around the goal."""
    angle = float(params["angle"])
    return 1.0 - 0.7 * float(np.exp(-(((angle + 60.0) / 60.0) ** 2))) - float(np.exp(-(((angle - GOAL) / 15.0) ** 2)))


def descent(rate: float) -> Descend:
    """Return a descent by differences that yields after every four steps."""

    def descend(params: Params, /, *, fast: bool) -> Iterator[Reached]:
        angle, best = float(params["angle"]), Reached(loss(params), params)
        while True:
            for _ in range(4):
                slope = loss({"angle": angle + 0.5}) - loss({"angle": angle - 0.5})
                angle -= rate * float(np.sign(slope))
                reached = Reached(loss({"angle": angle}), {"angle": np.asarray(angle)})
                best = min(best, reached, key=lambda entry: entry.value)
            yield best

    return descend


def test_a_race_finds_the_deeper_of_two_basins_though_most_points_lead_to_the_other() -> None:
    found = race(loss, descent(3.0), {"angle": np.asarray(-60.0)}, BOUNDS, SIZE)
    assert found is not None
    assert abs(float(found.params["angle"]) - GOAL) < 3.0


def test_a_race_from_the_goal_stays_there() -> None:
    found = race(loss, descent(3.0), {"angle": np.asarray(GOAL)}, BOUNDS, SIZE)
    assert found is None or float(found.params["angle"]) == GOAL


def test_a_descent_that_nearly_reaches_zero_ends_the_race_before_any_point_is_drawn() -> None:
    values = 0

    def evaluate(params: Params) -> float:
        nonlocal values
        values += 1
        return loss(params)

    def descend(params: Params, /, *, fast: bool) -> Iterator[Reached]:
        while True:
            yield Reached(1e-6, {"angle": np.asarray(GOAL)})

    found = race(evaluate, descend, {"angle": np.asarray(0.0)}, BOUNDS, SIZE)
    assert found is not None
    assert values == 1


def test_every_other_point_of_a_race_keeps_some_of_the_parameters() -> None:
    current: Params = {"place": np.asarray([0.5, 0.5]), "turn": np.asarray(0.5), "gain": np.asarray(0.5)}
    bounds = Bounds(*({name: np.full_like(value, limit) for name, value in current.items()} for limit in (-1.0, 2.0)))
    kept = []

    def evaluate(params: Params) -> float:
        kept.append(frozenset(name for name in current if np.array_equal(params[name], current[name])))
        return 1.0

    def descend(params: Params, /, *, fast: bool) -> Iterator[Reached]:
        while True:
            yield Reached(1.0, params)

    race(evaluate, descend, current, bounds, RaceSize(12, 1))
    assert kept[0] == frozenset(current)  # the current parameters themselves
    assert set(kept[1::2]) == {frozenset()}
    assert len(set(kept[2::2])) == 6
    assert {len(names) for names in kept[2::2]} == {1, 2}


def test_half_of_the_racers_drop_out_after_each_round() -> None:
    rounds = 0

    def descend(params: Params, /, *, fast: bool) -> Iterator[Reached]:
        nonlocal rounds
        while True:
            rounds += 1
            yield Reached(loss(params) + 1.0, params)

    race(lambda params: loss(params) + 1.0, descend, {"angle": np.asarray(0.0)}, BOUNDS, SIZE)
    assert rounds == RACE_ROUNDS + SIZE.racers + SIZE.racers // 2 + SIZE.racers // 4


def test_earlier_parameters_of_the_fit_race_whatever_their_loss() -> None:
    start, earlier = {"angle": np.asarray(-60.0)}, {"angle": np.asarray(80.0)}
    found = race(loss, descent(3.0), start, BOUNDS, RaceSize(1, 0), [earlier])
    assert found is not None
    assert abs(float(found.params["angle"]) - GOAL) < 3.0


@pytest.mark.parametrize("steps", [1, 20, 80, 120, 1000, 100000])
def test_a_race_renders_at_most_1_9_times_as_often_as_a_fit_of_more_than_a_few_steps(steps: int) -> None:
    size = RaceSize.of(steps)
    rounds = 2 * RACE_ROUNDS + size.racers + size.racers // 2 + size.racers // 4
    assert 2 + size.draws + ROUND_STEPS * rounds <= min(max(1.9 * steps, 46), 210)


def test_points_and_descents_that_fail_drop_out() -> None:
    calls = 0

    def evaluate(params: Params) -> float:
        nonlocal calls
        calls += 1
        if calls > 1 and calls % 2:
            raise ValueError
        return loss(params)

    def descend(params: Params, /, *, fast: bool) -> Iterator[Reached]:
        if float(params["angle"]) < 0.0:
            raise ValueError
        yield from descent(3.0)(params, fast=fast)

    found = race(evaluate, descend, {"angle": np.asarray(-60.0)}, BOUNDS, SIZE)
    assert calls == 1 + SIZE.draws
    assert found is None or abs(float(found.params["angle"]) - GOAL) < 3.0


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
    assert (started.stage, started.stuck, started.restarts, started.stage_start) == (2, False, 0, schedule.step)


@pytest.mark.parametrize(("steps", "factor"), [(8, 1.0), (32, 1.0), (64, 2.0), (200, 6.25)])
def test_racers_move_at_the_highest_rate_but_for_rates_that_were_asked_for(steps: int, factor: float) -> None:
    assert racing_factors({"angle": None, "size": 0.1, "place": "1 px"}, steps) == pytest.approx(
        {"angle": factor, "size": 1.0, "place": 1.0}
    )

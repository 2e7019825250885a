"""What is lost in noise is held, and no signal is held for long: whatever its unit, size and direction."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core.effects import Draws, Evidence, Holding, Schedule
from loi_core.effects.holding import AGREE
from tests.helpers import Host

DRAWS = 8
units = st.floats(1e-12, 1e12)


def begun(draws: dict[str, Host], *groups: tuple[str, ...]) -> Holding:
    return Holding.begun(Draws(draws), groups or [(name,) for name in draws])


def gradients_until_free(draws: Host) -> int:
    """How many further draws a parameter is held for, after a pilot of 8; all of them if it never goes free."""
    holding = begun({"p": draws[:DRAWS]})
    for count, one in enumerate(draws[DRAWS:]):
        if not holding.groups:
            return count
        holding = holding.seen({"p": one})
    return len(draws) - DRAWS


@given(st.integers(1, 30), st.floats(0.5, 100.0), units, st.integers(0, 10**6))
def test_no_signal_is_held_for_long(size: int, signal: float, unit: float, seed: int) -> None:
    """A signal of s times the noise, in each element, goes free within (8 / s)^2 draws, and 16 where it is large.

    There the score is expected to be 6.8 or more, more than 4 of its own errors above what it has to exceed.
    """
    count = DRAWS + max(16, math.ceil((8.0 / signal) ** 2))
    rng = np.random.default_rng(seed)
    direction = rng.choice([-1.0, 1.0], size)
    draws = unit * (signal * direction + rng.standard_normal((count, size)))
    assert gradients_until_free(draws) < count - DRAWS


@given(st.integers(1, 30), units, st.integers(0, 10**6))
def test_a_gradient_without_noise_is_never_held(size: int, unit: float, seed: int) -> None:
    one = unit * np.random.default_rng(seed).standard_normal(size)
    assert not begun({"p": np.tile(one, (4, 1))}).groups


@pytest.mark.parametrize("size", [1, 3, 50])
@pytest.mark.parametrize("kind", ["normal", "heavy tails", "mostly 0", "louder and louder"])
def test_noise_agrees_no_more_often_than_the_bound_says(kind: str, size: int) -> None:
    """At any one count the chance is exp(-c^2 / 2) at most; of 500 trials, within 4 errors of that."""
    rng = np.random.default_rng(size)
    trials, count = 500, 64
    draws = rng.standard_normal((trials, count, size))
    if kind == "heavy tails":
        draws = rng.standard_t(1.5, draws.shape)
    elif kind == "mostly 0":
        draws *= rng.random((trials, count, 1)) < 0.1
    elif kind == "louder and louder":
        draws *= 1.1 ** np.arange(count)[:, None]
    scores = np.array([[Evidence.of(one[:until]).score for until in (8, count)] for one in draws])
    for limit in AGREE:
        chance = math.exp(-(limit**2) / 2.0)
        allowed = chance + 4.0 * math.sqrt(chance * (1.0 - chance) / trials)
        assert np.all(np.mean(scores > limit, axis=0) < allowed)


def test_noise_stays_held_through_a_fit_nine_times_of_ten() -> None:
    rng = np.random.default_rng(0)
    held = [gradients_until_free(rng.standard_normal((300, 3))) == 300 - DRAWS for _ in range(400)]
    assert np.mean(held) > 0.85  # 0.9 less 4 errors of a fraction of 400


@given(st.integers(2, 20), units, st.integers(0, 10**6))
def test_a_score_knows_no_unit(count: int, unit: float, seed: int) -> None:
    draws = np.random.default_rng(seed).standard_normal((count, 4))
    assert Evidence.of(unit * draws).score == pytest.approx(Evidence.of(draws).score, rel=1e-9, abs=1e-9)
    assert abs(Evidence.of(draws).score) < math.sqrt(count)


def test_an_object_is_held_only_if_nothing_of_it_is_told() -> None:
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((DRAWS, 2))
    signal = 1e-9 * (5.0 + rng.standard_normal((DRAWS, 1)))
    draws = {"turn": 1e9 * noise, "place": signal, "other": noise, "away": np.zeros((DRAWS, 3))}
    holding = begun(draws, ("turn", "place"), ("other",), ("away",))
    assert holding.groups == (("other",), ("away",))
    assert holding.reasons == {
        "other": "its gradient cannot be distinguished from noise in 8 draws",
        "away": "its gradient is exactly 0 in 8 draws",
    }
    assert begun(draws, ("turn", "place"), ("other", "away")).groups == (("other", "away"),)


def test_what_appears_goes_free_with_all_that_moves_the_same_object() -> None:
    holding = begun({"x": np.zeros((4, 1)), "z": np.zeros((4, 1)), "far": np.zeros((4, 1))}, ("x", "z"), ("far",))
    for _ in range(100):
        holding = holding.seen({name: np.zeros(()) for name in ("x", "z", "far")})
    assert holding.groups == (("x", "z"), ("far",))
    for _ in range(9):  # the least at which draws without any noise agree
        holding = holding.seen({"x": np.array(1e-9), "z": np.zeros(()), "far": np.zeros(())})
    assert holding.groups == (("far",),)
    assert list(holding.reasons) == list(holding.evidence) == ["far"]
    assert not holding.without(["far"]).groups


def test_a_look_is_due_after_twenty_gradients_then_forty_more_then_eighty() -> None:
    schedule, looks = Schedule(), []
    for count in range(1, 301):
        schedule = schedule.counted()
        if schedule.is_due:
            schedule = schedule.looked()
            looks.append(count)
    assert looks == [20, 60, 140, 300]


def test_a_loss_stalls_after_twenty_steps_then_after_forty_more() -> None:
    schedule, stalls = Schedule(), []
    for step in range(1, 121):
        schedule = schedule.watched(1.0 / step if step <= 30 else 1.0)
        if schedule.stalls:
            schedule = schedule.waited()
            stalls.append(step)
    assert stalls == [50, 90]

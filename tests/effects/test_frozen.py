"""A noisy gradient is frozen, and a signal is released soon, whatever its unit, size and direction."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core.effects import Draws, Evidence, Frozen, Schedule
from loi_core.effects.frozen import MIN_SCORES
from tests.helpers import Host

DRAWS = 8
units = st.floats(1e-12, 1e12)


def freeze(draws: dict[str, Host], *groups: tuple[str, ...]) -> Frozen:
    return Frozen.of(Draws(draws), groups or [(name,) for name in draws])


def draws_until_release(draws: Host) -> int:
    """Return the number of draws after a pilot of 8 until a parameter is released; all of them if it never is."""
    frozen = freeze({"p": draws[:DRAWS]})
    for count, draw in enumerate(draws[DRAWS:]):
        if not frozen.groups:
            return count
        frozen = frozen.updated({"p": draw})
    return len(draws) - DRAWS


@given(st.integers(1, 30), st.floats(0.5, 100.0), units, st.integers(0, 10**6))
def test_a_signal_is_released_soon(size: int, signal: float, unit: float, seed: int) -> None:
    """A signal of s times the noise, in each element, is released within (8 / s)^2 draws, or 16 if it is large.

    The expected score is then 6.8 or more, which exceeds the threshold by more than 4 of its standard errors.
    """
    count = DRAWS + max(16, math.ceil((8.0 / signal) ** 2))
    rng = np.random.default_rng(seed)
    direction = rng.choice([-1.0, 1.0], size)
    draws = unit * (signal * direction + rng.standard_normal((count, size)))
    assert draws_until_release(draws) < count - DRAWS


@given(st.integers(1, 30), units, st.integers(0, 10**6))
def test_a_gradient_without_noise_is_never_frozen(size: int, unit: float, seed: int) -> None:
    gradient = unit * np.random.default_rng(seed).standard_normal(size)
    assert not freeze({"p": np.tile(gradient, (4, 1))}).groups


@pytest.mark.parametrize("size", [1, 3, 50])
@pytest.mark.parametrize("distribution", ["normal", "heavy tails", "mostly 0", "louder and louder"])
def test_noise_agrees_at_most_as_often_as_the_bound(distribution: str, size: int) -> None:
    """For any number of draws the probability is at most exp(-c^2 / 2), within 4 errors of 500 trials."""
    rng = np.random.default_rng(size)
    trials, count = 500, 64
    draws = rng.standard_normal((trials, count, size))
    if distribution == "heavy tails":
        draws = rng.standard_t(1.5, draws.shape)
    elif distribution == "mostly 0":
        draws *= rng.random((trials, count, 1)) < 0.1
    elif distribution == "louder and louder":
        draws *= 1.1 ** np.arange(count)[:, None]
    scores = np.array([[Evidence.of(trial[:until]).score for until in (8, count)] for trial in draws])
    for limit in MIN_SCORES:
        chance = math.exp(-(limit**2) / 2.0)
        allowed = chance + 4.0 * math.sqrt(chance * (1.0 - chance) / trials)
        assert np.all(np.mean(scores > limit, axis=0) < allowed)


def test_noise_stays_frozen_in_nine_of_ten_fits() -> None:
    rng = np.random.default_rng(0)
    stays = [draws_until_release(rng.standard_normal((300, 3))) == 300 - DRAWS for _ in range(400)]
    assert np.mean(stays) > 0.85  # 0.9 less 4 errors of a fraction of 400


@given(st.integers(2, 20), units, st.integers(0, 10**6))
def test_a_score_does_not_depend_on_the_unit(count: int, unit: float, seed: int) -> None:
    draws = np.random.default_rng(seed).standard_normal((count, 4))
    assert Evidence.of(unit * draws).score == pytest.approx(Evidence.of(draws).score, rel=1e-9, abs=1e-9)
    assert abs(Evidence.of(draws).score) < math.sqrt(count)


def test_an_object_is_frozen_only_if_all_its_gradients_are_noise() -> None:
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((DRAWS, 2))
    signal = 1e-9 * (5.0 + rng.standard_normal((DRAWS, 1)))
    draws = {"turn": 1e9 * noise, "position": signal, "noisy": noise, "away": np.zeros((DRAWS, 3))}
    frozen = freeze(draws, ("turn", "position"), ("noisy",), ("away",))
    assert frozen.groups == (("noisy",), ("away",))
    assert frozen.reasons == {
        "noisy": "its gradient cannot be distinguished from noise in 8 draws",
        "away": "its gradient is exactly 0 in 8 draws",
    }
    assert freeze(draws, ("turn", "position"), ("noisy", "away")).groups == (("noisy", "away"),)


def test_a_signal_releases_all_parameters_of_its_object() -> None:
    frozen = freeze({"x": np.zeros((4, 1)), "z": np.zeros((4, 1)), "far": np.zeros((4, 1))}, ("x", "z"), ("far",))
    for _ in range(100):
        frozen = frozen.updated({name: np.zeros(()) for name in ("x", "z", "far")})
    assert frozen.groups == (("x", "z"), ("far",))
    for _ in range(9):  # the smallest number of noiseless draws that agree
        frozen = frozen.updated({"x": np.array(1e-9), "z": np.zeros(()), "far": np.zeros(())})
    assert frozen.groups == (("far",),)
    assert list(frozen.reasons) == list(frozen.evidence) == ["far"]
    assert not frozen.without(["far"]).groups


def test_probes_are_due_after_20_gradients_then_40_and_80_more() -> None:
    schedule, probes = Schedule(), []
    for count in range(1, 301):
        schedule = schedule.after_gradient()
        if schedule.is_due:
            schedule = schedule.after_probe()
            probes.append(count)
    assert probes == [20, 60, 140, 300]


def test_a_loss_is_stalled_after_20_steps_then_after_40_more() -> None:
    schedule, stalls = Schedule(), []
    for step in range(1, 121):
        schedule = schedule.after_step(1.0 / step if step <= 30 else 1.0)
        if schedule.is_stalled:
            schedule = schedule.after_stall()
            stalls.append(step)
    assert stalls == [50, 90]

"""The renderer-neutral model of effects: plans, Neyman allocation, and gradients known by noisy draws."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core.effects import Choice, Draws, Effect, EffectPlan, allocate, compare, total, whole_samples
from loi_core.errors import OptionError

positive = st.floats(1e-6, 1e6)
parts = st.lists(st.tuples(positive, positive), min_size=1, max_size=5)


def plan(**changes: object) -> EffectPlan:
    choices = tuple(Choice(effect, on=effect is Effect.PRIMARY, reason=f"because of {effect}") for effect in Effect)
    settings = {"integrator": "prb", "spp": 4} | changes
    return EffectPlan(choices, settings)


def variance(spreads: list[float], counts: list[float]) -> float:
    return math.fsum(spread / count for spread, count in zip(spreads, counts, strict=True))


@given(parts, positive, st.data())
def test_no_other_split_of_the_time_has_less_variance(
    rows: list[tuple[float, float]], budget: float, data: st.DataObject
) -> None:
    spreads, costs = [row[0] for row in rows], [row[1] for row in rows]
    best = allocate(spreads, costs, budget)
    fractions = np.array(data.draw(st.lists(st.floats(0.01, 1.0), min_size=len(rows), max_size=len(rows))))
    other = (fractions / fractions.sum() * budget / np.array(costs)).tolist()
    rounding = 16 * np.finfo(float).eps
    assert math.fsum(n * cost for n, cost in zip(best, costs, strict=True)) == pytest.approx(budget, rel=rounding)
    assert variance(spreads, best) <= variance(spreads, other) * (1.0 + rounding)


@given(parts, positive, positive, positive)
def test_a_split_of_time_knows_no_units(
    rows: list[tuple[float, float]], budget: float, unit: float, tick: float
) -> None:
    spreads, costs = [row[0] for row in rows], [row[1] for row in rows]
    changed = allocate([unit * one for one in spreads], [tick * one for one in costs], tick * budget)
    np.testing.assert_allclose(changed, allocate(spreads, costs, budget), rtol=1e-12)


def test_without_any_variance_every_part_gets_the_same_time() -> None:
    assert allocate([0.0, 0.0], [1.0, 4.0], 8.0) == [4.0, 1.0]
    assert allocate([0.0, 1.0], [1.0, 4.0], 8.0) == [0.0, 2.0]


@given(parts, positive, st.integers(0, 3), st.integers(3, 9))
def test_whole_samples_are_powers_of_two_that_fill_the_time(
    rows: list[tuple[float, float]], budget: float, low: int, high: int
) -> None:
    costs = [row[1] for row in rows]
    wanted = allocate([row[0] for row in rows], costs, budget)
    counts = whole_samples(wanted, costs, budget, least=2**low, most=2**high)
    assert all(2**low <= count <= 2**high and count.bit_count() == 1 for count in counts)
    spent = math.fsum(n * cost for n, cost in zip(counts, costs, strict=True))
    fewest = math.fsum(2**low * cost for cost in costs)
    assert spent <= budget * (1.0 + 1e-12) + fewest
    for count, one in zip(counts, wanted, strict=True):
        # Each has at least half of what it wants, unless a limit holds it back.
        assert 2 * count > min(one, 2**high)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (([-1.0], [1.0], 1.0), "`variances` must be finite numbers, 0 or more, got -1.0"),
        (([1.0], [0.0], 1.0), "`costs` must be finite numbers, more than 0, got 0.0"),
        (([1.0], [1.0], math.inf), "`budget` must be finite numbers, more than 0, got inf"),
        (([1.0], [1.0, 2.0], 1.0), "`variances` and `costs` must be as many, at least one, got 1 and 2"),
    ],
)
def test_what_cannot_be_split_is_named(arguments: tuple[list[float], list[float], float], says: str) -> None:
    with pytest.raises(OptionError, match=says):
        allocate(*arguments)


def test_a_plan_has_every_effect_once() -> None:
    whole = plan()
    assert whole.on == {Effect.PRIMARY}
    assert whole[Effect.MEDIA].reason == "because of participating media"
    with pytest.raises(OptionError, match="each effect once, in order"):
        EffectPlan(whole.choices[1:])
    with pytest.raises(OptionError, match="`reason` of camera motion must be one line"):
        Choice(Effect.CAMERA, on=True, reason="two\nlines")


def test_a_plan_prints_as_a_table_with_a_reason_for_every_effect() -> None:
    lines = str(plan()).splitlines()
    assert len({len(line) for line in lines[: len(Effect) + 2]}) == 1
    for effect, line in zip(Effect, lines[2:], strict=False):
        assert line.startswith(f"| {effect} ")
        assert f"because of {effect}" in line
    assert lines[-1] == "Settings: integrator prb, spp 4"
    told = dataclasses.replace(plan(), why={"spp": "it is enough"}, notes=("and more",))
    assert str(told).splitlines()[-2:] == ["- spp 4: it is enough", "Note: and more"]


def test_a_change_of_plan_is_one_line_and_no_change_is_none() -> None:
    assert plan().changes_from(plan()) == ""
    other = EffectPlan(
        tuple(Choice(effect, on=False, reason="off") for effect in Effect), {"integrator": "path", "spp": 4}
    )
    assert other.changes_from(plan()) == "primary visibility off (off); integrator prb -> path"


def test_what_is_held_has_a_row_and_its_changes_are_told() -> None:
    frozen_plan = dataclasses.replace(plan(), frozen={"far": "it cannot be seen"})
    lines = str(frozen_plan).splitlines()
    row = lines[2 + len(Effect)]
    assert [cell.strip() for cell in row.strip("|").split("|")] == ["'far'", "frozen", "", "", "it cannot be seen"]
    assert len({len(line) for line in lines[: len(Effect) + 3]}) == 1
    assert frozen_plan.changes_from(plan()) == "'far' frozen (it cannot be seen)"
    assert plan().changes_from(frozen_plan) == "'far' released"
    assert frozen_plan.changes_from(frozen_plan) == ""


def test_a_part_that_is_never_there_takes_no_draws_from_the_others() -> None:
    long, short = noisy([1.0, 2.0], 0.1, 8, 0), Draws({"p": np.zeros((4, 2))})
    np.testing.assert_array_equal(total([long, short]).gradients["p"], long.gradients["p"])
    assert total([short, short]).count == 4


def noisy(mean: list[float], noise: float, count: int, seed: int) -> Draws:
    rng = np.random.default_rng(seed)
    return Draws.of([{"p": np.array(mean) + noise * rng.standard_normal(len(mean))} for _ in range(count)])


def test_cosine_and_ratio_are_without_bias_by_noise() -> None:
    """Noise as large as the gradient: by the plain means the cosine would be near 0.9, and the norms too large."""
    mean = [1.0, 2.0, -2.0, 0.5] * 10
    cosines, ratios, pulls = [], [], []
    for seed in range(60):
        found = compare(noisy(mean, 1.5, 12, 2 * seed), noisy(mean, 1.5, 12, 2 * seed + 1))
        cosines.append(found.cosine)
        ratios.append(found.ratio)
        pulls.append((found.ratio - 1.0) / found.ratio_error)
    # The mean of 60 is within 4 of its own standard errors; the seeds are fixed.
    for values in (cosines, ratios):
        assert abs(np.mean(values) - 1.0) < 4.0 * np.std(values) / math.sqrt(60)
    assert 0.5 < np.std(pulls) < 2.0  # so the error that is told is that which is made


def test_a_gradient_that_turns_or_shrinks_is_seen() -> None:
    found = compare(noisy([0.5, 0.5], 0.01, 8, 0), noisy([1.0, 0.0], 0.01, 8, 1))
    assert found.cosine == pytest.approx(math.sqrt(0.5), abs=5 * found.cosine_error)
    assert found.ratio == pytest.approx(math.sqrt(0.5), abs=5 * found.ratio_error)
    assert found.noise == pytest.approx(0.01 * math.sqrt(2) / math.sqrt(0.5), rel=0.5)


def test_parameters_of_other_units_count_alike() -> None:
    rng = np.random.default_rng(0)
    wanted = Draws.of([{"small": 1e-6 + 1e-9 * rng.random(1), "large": 1e6 + rng.random(1)} for _ in range(5)])
    turned = Draws({"small": -wanted.gradients["small"], "large": wanted.gradients["large"]})
    assert compare(turned, wanted).cosine == pytest.approx(0.0, abs=1e-2)


def test_what_cannot_be_told_from_noise_is_left_out_by_name() -> None:
    rng = np.random.default_rng(1)
    draws = Draws.of([{"heard": 1.0 + 0.1 * rng.random(2), "noise": rng.standard_normal(50)} for _ in range(6)])
    found = compare(draws, draws)
    assert found.silent == ("noise",)
    assert math.isnan(
        compare(Draws({"noise": draws.gradients["noise"]}), Draws({"noise": draws.gradients["noise"]})).cosine
    )


def test_draws_add_group_and_cancel() -> None:
    one, other = noisy([1.0, 2.0], 0.1, 4, 0), noisy([3.0, 4.0], 0.1, 6, 1)
    assert total([one, other]).count == 4
    assert total([one, other]).norm("p") == pytest.approx(math.hypot(4.0, 6.0), rel=0.1)
    assert one.less(one).zero("p")
    assert one.and_more(other).count == 10
    both = Draws({"x": one.gradients["p"], "z": other.gradients["p"][:4]}).grouped([("x", "z")])
    assert both.gradients["x, z"].shape == (4, 4)
    with pytest.raises(OptionError, match="the same 2 or more draws"):
        noisy([1.0], 0.1, 1, 0)


@pytest.mark.parametrize("count", [5, 6])
def test_many_that_are_held_for_one_reason_share_a_row(count: int) -> None:
    far = {f"far {k}": "it cannot be seen" for k in range(count)}
    frozen_plan = dataclasses.replace(plan(), frozen={**far, "noisy": "it is noise"})
    rows = [line for line in str(frozen_plan).splitlines() if " frozen " in line]
    changes = frozen_plan.changes_from(plan()).split("; ")
    released = plan().changes_from(frozen_plan).split("; ")
    if count == 5:
        assert len(rows) == len(changes) == 6
    else:
        names = "'far 0', 'far 1', 'far 2', 'far 3' and 2 others"
        assert [row.split("|")[1].strip() for row in rows] == [names, "'noisy'"]
        assert changes == [f"{names} frozen (it cannot be seen)", "'noisy' frozen (it is noise)"]
    assert released == [f"'far 0', 'far 1', 'far 2', 'far 3' and {count - 3} others released"]
    assert len(frozen_plan.frozen) == count + 1  # where every name is

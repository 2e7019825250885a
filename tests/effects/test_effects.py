"""The renderer-neutral model of effects: plans, Neyman allocation, and gradients known from noisy draws."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core.effects import Choice, Draws, Effect, EffectPlan, allocate, compare, power_of_two_samples, total
from loi_core.errors import OptionError

positive = st.floats(1e-6, 1e6)
terms = st.lists(st.tuples(positive, positive), min_size=1, max_size=5)


def plan(**changes: object) -> EffectPlan:
    choices = tuple(Choice(effect, on=effect is Effect.PRIMARY, reason=f"because of {effect}") for effect in Effect)
    settings = {"integrator": "prb", "spp": 4} | changes
    return EffectPlan(choices, settings)


def variance(variances: list[float], counts: list[float]) -> float:
    return math.fsum(value / count for value, count in zip(variances, counts, strict=True))


@given(terms, positive, st.data())
def test_the_allocation_has_the_least_variance_for_the_time(
    rows: list[tuple[float, float]], budget: float, data: st.DataObject
) -> None:
    variances, costs = [row[0] for row in rows], [row[1] for row in rows]
    best = allocate(variances, costs, budget)
    fractions = np.array(data.draw(st.lists(st.floats(0.01, 1.0), min_size=len(rows), max_size=len(rows))))
    random_split = (fractions / fractions.sum() * budget / np.array(costs)).tolist()
    rounding = 16 * np.finfo(float).eps
    assert math.fsum(n * cost for n, cost in zip(best, costs, strict=True)) == pytest.approx(budget, rel=rounding)
    assert variance(variances, best) <= variance(variances, random_split) * (1.0 + rounding)


@given(terms, positive, positive, positive)
def test_the_allocation_does_not_depend_on_units(
    rows: list[tuple[float, float]], budget: float, unit: float, tick: float
) -> None:
    variances, costs = [row[0] for row in rows], [row[1] for row in rows]
    changed = allocate([unit * value for value in variances], [tick * cost for cost in costs], tick * budget)
    np.testing.assert_allclose(changed, allocate(variances, costs, budget), rtol=1e-12)


def test_without_any_variance_every_term_gets_the_same_time() -> None:
    assert allocate([0.0, 0.0], [1.0, 4.0], 8.0) == [4.0, 1.0]
    assert allocate([0.0, 1.0], [1.0, 4.0], 8.0) == [0.0, 2.0]


@given(terms, positive, st.integers(0, 3), st.integers(3, 9))
def test_rounded_samples_are_powers_of_two_that_fill_the_time(
    rows: list[tuple[float, float]], budget: float, min_log2: int, max_log2: int
) -> None:
    costs = [row[1] for row in rows]
    samples = allocate([row[0] for row in rows], costs, budget)
    counts = power_of_two_samples(samples, costs, budget, minimum=2**min_log2, maximum=2**max_log2)
    assert all(2**min_log2 <= count <= 2**max_log2 and count.bit_count() == 1 for count in counts)
    spent = math.fsum(n * cost for n, cost in zip(counts, costs, strict=True))
    fewest = math.fsum(2**min_log2 * cost for cost in costs)
    assert spent <= budget * (1.0 + 1e-12) + fewest
    for count, number in zip(counts, samples, strict=True):
        # Each count is at least half of the allocated number, unless the maximum limits it.
        assert 2 * count > min(number, 2**max_log2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([-1.0], [1.0], 1.0), "`variances` must be finite numbers, 0 or more, got -1.0"),
        (([1.0], [0.0], 1.0), "`costs` must be finite numbers, more than 0, got 0.0"),
        (([1.0], [1.0], math.inf), "`budget` must be finite numbers, more than 0, got inf"),
        (([1.0], [1.0, 2.0], 1.0), "`variances` and `costs` must have the same length, at least 1, got 1 and 2"),
    ],
)
def test_wrong_arguments_of_an_allocation_are_refused(
    arguments: tuple[list[float], list[float], float], message: str
) -> None:
    with pytest.raises(OptionError, match=message):
        allocate(*arguments)


def test_a_plan_has_every_effect_once() -> None:
    full_plan = plan()
    assert full_plan.on == {Effect.PRIMARY}
    assert full_plan[Effect.MEDIA].reason == "because of participating media"
    with pytest.raises(OptionError, match="each effect once, in order"):
        EffectPlan(full_plan.choices[1:])
    with pytest.raises(OptionError, match="`reason` of camera motion must be one line"):
        Choice(Effect.CAMERA, on=True, reason="two\nlines")


def test_a_plan_prints_as_a_table_with_a_reason_for_every_effect() -> None:
    lines = str(plan()).splitlines()
    assert len({len(line) for line in lines[: len(Effect) + 2]}) == 1
    for effect, line in zip(Effect, lines[2:], strict=False):
        assert line.startswith(f"| {effect} ")
        assert f"because of {effect}" in line
    assert lines[-1] == "Settings: integrator prb, spp 4"
    annotated = dataclasses.replace(plan(), why={"spp": "it is enough"}, notes=("and more",))
    assert str(annotated).splitlines()[-2:] == ["- spp 4: it is enough", "Note: and more"]


def test_changes_of_a_plan_are_one_line_and_empty_for_equal_plans() -> None:
    assert plan().changes_from(plan()) == ""
    changed = EffectPlan(
        tuple(Choice(effect, on=False, reason="off") for effect in Effect), {"integrator": "path", "spp": 4}
    )
    assert changed.changes_from(plan()) == "primary visibility off (off); integrator prb -> path"


def test_a_frozen_parameter_has_a_row_and_appears_in_the_changes() -> None:
    frozen_plan = dataclasses.replace(plan(), frozen={"far": "it cannot be seen"})
    lines = str(frozen_plan).splitlines()
    row = lines[2 + len(Effect)]
    assert [cell.strip() for cell in row.strip("|").split("|")] == ["'far'", "frozen", "", "", "it cannot be seen"]
    assert len({len(line) for line in lines[: len(Effect) + 3]}) == 1
    assert frozen_plan.changes_from(plan()) == "'far' frozen (it cannot be seen)"
    assert plan().changes_from(frozen_plan) == "'far' released"
    assert frozen_plan.changes_from(frozen_plan) == ""


def test_a_term_that_is_always_zero_does_not_reduce_the_number_of_draws() -> None:
    long, short = noisy([1.0, 2.0], 0.1, 8, 0), Draws({"p": np.zeros((4, 2))})
    np.testing.assert_array_equal(total([long, short]).gradients["p"], long.gradients["p"])
    assert total([short, short]).count == 4


def noisy(mean: list[float], noise: float, count: int, seed: int) -> Draws:
    rng = np.random.default_rng(seed)
    return Draws.of([{"p": np.array(mean) + noise * rng.standard_normal(len(mean))} for _ in range(count)])


def test_noise_does_not_bias_cosine_and_ratio() -> None:
    """With noise as large as the gradient, the plain means would give a cosine near 0.9 and too large norms."""
    mean = [1.0, 2.0, -2.0, 0.5] * 10
    cosines, ratios, scores = [], [], []
    for seed in range(60):
        result = compare(noisy(mean, 1.5, 12, 2 * seed), noisy(mean, 1.5, 12, 2 * seed + 1))
        cosines.append(result.cosine)
        ratios.append(result.ratio)
        scores.append((result.ratio - 1.0) / result.ratio_error)
    # The mean of 60 values is within 4 standard errors; the seeds are fixed.
    for values in (cosines, ratios):
        assert abs(np.mean(values) - 1.0) < 4.0 * np.std(values) / math.sqrt(60)
    assert 0.5 < np.std(scores) < 2.0  # the reported error is the actual error


def test_a_comparison_detects_rotation_and_scaling() -> None:
    result = compare(noisy([0.5, 0.5], 0.01, 8, 0), noisy([1.0, 0.0], 0.01, 8, 1))
    assert result.cosine == pytest.approx(math.sqrt(0.5), abs=5 * result.cosine_error)
    assert result.ratio == pytest.approx(math.sqrt(0.5), abs=5 * result.ratio_error)
    assert result.noise == pytest.approx(0.01 * math.sqrt(2) / math.sqrt(0.5), rel=0.5)


def test_parameters_of_different_units_have_equal_weight() -> None:
    rng = np.random.default_rng(0)
    reference = Draws.of([{"small": 1e-6 + 1e-9 * rng.random(1), "large": 1e6 + rng.random(1)} for _ in range(5)])
    flipped = Draws({"small": -reference.gradients["small"], "large": reference.gradients["large"]})
    assert compare(flipped, reference).cosine == pytest.approx(0.0, abs=1e-2)


def test_insignificant_parameters_are_left_out_of_a_comparison() -> None:
    rng = np.random.default_rng(1)
    draws = Draws.of([{"signal": 1.0 + 0.1 * rng.random(2), "noise": rng.standard_normal(50)} for _ in range(6)])
    result = compare(draws, draws)
    assert result.insignificant == ("noise",)
    assert math.isnan(
        compare(Draws({"noise": draws.gradients["noise"]}), Draws({"noise": draws.gradients["noise"]})).cosine
    )


def test_draws_can_be_summed_grouped_and_subtracted() -> None:
    first, second = noisy([1.0, 2.0], 0.1, 4, 0), noisy([3.0, 4.0], 0.1, 6, 1)
    assert total([first, second]).count == 4
    assert total([first, second]).norm("p") == pytest.approx(math.hypot(4.0, 6.0), rel=0.1)
    assert first.minus(first).is_zero("p")
    assert first.extended(second).count == 10
    grouped = Draws({"x": first.gradients["p"], "z": second.gradients["p"][:4]}).grouped([("x", "z")])
    assert grouped.gradients["x, z"].shape == (4, 4)
    with pytest.raises(OptionError, match="the same 2 or more draws"):
        noisy([1.0], 0.1, 1, 0)


@pytest.mark.parametrize("count", [5, 6])
def test_many_frozen_parameters_with_one_reason_share_a_row(count: int) -> None:
    hidden = {f"far {k}": "it cannot be seen" for k in range(count)}
    frozen_plan = dataclasses.replace(plan(), frozen={**hidden, "noisy": "it is noise"})
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
    assert len(frozen_plan.frozen) == count + 1  # with every name

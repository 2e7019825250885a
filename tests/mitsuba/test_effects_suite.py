"""The table of twelve scenes can be measured, and plans have the gradient of all effects (thorough tier)."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import pytest

from examples.effects.__main__ import HEADS, cells
from examples.effects.measure import FULL, Effort, measure, revisions_in_a_stall
from examples.effects.scenes import SUITE, Case
from tests.strategies import thorough


def test_a_row_of_the_table_is_measured() -> None:
    (case,) = [case for case in SUITE if case.name == "emitter colour"]
    row = measure(case, Effort(24, 18, samples=4, draws=4, steps=3, fits=2, defaults=0))
    line = cells(row)
    assert len(line) == len(HEADS)
    assert line[0] == "emitter colour"
    assert line[1].startswith("shading 4; depth ")
    assert row.gradient.cosine == pytest.approx(1.0, abs=0.01)
    assert len(row.errors) == len(row.full_errors) == 2
    assert max(row.errors + row.full_errors) < 1.0  # the fits have reduced the error
    assert min(row.seconds, row.full_seconds, row.manual_seconds, row.pilot_seconds, row.revision_seconds) > 0.0


def test_a_plan_is_revisited_ever_more_rarely() -> None:
    revisions = [revisions_in_a_stall(10 * 2**doubling) for doubling in range(12)]
    assert revisions[0] == 0
    assert all(later - earlier in (0, 1) for earlier, later in pairwise(revisions))


@thorough
@pytest.mark.parametrize("case", SUITE, ids=[case.name for case in SUITE])
def test_no_plan_rotates_the_gradient(case: Case) -> None:
    # Noise in the image makes the gradient smaller (docs/results/noise.md); with all effects on, the shadow has more.
    samples = 4 * FULL.samples if case.name == "shadow of an object out of view" else FULL.samples
    row = measure(case, dataclasses.replace(FULL, defaults=0, fits=0, samples=samples))
    if case.name == "nothing that can be seen":
        assert list(row.plan.frozen) == ["place"]
        return
    assert not row.plan.frozen
    assert row.gradient.cosine > 0.99 - 2.0 * row.gradient.cosine_error
    assert row.gradient.ratio == pytest.approx(1.0, abs=0.1 + 3.0 * row.gradient.ratio_error)

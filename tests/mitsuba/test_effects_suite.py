"""The table of twelve scenes: it can be made, and in the thorough tier its plans have the gradient of everything on."""

from __future__ import annotations

import dataclasses
import os

import pytest

from examples.effects.__main__ import HEADS, cells
from examples.effects.measure import FULL, Effort, measure
from examples.effects.scenes import SUITE, Case

THOROUGH = os.environ.get("HYPOTHESIS_PROFILE") == "thorough"


def test_a_line_of_the_table_is_measured() -> None:
    (case,) = [case for case in SUITE if case.name == "emitter colour"]
    row = measure(case, Effort(24, 18, samples=4, draws=4, steps=3, defaults=0))
    line = cells(row)
    assert len(line) == len(HEADS)
    assert line[0] == "emitter colour"
    assert line[1].startswith("shading 4; depth ")
    assert row.gradient.cosine == pytest.approx(1.0, abs=0.01)
    assert row.error < 1.0  # the fit has come nearer
    assert min(row.seconds, row.full_seconds, row.hand_seconds, row.pilot_seconds) > 0.0


@pytest.mark.skipif(not THOROUGH, reason="minutes a scene; in the thorough tier")
@pytest.mark.parametrize("case", SUITE, ids=[case.name for case in SUITE])
def test_no_plan_turns_the_gradient(case: Case) -> None:
    row = measure(case, dataclasses.replace(FULL, defaults=0, steps=2))
    if case.name == "nothing that can be seen":
        assert any("told from noise" in note or "exactly 0" in note for note in row.plan.notes)
        return
    assert row.gradient.cosine > 0.99 - 2.0 * row.gradient.cosine_error
    assert row.gradient.ratio == pytest.approx(1.0, abs=0.1 + 3.0 * row.gradient.ratio_error)

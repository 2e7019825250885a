"""The history of a fit survives a checkpoint, and a schedule keeps a bounded number of values."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import FarToNear
from loi_core.fitting.history import FitStep, rows_of, steps_of
from loi_core.fitting.progress import StepBar
from tests.fitting.fits import run


def fit_step(step: int, size: int) -> FitStep:
    params = {"points": np.arange(size, dtype=np.float64).reshape(-1, 1) + step, "angle": np.asarray(0.5 * step)}
    return FitStep(step, 1.0 / (step + 1), 0.1 * step, 1.0, 1e-3, step % 3, params if size else {})


@given(st.integers(0, 20), st.integers(0, 3))
def test_steps_are_restored_from_their_rows(count: int, size: int) -> None:
    history = [fit_step(step, size) for step in range(count)]
    shapes = {"points": (size, 1), "angle": ()} if size and count else {}
    restored = steps_of(rows_of(history), shapes)
    assert len(restored) == count
    for expected, actual in zip(history, restored, strict=True):
        np.testing.assert_equal(
            {name: getattr(actual, name) for name in FitStep.__slots__},
            {name: getattr(expected, name) for name in FitStep.__slots__},
        )


@pytest.mark.parametrize("done", [0, 1])
def test_a_bar_shows_the_steps_the_stage_and_the_objective(done: int, capsys: pytest.CaptureFixture[str]) -> None:
    with StepBar(3, done, stages=3, is_shown=True) as bar:
        for step in range(done, 3):
            bar.show(fit_step(step, 0))
    written = capsys.readouterr().err
    assert f"| {done}/3" in written
    assert "| 3/3" in written
    assert "stage 3 of 3, objective 0.333" in written
    with StepBar(3, 0, stages=1, is_shown=False) as bar:
        bar.show(fit_step(0, 0))
    assert capsys.readouterr().err == ""


def test_a_fit_shows_its_progress_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    quiet = run(steps=3)
    assert capsys.readouterr().err == ""
    assert run(steps=3, progress=True).best_value == quiet.best_value
    assert "3/3" in capsys.readouterr().err


def test_rows_of_other_parameters_are_refused() -> None:
    with pytest.raises(ValueError, match=r"its history has shape \(2, 6\)"):
        steps_of(np.zeros((2, 6)), {"angle": ()})


def test_a_long_schedule_looks_back_at_a_bounded_number_of_values() -> None:
    schedule = FarToNear(stages=2, steps=10**6)
    for step in range(4000):
        schedule.step(1.0 / (1.0 + step))
    assert schedule.stage == 0
    assert len(schedule._schedule.values) <= 2 * 512

"""The history of a fit survives a checkpoint, and a schedule keeps a bounded number of values."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import FarToNear
from loi_core.fitting.history import FitStep, rows_of, steps_of


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


def test_rows_of_other_parameters_are_refused() -> None:
    with pytest.raises(ValueError, match=r"its history has shape \(2, 6\)"):
        steps_of(np.zeros((2, 6)), {"angle": ()})


def test_a_long_schedule_looks_back_at_a_bounded_number_of_values() -> None:
    schedule = FarToNear(stages=2, steps=10**6)
    for step in range(4000):
        schedule.step(1.0 / (1.0 + step))
    assert schedule.stage == 0
    assert len(schedule._schedule.values) <= 2 * 512

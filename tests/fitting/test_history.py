"""The history of a fit is what its steps were, however many, and takes no more memory for a million than for a few."""

from __future__ import annotations

import copy
import pickle
import tempfile
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import FarToNear
from loi_core.fitting import history as module
from loi_core.fitting.history import FitStep, History, StepLog


def entry(step: int, size: int = 2) -> FitStep:
    params = {"place": np.arange(size, dtype=np.float64).reshape(-1, 1) + step, "one": np.asarray(0.5 * step)}
    return FitStep(step, 1.0 / (step + 1), 0.1 * step, 1.0, 1e-3, step % 3, params if size else {})


def same(one: FitStep, other: FitStep) -> bool:
    plain = ("step", "value", "gradient_norm", "rate", "seconds", "stage")
    return all(getattr(one, name) == getattr(other, name) for name in plain) and (
        one.params.keys() == other.params.keys()
        and all(np.array_equal(value, other.params[name]) for name, value in one.params.items())
    )


def nowhere(*_: object, **__: object) -> Any:
    raise OSError(28, "No space left on device")


@given(st.integers(0, 60), st.integers(0, 3), st.integers(1, 40), st.booleans())
def test_steps_are_read_as_they_were_written(count: int, size: int, room: int, full: bool) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MOST_BYTES", room * 100)
        if full:
            patch.setattr(tempfile, "TemporaryFile", nowhere)
        log = StepLog()
        for step in range(count):
            log.put(step, entry(step, size))
        seen = History(log, count)
        assert len(seen) == count
        assert all(same(one, entry(step, size)) for step, one in enumerate(seen))
        assert all(same(seen[step], entry(step, size)) for step in range(count))
        assert [one.step for one in seen[3:17:2]] == list(range(count))[3:17:2]
        for other in (pickle.loads(pickle.dumps(seen)), copy.deepcopy(seen), copy.copy(seen)):  # noqa: S301  # our own
            assert all(same(one, two) for one, two in zip(seen, other, strict=True))
        if count > 2:
            log.put(2, entry(90, size))
            assert [one.step for one in History(log, 3)] == [0, 1, 90]


def test_a_long_history_takes_no_memory_beyond_a_bound() -> None:
    log = StepLog()
    steps = 3 * module.MOST_BYTES // 72
    for step in range(steps):
        log.put(step, entry(step))
    assert log._near.nbytes <= module.MOST_BYTES
    assert not log._far
    assert same(History(log, steps)[-1], entry(steps - 1))


def test_a_step_of_a_long_schedule_looks_at_no_more_values_than_a_bound() -> None:
    schedule = FarToNear(stages=2, steps=10**6)
    for step in range(4000):
        schedule.step(1.0 / (1.0 + step))
    assert schedule.stage == 0
    assert len(schedule._values) <= 2 * 512

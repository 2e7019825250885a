"""Memory stays as it is, however long a run; ``HYPOTHESIS_PROFILE=thorough`` makes long ones of them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.soak import Soak
from tests.strategies import THOROUGH

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux tells how much memory a process has")


def soak(what: str, count: int, folder: Path, *more: str) -> Soak:
    """A run in a process of its own, in which nothing else is warm."""
    file = folder / f"{what}.json"
    command = [sys.executable, "-m", "benchmarks.soak", what, "--count", str(count), "--json", str(file), *more]
    subprocess.run(command, check=True, capture_output=True)
    return Soak(**json.loads(file.read_text()))


def test_a_fit_takes_no_more_memory_the_longer_it_gets(tmp_path: Path) -> None:
    found = soak("steps", 20_000 if THOROUGH else 1_000, tmp_path)
    assert found.growth <= 1.0
    if THOROUGH:
        assert found.slowing <= 1.5


@pytest.mark.skipif(not THOROUGH, reason="most of a minute; in the thorough tier")
def test_objectives_that_are_dropped_leave_nothing(tmp_path: Path) -> None:
    for library in ("torch", "jax"):
        pytest.importorskip(library)
    assert soak("objectives", 3_000, tmp_path, "--kinds", "4").growth <= 1.0


@pytest.mark.skipif(not THOROUGH, reason="a minute; in the thorough tier")
def test_a_loop_in_mitsuba_takes_no_more_memory_the_longer_it_gets(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    assert soak("mitsuba", 1_000, tmp_path).growth <= 1.0


def test_growth_and_slowing_are_seen() -> None:
    steps = list(range(1, 201))
    leaking = Soak("what leaks", 200, steps, [100.0 + 0.02 * step for step in steps], [1e-3 * step for step in steps])
    assert leaking.growth > 3.0
    assert leaking.slowing > 5.0
    steady = Soak("what does not", 200, steps, list(100.0 + np.minimum(steps, 20)), [1e-3] * 200)
    assert steady.growth == 0.0
    assert steady.slowing == 1.0

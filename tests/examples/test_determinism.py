"""Tests of determinism: equal bits in every process with as many threads, and rounding errors with more threads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from examples.determinism import BACKENDS, Results, computed, difference_in_eps
from tests.objectives.test_properties import ROUNDINGS

# JAX takes half a minute to compile, in each of the two processes.
QUICK = [name for name in BACKENDS if name != "JAX"]


def backends() -> list[str]:
    thorough = settings.default is not None and settings.default.max_examples > 100
    return list(BACKENDS) if thorough else QUICK


def different(first: Results, second: Results) -> dict[str, float]:
    assert first.keys() == second.keys()
    differences = {name: difference_in_eps(value, second[name]) for name, value in first.items()}
    return {name: distance for name, distance in differences.items() if distance > 0.0}


@pytest.mark.parametrize("backend", backends())
def test_the_same_seed_gives_the_same_bits_in_another_process(backend: str, tmp_path: Path) -> None:
    first = computed(backend, tmp_path)
    assert all(np.any(value) for value in first.values())
    assert different(first, computed(backend, tmp_path, PYTHONHASHSEED="12345")) == {}


def test_the_number_of_threads_changes_results_of_the_core_by_rounding_at_most(tmp_path: Path) -> None:
    changed = different(computed("NumPy", tmp_path), computed("NumPy", tmp_path, THREADS="4"))
    assert max(changed.values(), default=0.0) <= ROUNDINGS


def test_difference_in_eps_is_0_only_for_equal_bits() -> None:
    assert difference_in_eps(np.zeros(2), np.array([0.0, -0.0])) > 0.0
    assert difference_in_eps(np.ones(2), np.array([1.0, 1.0 + 2**-52])) == pytest.approx(1.0)
    assert difference_in_eps(np.array([np.nan, 1.0]), np.array([np.nan, 1.0])) == 0.0

"""A killed fit of a Mitsuba scene can be resumed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mitsuba.test_scene_file import folder
from tests.survival.processes import fit_killed_and_whole

__all__ = ["folder"]


@pytest.fixture
def one_core() -> Iterator[None]:
    """Keep this process and its children to one core.

    Dr.Jit accumulates gradients in the order of its threads. With 8 samples per pixel the rounding errors grow: two
    uninterrupted fits may end a quarter of a pixel apart. On one core they are equal.
    """
    if not hasattr(os, "sched_setaffinity"):
        pytest.skip("this system cannot restrict a process to one core")
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    yield
    os.sched_setaffinity(0, cores)


@pytest.mark.usefixtures("one_core")
def test_a_killed_and_resumed_fit_of_a_mitsuba_scene_equals_an_uninterrupted_one(folder: Path) -> None:
    resumed, uninterrupted = fit_killed_and_whole(folder / "scene.toml", "place")
    assert resumed == uninterrupted

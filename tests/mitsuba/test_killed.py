"""A fit of a Mitsuba scene that was killed, and resumed."""

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

    Dr.Jit adds gradients up in the order in which its threads come. With 8 samples a pixel those roundings grow: of
    two fits that nothing has cut short, one may end a quarter of a pixel from the other. On one core they are equal.
    """
    if not hasattr(os, "sched_setaffinity"):
        pytest.skip("this system does not keep a process to one core")
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    yield
    os.sched_setaffinity(0, cores)


@pytest.mark.usefixtures("one_core")
def test_a_fit_of_a_mitsuba_scene_that_was_killed_ends_where_a_whole_one_does(folder: Path) -> None:
    broken, whole = fit_killed_and_whole(folder / "scene.toml", "place")
    assert broken == whole

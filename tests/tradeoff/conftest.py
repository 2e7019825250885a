"""Which plugins there are, and two images on disk."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from loi_core.plugins import registry
from tests.frameworks import load
from tests.helpers import images
from tests.tradeoff.command import NUMPY, Plugins


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> Plugins:
    """Makes these entry points the only ones."""

    def announce(*points: EntryPoint) -> None:
        monkeypatch.setattr(registry, "entry_points", lambda group: [one for one in points if one.group == group])

    announce(NUMPY)
    return announce


@pytest.fixture
def by_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves Numba out, which each row, in a process of its own, would import for longer than it measures."""
    monkeypatch.setenv("LOI_COMPILED", "0")


@pytest.fixture
def pair(tmp_path: Path) -> list[str]:
    first, second = images((12, 10, 3), 0)
    np.save(tmp_path / "a.npy", first)
    np.save(tmp_path / "b.npy", second)
    return ["--image", str(tmp_path / "a.npy"), "--reference", str(tmp_path / "b.npy")]


for framework in ("jax", "torch"):
    load(framework)

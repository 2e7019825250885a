"""Announced plugins, and two images on disk."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from loi_core.plugins import registry
from loi_core.tradeoff import rows, run
from tests.frameworks import load
from tests.helpers import images
from tests.tradeoff.command import NUMPY, Plugins


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> Plugins:
    """Return a function that announces entry points and hides all others."""

    def announce(*points: EntryPoint) -> None:
        monkeypatch.setattr(registry, "entry_points", lambda group: [point for point in points if point.group == group])

    announce(NUMPY)
    return announce


@pytest.fixture
def without_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare without Numba, whose import in the process of each row takes longer than the measurement."""
    monkeypatch.setenv("LOI_COMPILED", "0")


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch, without_numba: None) -> None:
    """Measure every row in this process, without Numba: to start a process takes longer than to measure."""

    def measure_setting(*arguments: Any) -> Any:
        sender = Mock()
        rows._work(sender, *arguments)
        return sender.send.call_args.args[0]

    monkeypatch.setattr(run, "measure_setting", measure_setting)


@pytest.fixture
def pair(tmp_path: Path) -> list[str]:
    first, second = images((12, 10, 3), 0)
    np.save(tmp_path / "a.npy", first)
    np.save(tmp_path / "b.npy", second)
    return ["--image", str(tmp_path / "a.npy"), "--reference", str(tmp_path / "b.npy")]


for framework in ("jax", "torch"):
    load(framework)

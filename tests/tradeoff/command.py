"""The command ``loi tradeoff`` in a test, and an announced backend."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from loi_core.cli import main
from loi_core.plugins import registry

Plugins = Callable[..., None]

NUMPY = EntryPoint("numpy", "loi_core.plugins.measurement_backends:NumPy", registry.BACKENDS.name)


def tradeoff(output: Path, capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> dict[str, Any]:
    assert main(["tradeoff", "--seconds", "1e-3", "--output", str(output), "--json", *arguments]) == code
    return dict(json.loads(capsys.readouterr().out))

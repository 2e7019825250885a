"""A finished sweep, and array code instead of loops that need compilation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from loi_core.sweeps import sweep
from tests.helpers import without_numba
from tests.sweeps.scenes import lay_out


@pytest.fixture(autouse=True)
def _arrays() -> Iterator[None]:
    with without_numba():
        yield


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the path of a sweep file whose runs were executed by two processes."""
    path = lay_out(tmp_path_factory.mktemp("sweep"))
    with without_numba():
        result = sweep(path, processes=2)
    assert result.count("done") == 8
    return path

"""Settings for all tests."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from filelock import FileLock
from hypothesis import HealthCheck, settings

from tests.browser import chromium
from tests.environments import build_wheel, fresh_python

if TYPE_CHECKING:
    from playwright.sync_api import Browser

os.environ["MPLBACKEND"] = "agg"  # Matplotlib opens no window

collect_ignore = ["typing/wrong_uses.py"]  # for type checkers, never run

if os.environ.get("HYPOTHESIS_PROFILE") != "thorough":
    # Compiling takes most of the time of JAX's tests: this saves a quarter of it.
    os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")

if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # The compilation cache of JAX is shared by all workers and by programs that tests start, until this run ends.
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="loi-jax-")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
    _OWNER = os.getpid()

    @atexit.register
    def _remove_jax_cache() -> None:
        if os.getpid() == _OWNER:  # not a forked child
            shutil.rmtree(os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)


for name, examples in (("quick", 10), ("ci", 25), ("thorough", 1000)):
    settings.register_profile(
        name,
        max_examples=examples,
        deadline=None,
        derandomize=name == "ci",
        suppress_health_check=[HealthCheck.too_slow],
    )
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


def built_once(tmp_path_factory: pytest.TempPathFactory, name: str, build: Callable[[Path], Path]) -> Path:
    """Return the path that `build` makes in a folder; the workers of a run share the result of the first."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    result = folder / f"{name}.txt"
    with FileLock(result.with_suffix(".lock")):
        if not result.exists():
            result.write_text(str(build(folder / name)))
    return Path(result.read_text())


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the wheel that users install."""
    return built_once(tmp_path_factory, "dist", build_wheel)


@pytest.fixture(scope="module")  # not "session": while it is open, no other event loop can run
def browser() -> Iterator[Browser]:
    """Return a headless Chromium; tests are skipped without one."""
    with chromium() as started:
        yield started


@pytest.fixture(scope="session")
def fresh(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the Python of an environment with only the wheel and its requirements, which tests must not change."""
    return built_once(tmp_path_factory, "fresh", lambda folder: fresh_python(folder, wheel))

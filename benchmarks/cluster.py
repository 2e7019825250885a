"""A Dask cluster on this machine, of processes that can be watched: a scheduler, real workers and pretended ones."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import psutil

__all__ = ["Cluster", "Crowd", "cluster"]

ROOT: Final = Path(__file__).parents[1]
NO_VERSIONS: Final = """\
from distributed import versions
versions.error_message = lambda *_, **__: {"warning": "", "error": ""}
"""
PATIENCE: Final = 120.0  # seconds until a process answers


@dataclass(frozen=True)
class Crowd:
    """Pretend workers that have joined.

    Attributes
    ----------
    process : psutil.Process
        In which all of them are.
    seconds : float
        How long it took them to join.
    """

    process: psutil.Process
    seconds: float


class Cluster:
    """A scheduler in a process of its own, as ``dask scheduler`` starts it, and what has joined it.

    Parameters
    ----------
    folder : Path
        Where it says how to be reached.
    compares_versions : bool
        Whether a worker that joins is compared with all others, as Dask does: ten thousand take minutes for it.
    """

    def __init__(self, folder: Path, *, compares_versions: bool = True) -> None:
        self._file = folder / "scheduler.json"
        self._started: list[subprocess.Popen[str]] = []
        words = ("--host", "127.0.0.1", "--port", "0", *self._shared)
        if not compares_versions:
            (folder / "no_versions.py").write_text(NO_VERSIONS)
            words += ("--preload", str(folder / "no_versions.py"))
        process = self._start("distributed.cli.dask_scheduler", *words)
        self.scheduler = psutil.Process(process.pid)
        self._wait_until(lambda: self._file.exists() and self._file.read_text().endswith("}"))
        self.address: str = json.loads(self._file.read_text())["address"]

    @property
    def _shared(self) -> tuple[str, ...]:
        return ("--scheduler-file", str(self._file), "--no-dashboard")

    def add_workers(self, count: int) -> None:
        """Start real workers of one thread, and wait until they have joined."""
        from distributed import Client

        for _ in range(count):
            self._start("distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", *self._shared)
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=PATIENCE)

    def add_crowd(self, count: int, seconds: float) -> Crowd:
        """Have pretend workers join, which take so many seconds for a fit; see :mod:`benchmarks.crowd`."""
        words = (self.address, "--workers", str(count), "--seconds", str(seconds))
        process = self._start("benchmarks.crowd", *words)
        assert process.stdout is not None
        said: dict[str, Any] = json.loads(process.stdout.readline())
        return Crowd(psutil.Process(process.pid), said["seconds"])

    def close(self) -> None:
        """End all of it."""
        for process in reversed(self._started):
            process.kill()
            process.wait()
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    stream.close()

    def _start(self, module: str, *words: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", module, *words],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=None if module == "benchmarks.crowd" else subprocess.DEVNULL,
            text=True,
        )
        self._started.append(process)
        return process

    def _wait_until(self, is_so: Any) -> None:
        ends = time.monotonic() + PATIENCE
        while not is_so():
            if time.monotonic() > ends:
                msg = f"no scheduler within {PATIENCE:g} s"
                raise RuntimeError(msg)
            time.sleep(0.01)


@contextlib.contextmanager
def cluster(*, compares_versions: bool = True) -> Iterator[Cluster]:
    """A scheduler without workers, which ends with the block."""
    with tempfile.TemporaryDirectory() as folder:
        made = Cluster(Path(folder), compares_versions=compares_versions)
        try:
            yield made
        finally:
            made.close()

"""A sweep on a Dask cluster of real processes, with a killed worker and a fit that hangs."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from loi_core.runs import write_record
from loi_core.sweeps import sweep
from tests.environments import ROOT
from tests.sweeps.scenes import lay_out, outcome, outcome_here, records

LIMIT = 10  # seconds; a fit takes one, and the start of its process a few
ENDLESS = 2**31 - 1
SWEEP = f"""\
scene = "scene.toml"
timeout = {LIMIT}

[vary]
fit.steps = [{ENDLESS}, 51, 52, 53]
"""


class Cluster:
    """A scheduler and workers, each in a separate process with one thread."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "scheduler.json"
        self._started: list[subprocess.Popen[bytes]] = []
        self._start("dask_scheduler", "--host", "127.0.0.1", "--port", "0")
        wait_until(self._file.exists)

    @property
    def address(self) -> str:
        return str(json.loads(self._file.read_text())["address"])

    def add_worker(self) -> subprocess.Popen[bytes]:
        return self._start("dask_worker", "--nthreads", "1", "--no-nanny")

    def _start(self, command: str, *words: str) -> subprocess.Popen[bytes]:
        shared = ("--scheduler-file", str(self._file), "--no-dashboard")
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{command}", *words, *shared],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._started.append(process)
        return process

    def close(self) -> None:
        for process in reversed(self._started):
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    started = Cluster(tmp_path_factory.mktemp("cluster"))
    yield started
    started.close()


def wait_until(condition: Callable[[], object]) -> None:
    for _ in range(6000):
        if condition():
            return
        time.sleep(0.01)
    msg = "not within a minute"
    raise AssertionError(msg)


def test_every_fit_is_recorded_once_though_a_worker_is_killed_and_a_fit_hangs(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = lay_out(tmp_path, SWEEP)
    output = tmp_path / "sweep-result"
    written: Counter[str] = Counter()

    def counted(record: Path, identity: str, content: Any) -> None:
        written[record.stem] += 1
        write_record(record, identity, content)

    monkeypatch.setattr("loi_core.sweeps.folder.write_record", counted)
    cluster.add_worker()
    victims: list[subprocess.Popen[bytes]] = []
    orphans: list[psutil.Process] = []

    def midway(ended: int, _: int, __: str) -> None:
        if not victims:  # the first worker executes the fit that hangs, and this worker the others
            victims.append(cluster.add_worker())
        if ended == 2 and not orphans:
            wait_until(lambda: begun(output) - set(records(output)))
            orphans.extend(psutil.Process(victims[0].pid).children())
            victims[0].kill()
            cluster.add_worker()

    result = sweep(path, dask=cluster.address, progress=midway)

    assert (result.count("done"), result.count("failed")) == (3, 1)
    assert set(written) == {row["run"] for row in result.rows}
    assert set(written.values()) == {1}
    (failed,) = (row for row in result.rows if row["status"] == "failed")
    assert failed["fit.steps"] == ENDLESS
    assert failed["cause"] == f"no result after {LIMIT} s; its process was killed"
    assert orphans
    wait_until(
        lambda: not any(process.is_running() and process.status() != psutil.STATUS_ZOMBIE for process in orphans)
    )
    for name, record in records(output).items():
        if name != failed["run"]:
            assert outcome(record, output / "runs" / name) == outcome_here(path, name, tmp_path / "here")


def begun(output: Path) -> set[str]:
    """Return the runs that have written a checkpoint, except the fit that hangs."""
    return {path.parent.name for path in output.glob("runs/*/checkpoint.npz") if str(ENDLESS) not in path.parent.name}

"""Sweeps as they are measured: real ones of small fits, on pretend workers, and what is done for each run beside it."""

from __future__ import annotations

import contextlib
import copy
import os
import pickle
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Final

from benchmarks.cluster import cluster
from benchmarks.costs import Measured, Real
from loi_core.io.images import write_png
from loi_core.renderers import Disks
from loi_core.runs import DaskExecutor
from loi_core.sweeps import sweep
from loi_core.sweeps.folder import SweepFolder
from loi_core.sweeps.leaderboard import standings_of
from loi_core.sweeps.one_fit import FitTask, carry_out
from loi_core.sweeps.page import write_leaderboard
from loi_core.sweeps.plan import SweepRun
from loi_core.sweeps.reading import read_sweep
from loi_core.sweeps.table import rows_of, write_table

__all__ = ["STEPS", "lay_out", "measure_joining", "measure_real", "measure_store", "simulate"]

SCENE: Final = """\
target = "target.png"

[renderer]
name = "disks"
positions = [[48, 32]]
radii = [8]
colours = [[0.9, 0.2, 0.1]]

[optimise.positions]
initial = [[20, 40]]
truth = [[48, 32]]
lower = 0
upper = 64

[fit]
steps = {steps}
learning_rate = 1
"""
STEPS: Final = 60  # of a small fit: about a second
COMPARED: Final = 1000
"""Up to how many workers the scheduler compares their versions as they join; :func:`measure_joining` has the others."""
MIB: Final = 2.0**20


def lay_out(folder: Path, runs: int, steps: int = STEPS) -> Path:
    """Write a sweep of so many runs; its path."""
    disk = Disks(64, 64, [[48, 32]], 8.0, [[0.9, 0.2, 0.1]])
    write_png(folder / "target.png", disk.render(disk.parameters()))
    (folder / "scene.toml").write_text(SCENE.format(steps=steps))
    (folder / "sweep.toml").write_text(f'scene = "scene.toml"\nseeds = {runs}\n')
    return folder / "sweep.toml"


class _Timed(DaskExecutor):
    """One that knows how long it took to tell all workers something."""

    told = 0.0

    def everywhere(self, function: Callable[..., Any], *arguments: Any) -> None:
        started = time.perf_counter()
        super().everywhere(function, *arguments)
        self.told = time.perf_counter() - started


def simulate(workers: int, fit: float, runs: int) -> Measured:
    """A sweep on pretend workers."""
    with tempfile.TemporaryDirectory() as folder, cluster(compares_versions=workers <= COMPARED) as made:
        path = lay_out(Path(folder), runs)
        begun = _cpu(made.scheduler)
        crowd = made.add_crowd(workers, fit)
        joined = _cpu(made.scheduler)
        marks: dict[int, tuple[float, float, float, float]] = {}

        def mark(ended: int, wanted: int, _: str) -> None:
            if ended in (0, wanted):
                marks[ended] = (time.perf_counter(), time.process_time(), _cpu(made.scheduler), _cpu(crowd.process))

        executor = _Timed(made.address)
        try:
            found = sweep(path, executor=executor, progress=mark)
        finally:
            executor.shutdown(cancel_futures=True)
        assert found.count("done") == runs, [row["cause"] for row in found.rows][:3]
        wall, client, scheduler, theirs = (b - a for a, b in zip(marks[0], marks[runs], strict=True))
        return Measured(
            workers,
            runs,
            fit,
            crowd.seconds,
            joined - begun,
            wall,
            client / runs,
            scheduler / runs,
            theirs / runs,
            made.scheduler.memory_info().rss / MIB,
            executor.told,
        )


def _cpu(process: Any) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def measure_real(how: str, workers: int, runs: int, steps: int = STEPS) -> tuple[Real, dict[str, float]]:
    """Sweeps of one run and of many for each worker, and what a run has left on disk."""
    times: dict[int, float] = {}
    fits: dict[int, float] = {}
    left: dict[str, float] = {}
    for count in (workers, runs):
        with tempfile.TemporaryDirectory() as folder, _executor(how, workers) as executor:
            path = lay_out(Path(folder), count, steps)
            marks: dict[int, float] = {}

            def mark(ended: int, _: int, __: str, marks: dict[int, float] = marks) -> None:
                marks[ended] = time.perf_counter()

            # The check of the scene before the first run has started one process; its imports are not in `start`.
            found = sweep(path, executor=executor, processes=None if executor else workers, progress=mark)
            assert found.count("done") == count, [row["cause"] for row in found.rows][:3]
            times[count] = marks[count] - marks[0]
            fits[count] = statistics.mean(float(row["seconds"]) for row in found.rows)
            left = _left(Path(folder) / "sweep-result" / "runs", count)
    rounds = runs / workers - 1
    each = (times[runs] - times[workers]) / rounds
    worker = max(0.0, each - fits[runs])
    start = max(0.0, times[workers] - fits[workers] - worker)
    return Real(how, workers, runs, times[runs], fits[runs], worker, start), left


@contextlib.contextmanager
def _executor(how: str, workers: int) -> Iterator[Executor | None]:
    if how == "processes":
        yield None
        return
    with cluster() as made:
        made.add_workers(workers)
        executor = DaskExecutor(made.address)
        try:
            yield executor
        finally:
            executor.shutdown(cancel_futures=True)


def _left(folder: Path, runs: int) -> dict[str, float]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {"files of a run": len(files) / runs, "KiB of a run": sum(one.stat().st_size for one in files) / runs / 1024}


def _write_all(store: SweepFolder, record: dict[str, Any], runs: Sequence[SweepRun]) -> None:
    for run in runs:
        store.keep(run, record)


def measure_store(runs: int) -> dict[str, float]:
    """What the process of a sweep does for each run beside having it carried out: milliseconds, and bytes."""
    with tempfile.TemporaryDirectory() as folder:
        path = lay_out(Path(folder), runs)
        found: dict[str, float] = {}

        def timed(name: str, do: Callable[[], Any]) -> Any:
            started = time.perf_counter()
            result = do()
            found[name] = 1e3 * (time.perf_counter() - started) / runs
            return result

        plan = read_sweep(path)
        every = timed("name the runs", lambda: plan.runs)
        store = SweepFolder(plan.output)
        record = {"objective": "loi", "verdict": "converged", "psnr": 40.0, "psnr_initial": 9.0, "value": 1e-5}
        record |= {"errors": {"positions": 0.01}, "best_step": 59, "steps": 60, "seconds": 1.0, "cause": ""}
        record |= {"attempts": 1}
        timed("write a record", lambda: _write_all(store, record, every))
        timed("list the folder of records", lambda: os.listdir(store.path / "records"))  # noqa: PTH208 - the folder is timed, not pathlib's objects
        records = timed("read a record", lambda: {run.name: store.read(run) for run in every})
        for run in every:
            (store.runs / run.name).mkdir(parents=True)
            (store.runs / run.name / "report.html").write_text("")
        rows = timed("rows", lambda: rows_of(plan, records))
        standings = timed("standings", lambda: standings_of(plan, rows))
        timed("write the table", lambda: write_table(store.path, rows))
        timed("write the page", lambda: write_leaderboard(plan, rows, standings, store.runs))
        task = FitTask(every[0].name, every[0].scene, every[0].document, 0, store.runs / every[0].name)
        found["bytes of a task"] = len(pickle.dumps((carry_out, task)))
        return found


def measure_joining(workers: int) -> float:
    """Seconds that the scheduler takes to compare the versions of one more worker with those of all others."""
    from distributed.versions import error_message, get_versions

    own = get_versions()
    others = {str(number): copy.deepcopy(own) for number in range(workers)}
    started = time.process_time()
    error_message(own, others, own)
    return time.process_time() - started

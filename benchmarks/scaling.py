"""What many fits cost beside the fits, and how many workers that leaves busy: measured, modelled, and simulated.

Run from the root of the repository: ``python -m benchmarks.scaling``. Prints Markdown tables; ``--json PATH`` writes
all numbers. In three parts:

- ``real``: sweeps of small fits on one and two workers, by processes and by Dask; what a run leaves on disk.
- ``store``: what the process of the sweep does for each run before and after it is carried out.
- ``crowd``: sweeps on Dask's own scheduler with pretend workers (:mod:`benchmarks.crowd`), beside what the model says
  from what was measured on the smallest number of them.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import dataclasses
import json
import os
import pickle
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Final

from benchmarks.cluster import cluster
from benchmarks.crowd import SPREAD
from benchmarks.tables import print_table
from loi_core.io.files import write_text
from loi_core.io.images import write_png
from loi_core.renderers import Disks
from loi_core.runs import DaskExecutor
from loi_core.support.processors import usable_processors
from loi_core.sweeps import sweep
from loi_core.sweeps.folder import SweepFolder
from loi_core.sweeps.leaderboard import standings_of
from loi_core.sweeps.one_fit import FitTask, carry_out
from loi_core.sweeps.page import write_leaderboard
from loi_core.sweeps.plan import SweepRun
from loi_core.sweeps.reading import read_sweep
from loi_core.sweeps.table import rows_of, write_table

__all__ = ["Costs", "Measured", "main", "simulate"]

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
CROWDS: Final = ("1:0:500", "10:0:1000", "100:4:500", "1000:20:3000", "10000:120:10000")
"""Pretend workers, seconds that they take for a fit, and runs; the first two, at their limit, say what a run costs."""
KNOWN: Final = 2
SPARE: Final = 200  # open files of a scheduler beside those for workers
COMPARED: Final = 1000
"""Up to how many workers the scheduler compares their versions as they join; :func:`measure_joining` has the others."""
READINGS: Final = 2  # of each record, by a sweep that begins
STORED: Final = 10_000  # runs in one folder
MIB: Final = 2.0**20


@dataclasses.dataclass(frozen=True)
class Costs:
    """What a run costs beside its fit, in seconds.

    Attributes
    ----------
    before, after : float
        Of the process of the sweep: to read its files, name all runs and look for their records; to write the table and
        the page.
    client : float
        Of the process of the sweep while runs are carried out: to send a run, get what came of it, put it on record.
    scheduler : float
        Of Dask's scheduler.
    worker : float
        Of a worker, between two fits and to write what came of one.
    start : float
        Until a worker has begun its first fit; once, not for each run.
    """

    before: float
    after: float
    client: float
    scheduler: float
    worker: float = 0.0
    start: float = 0.0

    @property
    def each(self) -> float:
        """Seconds between the ends of two runs, at least, whatever the number of workers."""
        return max(self.client, self.scheduler)

    def carried_out(self, runs: int, workers: int, fit: float, *, shared: float = 0.0) -> float:
        """Seconds from the first run to the last: of those who are at work at the same time, what the slowest takes.

        Parameters
        ----------
        runs, workers : int
        fit : float
            Seconds of a fit, in the mean; they differ by half of that.
        shared : float
            Seconds for a run of a machine that all of them share; 0 if each has its own.
        """
        rounds = max(1.0, runs / workers)
        last = SPREAD * fit + self.client + self.scheduler  # the others have nothing left to do
        return self.start + max(rounds * (fit + self.worker), runs * max(self.each, shared)) + last

    def seconds(self, runs: int, workers: int, fit: float) -> float:
        """How long a sweep takes on a cluster."""
        return runs * (self.before + self.after) + self.carried_out(runs, workers, fit)

    def shortest(self, workers: int) -> float:
        """Seconds that a fit has to take to keep so many workers busy."""
        return max(0.0, workers * self.each - self.worker)


@dataclasses.dataclass(frozen=True)
class Measured:
    """A sweep on pretend workers.

    Attributes
    ----------
    workers, runs : int
    fit : float
        Seconds that a worker takes.
    join, join_scheduler : float
        Seconds until all workers had joined, and those of the scheduler's processor in it.
    seconds : float
        From the first run to the last.
    client, scheduler, crowd : float
        Seconds of the processor in that, for a run.
    memory : float
        MiB of the scheduler, at the end.
    leaving : float
        Seconds in which all workers are told that the sweep has ended.
    """

    workers: int
    runs: int
    fit: float
    join: float
    join_scheduler: float
    seconds: float
    client: float
    scheduler: float
    crowd: float
    memory: float
    leaving: float


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


@dataclasses.dataclass(frozen=True)
class Real:
    """Real sweeps of small fits, a short one and a long one.

    Attributes
    ----------
    how : str
        "processes" or "Dask".
    workers : int
    runs : int
        Of the long one.
    seconds : float
        From its first run to its last.
    fit : float
        The mean over its runs of what their own clocks say.
    worker : float
        Seconds of a worker for a further run, beside its fit.
    start : float
        Seconds until the workers had begun.
    """

    how: str
    workers: int
    runs: int
    seconds: float
    fit: float
    worker: float
    start: float


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


def costs_of(store: Mapping[str, float], real: Sequence[Real], crowds: Sequence[Measured]) -> Costs:
    """What the model goes by; 0 for what has not been measured."""
    few = crowds[:KNOWN]
    before = store.get("name the runs", 0.0) + READINGS * store.get("read a record", 0.0)
    after = sum(store.get(name, 0.0) for name in ("rows", "standings", "write the table", "write the page"))
    dask = [one for one in real if one.how == "Dask"]
    return Costs(
        before=1e-3 * before,
        after=1e-3 * after,
        client=statistics.mean(one.client for one in few) if few else 0.0,
        scheduler=statistics.mean(one.scheduler for one in few) if few else 0.0,
        worker=statistics.mean(one.worker for one in dask) if dask else 0.0,
        start=statistics.mean(one.start for one in dask) if dask else 0.0,
    )


def real_table(real: Sequence[Real]) -> list[dict[str, str]]:
    """Sweeps of small fits."""
    return [
        {
            "how": one.how,
            "workers": str(one.workers),
            "runs": str(one.runs),
            "seconds": f"{one.seconds:.1f}",
            "runs a second": f"{one.runs / one.seconds:.2f}",
            "s of a fit": f"{one.fit:.2f}",
            "beside it, s": f"{one.worker:.2f}",
            "to begin, s": f"{one.start:.1f}",
        }
        for one in real
    ]


def crowd_table(crowds: Sequence[Measured], costs: Costs) -> list[dict[str, str]]:
    """What the model says of pretend workers, and what was measured."""
    # They, the scheduler and the sweep share one machine; their fits leave nothing to write, and no process to start.
    here = dataclasses.replace(costs, worker=0.0, start=0.0)
    lines = []
    for one in crowds:
        shared = (here.client + here.scheduler + crowds[0].crowd) / usable_processors()
        predicted = here.carried_out(one.runs, one.workers, one.fit, shared=shared)
        lines.append(
            {
                "workers": str(one.workers),
                "s of a fit": f"{one.fit:g}",
                "runs": str(one.runs),
                "predicted s": f"{predicted:.1f}",
                "measured s": f"{one.seconds:.1f}",
                "ratio": f"{one.seconds / predicted:.2f}",
                "sweep, ms a run": f"{1e3 * one.client:.2f}",
                "scheduler, ms a run": f"{1e3 * one.scheduler:.2f}",
                "scheduler, MiB": f"{one.memory:.0f}",
                "to join, s": f"{one.join:.1f}",
                "scheduler in it, s": f"{one.join_scheduler:.1f}",
                "to part, s": f"{one.leaving:.1f}",
            }
        )
    return lines


def expectation_table(costs: Costs) -> list[dict[str, str]]:
    """What a cluster is expected to do with ten fits for each worker."""
    lines = []
    for workers in (1, 10, 100, 1000, 10000):
        line = {"workers": str(workers), "shortest fit that keeps them busy": f"{costs.shortest(workers):.2g} s"}
        for fit in (1.0, 10.0, 60.0, 600.0):
            seconds = costs.seconds(10 * workers, workers, fit)
            line[f"fits of {fit:g} s"] = f"{seconds:.0f} s ({10 * fit / seconds:.0%})"
        lines.append(line)
    return lines


def _joining_line(workers: int) -> dict[str, str]:
    one = measure_joining(workers)
    return {"workers": str(workers), "the last, ms": f"{1e3 * one:.2f}", "all of them, s": f"{one * workers / 2:.2f}"}


def _open_files() -> int:
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scaling", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=("real", "store", "crowd"), default=["store", "crowd", "real"])
    parser.add_argument("--runs", type=int, default=10, help="for each worker, of real fits")
    parser.add_argument("--steps", type=int, default=STEPS, help="of each of them")
    parser.add_argument("--stored", type=int, default=STORED, help="runs in one folder")
    parser.add_argument("--crowds", nargs="+", default=CROWDS, metavar="WORKERS:SECONDS:RUNS")
    parser.add_argument("--json", type=Path, help="write all numbers there")
    options = parser.parse_args(arguments)
    store: dict[str, float] = {}
    real: list[Real] = []
    crowds: list[Measured] = []
    if "store" in options.parts:
        store = measure_store(options.stored)
        print(f"The process of a sweep of {options.stored} runs, beside having them carried out\n")
        print_table(
            [
                {"what": f"{name}, ms a run" if "bytes" not in name else name, "": f"{value:.3g}"}
                for name, value in store.items()
            ]
        )
    if "real" in options.parts:
        for how in ("processes", "Dask"):
            for workers in (1, 2):
                one, left = measure_real(how, workers, options.runs * workers, options.steps)
                real.append(one)
                store |= left
        print("Real sweeps of small fits\n")
        print_table(real_table(real))
        print_table([{"what": name, "": f"{store[name]:.3g}"} for name in left])
    if "crowd" in options.parts:
        for each in options.crowds:
            workers, seconds, runs = each.split(":")
            if _open_files() < 2 * int(workers) + SPARE:
                # The scheduler has a connection to each worker for tasks, and one for results; without, it waits.
                print(f"{each} left out: `ulimit -n` is {_open_files()}, less than two a worker", file=sys.stderr)
                continue
            crowds.append(simulate(int(workers), float(seconds), int(runs)))
            print(f"{each} done", file=sys.stderr, flush=True)
        costs = costs_of(store, real, crowds)
        print(f"Pretend workers, with all on one machine of {usable_processors()} processors\n")
        print_table(crowd_table(crowds, costs))
        print("The scheduler compares the versions of each worker that joins with those of all others\n")
        print_table([_joining_line(number) for number in (100, 1000, 10000)])
        print(
            "What the model expects of a cluster for ten fits of each worker, and the share of time that workers fit\n"
        )
        print_table(expectation_table(costs))
    if options.json:
        numbers = {
            "store": store,
            "real": [dataclasses.asdict(one) for one in real],
            "crowd": [dataclasses.asdict(one) for one in crowds],
            "costs": dataclasses.asdict(costs_of(store, real, crowds)),
        }
        write_text(options.json, json.dumps(numbers, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Execution of a sweep: finished runs are skipped, and each run is recorded when it finishes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

from loi_core.errors import SceneError
from loi_core.runs import RunResult, Workers
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import whole_number
from loi_core.sweeps.fit_task import FitTask, run_fit, scene_error
from loi_core.sweeps.folder import SweepFolder
from loi_core.sweeps.leaderboard import Standing, standings_of
from loi_core.sweeps.page import write_leaderboard
from loi_core.sweeps.plan import REPEATS, Sweep, SweepRun, format_value
from loi_core.sweeps.reading import read_sweep
from loi_core.sweeps.table import Row, rows_of, write_table

__all__ = ["Progress", "SweepResult", "sweep"]

UPDATE_INTERVAL_S: Final = 60.0  # between updates of the table and the page
MAX_DETAILS: Final = 4000  # characters at the end of a traceback that a record holds

Progress: TypeAlias = Callable[[int, int, str], None]
"""Called as ``progress(finished, total, cause)`` before the first run and after each run, with its cause of failure."""

Records: TypeAlias = dict[str, dict[str, Any]]
"""Records of finished runs by name."""


@dataclass(frozen=True)
class SweepResult:
    """The result of a sweep.

    Attributes
    ----------
    rows : tuple of dict
        The table: one row per run, with its ``status``, "done", "failed" or "missing", and its ``cause`` of failure.
    standings : tuple of Standing
        The settings, best first.
    table : Path
        ``sweep.csv``.
    page : Path
        ``leaderboard.html``.
    """

    rows: tuple[Row, ...]
    standings: tuple[Standing, ...]
    table: Path
    page: Path

    def count(self, status: str) -> int:
        """Return the number of runs that are "done", "failed" or "missing"."""
        return sum(row["status"] == status for row in self.rows)


@suggest_keywords
def sweep(
    path: Path | str,
    *,
    output: Path | str | None = None,
    processes: int | None = None,
    dask: Any = None,
    retry_failed: bool = False,
    progress: Progress | None = None,
) -> SweepResult:
    """Execute the unfinished runs of a sweep file and write its table and its page.

    Each run is executed in a worker process on one thread. A process that dies, or exceeds the ``timeout`` of the file,
    fails only its own run. The calling process alone writes the records, one per run. Worker processes are spawned: a
    script that calls this function needs ``if __name__ == "__main__":``.

    Parameters
    ----------
    path : path
        The sweep file; see ``docs/guide/sweeps.md``.
    output : path, optional
        Overrides the output folder of the file.
    processes : int, optional
        Number of parallel runs; by default the number of processors.
    dask : str or cluster, optional
        A Dask cluster that executes the runs instead, or the address of its scheduler; see
        :class:`loi_core.runs.Workers`.
    retry_failed : bool
        Whether to execute failed runs again.
    progress : callable, optional
        ``progress(finished, total, cause)``, called before the first run and after each run.

    Returns
    -------
    SweepResult
        Results of all runs of the file, runs of earlier calls included.

    Raises
    ------
    SceneError
        If the file, or a scene with one of the varied values, is not valid; nothing is written then.
    OptionError
        If an argument is not allowed, or the output folder does not belong to a sweep.
    ExecutorError
        If the cluster cannot be reached, or breaks.
    KeyboardInterrupt
        On Ctrl-C, with the number of finished runs; their records are kept, and the table and page include them.
    """
    plan = read_sweep(Path(path), output=None if output is None else Path(output))
    folder = SweepFolder(plan.output)
    with Workers(processes, dask) as workers:
        _check_scenes(plan, folder, workers, _unfinished(plan, _read_records(plan, folder), retry_failed=retry_failed))
        with folder.locked():
            return _execute(plan, folder, workers, progress, retry_failed=retry_failed)


def _read_records(plan: Sweep, folder: SweepFolder) -> Records:
    return {run.name: record for run in plan.runs if (record := folder.read(run)) is not None}


def _unfinished(plan: Sweep, records: Mapping[str, Mapping[str, Any]], *, retry_failed: bool) -> dict[str, SweepRun]:
    return {
        run.name: run
        for run in plan.runs
        if run.name not in records or (retry_failed and records[run.name].get("cause"))
    }


def _fit_task(run: SweepRun, folder: SweepFolder) -> FitTask:
    return FitTask(run.name, run.scene, run.document, run.start, folder.runs / run.name)


def _check_scenes(plan: Sweep, folder: SweepFolder, workers: Workers, runs: Mapping[str, SweepRun]) -> None:
    """Raise :class:`SceneError` if a scene is not valid; every scene and every varied value occurs in a checked run."""
    checked: set[tuple[str, str, str]] = set()
    tasks: list[FitTask] = []
    for run in runs.values():
        values = {(run.label, "", "")} | {(run.label, key, _kind(key, value)) for key, value in run.varied.items()}
        if not values <= checked:
            checked |= values
            tasks.append(_fit_task(run, folder))
    # A check that hangs or crashes is ignored: the run does so again and is then listed with its cause.
    for result in workers.map_unordered(scene_error, tasks, timeout=plan.timeout):
        if result.value:
            msg = f"{result.value} (run {result.run.name} of {plan.path.name})"
            raise SceneError(msg)


def _kind(key: str, value: Any) -> str:
    """Return the equivalence class of a value for the check; seeds and starts, possibly many, count by magnitude."""
    number = whole_number(value) if key in REPEATS else None
    return format_value(value) if number is None or number < 0 else f"{number.bit_length()} bits"


def _execute(
    plan: Sweep, folder: SweepFolder, workers: Workers, progress: Progress | None, *, retry_failed: bool
) -> SweepResult:
    records = _read_records(plan, folder)  # again, now that no other process writes records
    runs = _unfinished(plan, records, retry_failed=retry_failed)
    finished, written = 0, time.monotonic()
    if progress is not None:
        progress(0, len(runs), "")
    try:
        tasks = [_fit_task(run, folder) for run in runs.values()]
        for result in workers.map_unordered(run_fit, tasks, timeout=plan.timeout):
            record = _record(result)
            folder.write(runs[result.run.name], record)
            records[result.run.name] = record
            finished += 1
            if progress is not None:
                progress(finished, len(runs), record["cause"])
            if time.monotonic() - written > UPDATE_INTERVAL_S:
                _write(plan, folder, records)
                written = time.monotonic()
    except BaseException as error:
        records = _read_records(plan, folder)  # Ctrl-C may have come between a written record and `records`
        _write(plan, folder, records)
        if isinstance(error, KeyboardInterrupt):
            msg = f"interrupted; {len(records)} of {len(plan.runs)} runs are finished, the same call continues"
            raise KeyboardInterrupt(msg) from None
        raise
    return _write(plan, folder, records)


def _record(result: RunResult[FitTask]) -> dict[str, Any]:
    if result.cause:
        return {"cause": result.cause, "details": result.details[-MAX_DETAILS:]}
    record: dict[str, Any] = result.value
    return record


def _write(plan: Sweep, folder: SweepFolder, records: Mapping[str, Mapping[str, Any]]) -> SweepResult:
    rows = rows_of(plan, records)
    standings = standings_of(plan, rows)
    table = write_table(folder.path, rows)
    page = write_leaderboard(plan, rows, standings, folder.runs)
    return SweepResult(tuple(rows), standings, table, page)

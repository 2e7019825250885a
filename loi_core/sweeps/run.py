"""Carrying out a sweep: what is done is not done again, and every run that ends is on record at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

from loi_core.errors import SceneError
from loi_core.runs import Ended, Workers
from loi_core.support.values import whole_number
from loi_core.sweeps.folder import SweepFolder
from loi_core.sweeps.leaderboard import Standing, standings_of
from loi_core.sweeps.one_fit import FitTask, carry_out, refusal
from loi_core.sweeps.page import write_leaderboard
from loi_core.sweeps.plan import REPEATS, Sweep, SweepRun, spelled
from loi_core.sweeps.reading import read_sweep
from loi_core.sweeps.table import Row, rows_of, write_table

__all__ = ["Progress", "SweepResult", "sweep"]

PAUSE: Final = 60.0  # seconds between two versions of the table and the page while runs go on
MOST_DETAILS: Final = 4000  # characters of a traceback that a record keeps: its end

Progress: TypeAlias = Callable[[int, int, str], None]
"""Called as ``progress(ended, wanted, cause)`` before the first run, and after every one with why it failed, or ""."""


@dataclass(frozen=True)
class SweepResult:
    """What came of a sweep.

    Attributes
    ----------
    rows : tuple of dict
        The table: a row for each run, with its ``status``, "done", "failed" or "missing", and its ``cause``.
    standings : tuple of Standing
        The settings, the best first.
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
        """How many runs are "done", "failed" or "missing"."""
        return sum(row["status"] == status for row in self.rows)


def sweep(
    path: Path | str,
    *,
    output: Path | str | None = None,
    executor: Executor | None = None,
    processes: int | None = None,
    retry_failed: bool = False,
    progress: Progress | None = None,
) -> SweepResult:
    """Carry out those runs of a sweep file that have not ended yet, then write its table and its page.

    Every run is carried out in a process of its own, on one thread, wherever the executor has it done. This process
    alone puts on record how each has ended, once. A run whose process dies is begun once more, from its checkpoint;
    one that takes longer than the file's ``timeout`` is ended.

    Parameters
    ----------
    path : path
        The sweep file; see ``docs/sweeps.md``.
    output : path, optional
        Overrides the file's own output folder.
    executor : concurrent.futures.Executor, optional
        Whose workers wait for the processes; :class:`loi_core.runs.DaskExecutor` has those of a cluster. It stays open.
    processes : int, optional
        How many runs go on side by side here, without an executor; by default as many as there are processors.
    retry_failed : bool
        Whether those that have failed are carried out again.
    progress : callable, optional
        ``progress(ended, wanted, cause)`` before the first run and after every one.

    Returns
    -------
    SweepResult
        Of all runs of the file, with those that had ended before.

    Raises
    ------
    SceneError
        If the file, or a scene with a value that it puts there, is not allowed; nothing is written then.
    OptionError
        If an argument is not allowed, or the folder is somebody else's.
    ExecutorError
        If the executor breaks.
    KeyboardInterrupt
        On Ctrl-C, with how many runs had ended; these are kept, and in the table and on the page.
    """
    plan = read_sweep(Path(path), output=None if output is None else Path(output))
    folder = SweepFolder(plan.output)
    with Workers(executor, processes) as workers:
        _check(plan, folder, workers, _wanted(plan, _recorded(plan, folder), retry_failed=retry_failed))
        with folder.held():
            return _carry_out(plan, folder, workers, progress, retry_failed=retry_failed)


def _recorded(plan: Sweep, folder: SweepFolder) -> dict[str, dict[str, Any]]:
    """What is on record, by the name of the run."""
    return {run.name: record for run in plan.runs if (record := folder.read(run)) is not None}


def _wanted(plan: Sweep, records: Mapping[str, Mapping[str, Any]], *, retry_failed: bool) -> list[SweepRun]:
    return [run for run in plan.runs if run.name not in records or (retry_failed and records[run.name].get("cause"))]


def _task(run: SweepRun, folder: SweepFolder) -> FitTask:
    return FitTask(run.name, run.scene, run.document, run.start, folder.runs / run.name)


def _check(plan: Sweep, folder: SweepFolder, workers: Workers, wanted: Sequence[SweepRun]) -> None:
    """Raise :class:`SceneError` if a scene is not allowed: each scene, with each value of what varies, in some run."""
    seen: set[tuple[str, str, str]] = set()
    tried: list[FitTask] = []
    for run in wanted:
        new = {(run.label, "", "")} | {(run.label, key, _kind(key, value)) for key, value in run.varied.items()}
        if not new <= seen:
            seen |= new
            tried.append(_task(run, folder))
    # What hangs or dies here does so again as a run, which is then listed with its cause.
    for ended in workers.carry_out(tried, refusal, timeout=plan.timeout):
        if ended.value:
            msg = f"{ended.value} (run {ended.run.name} of {plan.path.name})"
            raise SceneError(msg)


def _kind(key: str, value: Any) -> str:
    """What tells a value from those that have been checked: of seeds and starts, which may be many, the size."""
    number = whole_number(value) if key in REPEATS else None
    return spelled(value) if number is None or number < 0 else f"{number.bit_length()} bits"


def _carry_out(
    plan: Sweep, folder: SweepFolder, workers: Workers, progress: Progress | None, *, retry_failed: bool
) -> SweepResult:
    records = _recorded(plan, folder)  # again, now that nobody else writes any
    wanted = {run.name: run for run in _wanted(plan, records, retry_failed=retry_failed)}
    ended_now, written = 0, time.monotonic()
    if progress is not None:
        progress(0, len(wanted), "")
    try:
        for ended in workers.carry_out(
            [_task(run, folder) for run in wanted.values()], carry_out, timeout=plan.timeout
        ):
            record = _record(ended)
            folder.keep(wanted[ended.run.name], record)
            records[ended.run.name] = record
            ended_now += 1
            if progress is not None:
                progress(ended_now, len(wanted), record["cause"])
            if time.monotonic() - written > PAUSE:
                _write(plan, folder, records)
                written = time.monotonic()
    except BaseException as stop:
        kept = _recorded(plan, folder)  # a run whose record was just written may not be among `records` yet
        _write(plan, folder, kept)
        if isinstance(stop, KeyboardInterrupt):
            msg = f"interrupted; {len(kept)} of {len(plan.runs)} runs have ended and are kept, the same call goes on"
            raise KeyboardInterrupt(msg) from None
        raise
    return _write(plan, folder, records)


def _record(ended: Ended[FitTask]) -> dict[str, Any]:
    if ended.cause:
        return {"cause": ended.cause, "details": ended.details[-MOST_DETAILS:], "attempts": ended.attempts}
    return {**ended.value, "attempts": ended.attempts}


def _write(plan: Sweep, folder: SweepFolder, records: Mapping[str, Mapping[str, Any]]) -> SweepResult:
    rows = rows_of(plan, records)
    standings = standings_of(plan, rows)
    table = write_table(folder.path, rows)
    page = write_leaderboard(plan, rows, standings, folder.runs)
    return SweepResult(tuple(rows), standings, table, page)

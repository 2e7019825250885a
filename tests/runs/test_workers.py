"""Parallel runs: whatever one run does, every other run ends as it would alone."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from loi_core.errors import ExecutorError, OptionError
from loi_core.runs import RunResult, Workers, read_record, write_record
from tests.environments import ROOT
from tests.runs import tasks


def run_all(function: Any, runs: Any, workers: Workers | None = None, **options: Any) -> list[RunResult[Any]]:
    with workers or Workers(processes=2) as pool:
        return sorted(pool.map_unordered(function, runs, **options), key=lambda result: str(result.run))


def test_workers_execute_each_run_once() -> None:
    assert run_all(tasks.double, range(7)) == [RunResult(k, 2 * k) for k in range(7)]


def test_a_worker_process_is_reused_and_has_one_thread() -> None:
    settings = {result.value for result in run_all(tasks.process_settings, range(5), Workers(processes=1))}
    assert len(settings) == 1
    ((process, threads),) = settings
    assert process != os.getpid()
    assert threads == "1"


def test_workers_leave_the_environment_of_the_program_unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    assert run_all(tasks.process_settings, [0])[0].value[1] == "1"
    assert os.environ["OMP_NUM_THREADS"] == "3"
    assert "MKL_NUM_THREADS" not in os.environ


def test_results_are_yielded_while_later_runs_are_still_submitted(monkeypatch: pytest.MonkeyPatch) -> None:
    submitted: list[int] = []

    def runs() -> Iterator[int]:
        for number in range(100):
            submitted.append(number)
            yield number

    class Immediate(ThreadPoolExecutor):
        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Any:
            future: Future[RunResult[int]] = Future()
            future.set_result(RunResult(args[2], "done"))
            return future

    monkeypatch.setattr("loi_core.runs.workers.ThreadPoolExecutor", Immediate)
    with Workers(1) as workers:
        results = workers.map_unordered(tasks.double, runs())
        assert next(results).value == "done"
        assert submitted == [0]
        assert len(list(results)) == 99


def test_an_exception_fails_its_run_with_a_cause_on_one_line() -> None:
    (result,) = run_all(tasks.raise_error, [5])
    assert (result.value, result.cause) == (None, "ArithmeticError: not 5 nor another")
    assert "tasks.py" in result.details
    assert [result.cause for result in run_all(tasks.quit_with, [3])] == ["SystemExit: 3"]


def test_output_and_input_of_a_run_do_not_disturb_its_result() -> None:
    first, second = run_all(tasks.print_and_read, [-1, 4])
    assert first.cause.startswith("EOFError")
    assert second.value == 4


def test_a_run_that_hangs_is_killed_and_the_other_runs_finish() -> None:
    results = run_all(tasks.hang, [-1, 1, 2], timeout=3.0)
    assert [result.value for result in results] == [None, 1, 2]
    assert results[0].cause == "no result after 3 s; its process was killed"


def test_a_killed_process_loses_only_its_own_run() -> None:
    results = run_all(tasks.kill_process, [-1, 1, 2, 3, 4])
    assert [(result.value, result.cause) for result in results] == [
        (None, "its process died"),
        *((k, "") for k in range(1, 5)),
    ]


def test_the_last_output_of_a_process_that_died_is_reported() -> None:
    (result,) = run_all(tasks.abort, [0])
    assert result.cause == "its process died"
    assert "out of everything" in result.details
    assert "Fatal Python error: Aborted" in result.details


def test_processes_end_with_their_workers(tmp_path: Path) -> None:
    mark = tmp_path / "wait"
    mark.write_text("x")
    with Workers(processes=2) as workers:
        results = workers.map_unordered(tasks.wait_for_removal, [tmp_path / "gone" / "wait", mark])
        assert next(results).cause.startswith("FileNotFoundError")
        pid = process_of(mark)
    assert has_ended(pid)


def test_processes_end_with_the_program_that_started_them(tmp_path: Path) -> None:
    mark = tmp_path / "wait"
    mark.write_text("x")
    code = (
        "import sys; from pathlib import Path; from loi_core.runs import Workers; from tests.runs import tasks\n"
        "with Workers(processes=1) as workers: list(workers.map_unordered(tasks.wait_for_removal, [Path(sys.argv[1])]))"
    )
    program = subprocess.Popen([sys.executable, "-c", code, mark], cwd=ROOT)
    pid = process_of(mark)
    program.kill()
    program.wait()
    assert has_ended(pid)


def process_of(mark: Path) -> int:
    """Return the id of the process that waits for the removal of this file."""
    for _ in range(3000):
        paths = [path for path in mark.parent.iterdir() if path != mark]
        if paths:
            return int(paths[0].suffix[1:])
        time.sleep(0.02)
    msg = "the run has not begun within a minute"
    raise AssertionError(msg)


def has_ended(pid: int) -> bool:
    """Return whether a process ends within ten seconds."""
    for _ in range(500):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":  # ended, and not yet reaped by its new parent
            return True
        time.sleep(0.02)
    return False


def test_an_executor_that_is_shut_down_raises_an_executor_error() -> None:
    with Workers(1) as workers:
        pass
    with pytest.raises(ExecutorError, match=r"the executor broke \(RuntimeError"):
        list(workers.map_unordered(tasks.double, [1]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"processes": 0}, "`processes` must be a whole number from 1 to 4096, got 0"),
        ({"processes": 1.5}, "got 1.5"),
        ({"dask": "tcp://127.0.0.1:1", "processes": 1}, "exclude each other"),
    ],
)
def test_workers_refuse_wrong_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        Workers(**options)


def test_a_wrong_time_limit_is_refused_before_any_run() -> None:
    for timeout in (0, -1.0, float("nan"), "1", True, 1e9):
        with pytest.raises(OptionError, match="`timeout` must be a number of seconds"):
            run_all(tasks.double, [1], timeout=timeout)


def test_a_run_that_cannot_be_pickled_fails_with_its_cause() -> None:
    results = run_all(tasks.double, [lambda: 0, 4])
    assert [result.value for result in results if isinstance(result.run, int)] == [8]
    (failed,) = (result for result in results if not isinstance(result.run, int))
    assert "pickle" in failed.cause


def test_a_record_belongs_to_exactly_one_run(tmp_path: Path) -> None:
    path = tmp_path / "below" / "one.json"
    assert read_record(path, "this") is None
    write_record(path, "this", {"psnr": 31.5})
    assert read_record(path, "this") == {"run": "this", "psnr": 31.5}
    assert read_record(path, "that") is None
    for damage in (b"{ cut sho", b"[1]", b"\xff", pickle.dumps({"run": "this"})):
        path.write_bytes(damage)
        assert read_record(path, "this") is None

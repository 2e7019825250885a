"""Runs side by side: whatever one of them does, every other ends as it would alone."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest

from loi_core.errors import ExecutorError, OptionError
from loi_core.runs import Ended, Workers, read_record, write_record
from loi_core.runs.reply import Reply
from tests.environments import ROOT
from tests.runs import tasks

EXECUTORS: dict[str, Callable[[], Executor]] = {
    "threads": lambda: ThreadPoolExecutor(2),
    "processes": lambda: ProcessPoolExecutor(2, mp_context=get_context("spawn")),
}


def ended(runs: Any, function: Any, workers: Workers | None = None, **options: Any) -> list[Ended[Any]]:
    with workers or Workers(processes=2) as made:
        return sorted(made.carry_out(runs, function, **options), key=lambda one: str(one.run))


@pytest.mark.parametrize("kind", EXECUTORS)
def test_any_executor_carries_out_every_run_once(kind: str) -> None:
    with EXECUTORS[kind]() as executor:
        found = ended(range(7), tasks.double, Workers(executor))
        assert executor.submit(tasks.double, 4).result() == 8  # it stays open
    assert [(one.run, one.value, one.cause, one.attempts) for one in found] == [(k, 2 * k, "", 1) for k in range(7)]


def test_a_process_is_kept_for_the_next_run_and_has_one_thread() -> None:
    found = {one.value for one in ended(range(5), tasks.place, Workers(processes=1))}
    assert len(found) == 1
    ((process, threads),) = found
    assert process != os.getpid()
    assert threads == "1"


def test_what_has_ended_is_told_while_others_are_still_submitted() -> None:
    given: list[int] = []

    def runs() -> Iterator[int]:
        for number in range(100):
            given.append(number)
            yield number

    class AtOnce(ThreadPoolExecutor):
        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Any:
            future: Future[Reply] = Future()
            future.set_result(Reply(pickle.dumps("done")))
            return future

    with AtOnce(1) as executor, Workers(executor) as workers:
        found = workers.carry_out(runs(), tasks.double)
        assert next(found).value == "done"
        assert given == [0]
        assert len(list(found)) == 99


def test_a_run_that_raises_fails_with_its_cause_on_one_line() -> None:
    (one,) = ended([5], tasks.refuse)
    assert (one.value, one.cause, one.attempts) == (None, "ArithmeticError: not 5 nor another", 1)
    assert "tasks.py" in one.details
    assert [one.cause for one in ended([3], tasks.quit_with)] == ["SystemExit: 3"]


def test_what_a_run_prints_or_reads_is_not_taken_for_its_result() -> None:
    first, second = ended([-1, 4], tasks.talk)
    assert first.cause.startswith("EOFError")
    assert second.value == 4


def test_a_run_that_hangs_is_ended_and_others_go_on() -> None:
    found = ended([-1, 1, 2], tasks.hang_on, timeout=3.0)
    assert [one.value for one in found] == [None, 1, 2]
    assert found[0].cause == "no end after 3 s; its process was ended"
    assert found[0].attempts == 1


def test_a_run_whose_process_is_killed_is_begun_once_more(tmp_path: Path) -> None:
    (one,) = ended([tmp_path / "mark"], tasks.die_once)
    assert (one.value, one.attempts) == ("lived", 2)


def test_a_run_whose_process_dies_again_has_failed_and_says_how() -> None:
    (one,) = ended([0], tasks.die)
    assert (one.cause, one.attempts) == ("its process was ended by SIGABRT, in each of 2 attempts", 2)
    assert "out of everything" in one.details


def test_processes_end_with_their_workers(tmp_path: Path) -> None:
    mark = tmp_path / "wait"
    mark.write_text("x")
    with Workers(processes=2) as workers:
        both = workers.carry_out([tmp_path / "gone" / "wait", mark], tasks.wait_for)
        assert next(both).cause.startswith("FileNotFoundError")
        pid = process_of(mark)
    assert gone(pid)


def test_processes_end_with_the_one_that_started_them(tmp_path: Path) -> None:
    mark = tmp_path / "wait"
    mark.write_text("x")
    code = (
        "import sys; from pathlib import Path; from loi_core.runs import Workers; from tests.runs import tasks\n"
        "with Workers(processes=1) as workers: list(workers.carry_out([Path(sys.argv[1])], tasks.wait_for))"
    )
    program = subprocess.Popen([sys.executable, "-c", code, mark], cwd=ROOT)
    pid = process_of(mark)
    program.kill()
    program.wait()
    assert gone(pid)


def process_of(mark: Path) -> int:
    """Of the run that waits for this file to go."""
    for _ in range(3000):
        found = [path for path in mark.parent.iterdir() if path != mark]
        if found:
            return int(found[0].suffix[1:])
        time.sleep(0.02)
    msg = "the run has not begun within a minute"
    raise AssertionError(msg)


def gone(pid: int) -> bool:
    """Whether there is no such process, within ten seconds."""
    for _ in range(500):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":  # it has ended, and whoever inherited it has not been told yet
            return True
        time.sleep(0.02)
    return False


def test_an_executor_that_breaks_is_told_as_such(tmp_path: Path) -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        with pytest.raises(Exception, match="abruptly"):
            executor.submit(os._exit, 1).result()
        with pytest.raises(ExecutorError, match="the executor broke \\(BrokenProcessPool"):
            ended([1], tasks.double, Workers(executor))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"processes": 0}, "`processes` must be a whole number from 1 to 4096, got 0"),
        ({"processes": 1.5}, "got 1.5"),
        ({"executor": 3}, "`executor` must be a concurrent.futures.Executor, got 3"),
        ({"executor": ThreadPoolExecutor(1), "processes": 1}, "exclude each other"),
    ],
)
def test_wrong_workers_are_refused(options: dict[str, Any], says: str) -> None:
    with pytest.raises(OptionError, match=says):
        Workers(**options)


def test_what_cannot_be_sent_or_awaited_is_refused_before_anything_runs() -> None:
    with pytest.raises(OptionError, match="such as can be pickled"):
        ended([lambda: 0], tasks.double)
    for timeout in (0, -1.0, float("nan"), "1", True, 1e9):
        with pytest.raises(OptionError, match="`timeout` must be a number of seconds"):
            ended([1], tasks.double, timeout=timeout)


def test_a_record_is_of_its_very_run_or_of_none(tmp_path: Path) -> None:
    path = tmp_path / "below" / "one.json"
    assert read_record(path, "this") is None
    write_record(path, "this", {"psnr": 31.5})
    assert read_record(path, "this") == {"run": "this", "psnr": 31.5}
    assert read_record(path, "that") is None
    for damage in (b"{ cut sho", b"[1]", b"\xff", pickle.dumps({"run": "this"})):
        path.write_bytes(damage)
        assert read_record(path, "this") is None

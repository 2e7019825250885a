"""A few threads that share the tasks of a call. Kernels run without the interpreter's lock, so they run side by side.

The threads are ours and the tasks independent, so any number of callers may share them, and a caller does what they
leave to it: none waits for a thread that another keeps busy.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final, TypeVar

from loi_core.support.forking import ForkSafeLock
from loi_core.support.processors import usable_processors

if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor

__all__ = ["run_all", "thread_count"]

Local = TypeVar("Local")


def thread_count() -> int:
    """How many threads a call uses: as many as there are cores, or fewer if OMP_NUM_THREADS says so."""
    cores = usable_processors()
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(cores, int(asked))) if asked.isdecimal() else cores


class _Pool:
    """Threads that are started when they are first needed, once in every process."""

    def __init__(self) -> None:
        self._lock = ForkSafeLock()
        self._executor: ThreadPoolExecutor | None = None
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._forget)

    def start(self, work: Callable[[], None], count: int) -> list[Future[None]]:
        """Have as many threads do `work` as there are; none where the interpreter is ending, and lets none begin."""
        started: list[Future[None]] = []
        try:
            executor = self._started()
            for _ in range(count):
                started.append(executor.submit(work))  # noqa: PERF401  # the first may start, and the next not
        except RuntimeError:
            pass
        return started

    def _started(self) -> ThreadPoolExecutor:
        with self._lock:
            if self._executor is None:
                from concurrent.futures import ThreadPoolExecutor  # fails as well, where the interpreter is ending

                self._executor = ThreadPoolExecutor(max(1, thread_count() - 1), thread_name_prefix="loi")
            return self._executor

    def _forget(self) -> None:
        """A forked process has no threads but one."""
        self._executor = None


_POOL: Final = _Pool()


def run_all(tasks: Sequence[Callable[[Local], None]], local: Callable[[], Local], *, most: int | None = None) -> None:
    """Run all tasks, in any order, some at the same time.

    Parameters
    ----------
    tasks : sequence of callables
        Each is called once, with what `local` made for its thread.
    local : callable
        Makes what a thread needs to itself.
    most : int, optional
        How many threads at the most; :func:`thread_count` of them by default.
    """
    waiting = iter(tasks)
    lock = threading.Lock()

    def work() -> None:
        mine: Local | None = None
        while True:
            with lock:
                task = next(waiting, None)
            if task is None:
                return
            mine = local() if mine is None else mine
            task(mine)

    helpers = min(most or thread_count(), len(tasks)) - 1
    futures = _POOL.start(work, helpers)
    try:
        work()
    finally:
        for future in futures:
            if not future.cancel():
                future.result()

"""A pool of threads that share the tasks of a call; kernels release the interpreter's lock, so they run in parallel.

Any number of callers may share the pool. A caller runs tasks itself, so it never waits for a thread that another caller
keeps busy.
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

State = TypeVar("State")


def thread_count() -> int:
    """Return how many threads a call uses: one per core, or fewer if OMP_NUM_THREADS is smaller."""
    cores = usable_processors()
    requested = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(cores, int(requested))) if requested.isdecimal() else cores


class _Pool:
    """Threads that start when they are first needed, once per process."""

    def __init__(self) -> None:
        self._lock = ForkSafeLock()
        self._executor: ThreadPoolExecutor | None = None
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._forget)

    def start(self, work: Callable[[], None], count: int) -> list[Future[None]]:
        """Run `work` in `count` threads; in none while the interpreter shuts down, which lets no thread start."""
        started: list[Future[None]] = []
        try:
            executor = self._started()
            for _ in range(count):
                started.append(executor.submit(work))  # noqa: PERF401  # a later one may fail
        except RuntimeError:
            pass
        return started

    def _started(self) -> ThreadPoolExecutor:
        with self._lock:
            if self._executor is None:
                from concurrent.futures import ThreadPoolExecutor  # fails too during shutdown

                self._executor = ThreadPoolExecutor(max(1, thread_count() - 1), thread_name_prefix="loi")
            return self._executor

    def _forget(self) -> None:
        """Drop the pool in a forked process, which has only one thread."""
        self._executor = None


_POOL: Final = _Pool()


def run_all(
    tasks: Sequence[Callable[[State], None]], make_state: Callable[[], State], *, max_threads: int | None = None
) -> None:
    """Run all tasks, in any order, in parallel.

    Parameters
    ----------
    tasks : sequence of callables
        Each is called once, with its thread's state.
    make_state : callable
        Makes the state of a thread.
    max_threads : int, optional
        Largest number of threads; :func:`thread_count` by default.
    """
    remaining = iter(tasks)
    lock = threading.Lock()

    def work() -> None:
        state: State | None = None
        while True:
            with lock:
                task = next(remaining, None)
            if task is None:
                return
            state = make_state() if state is None else state
            task(state)

    helpers = min(max_threads or thread_count(), len(tasks)) - 1
    futures = _POOL.start(work, helpers)
    try:
        work()
    finally:
        for future in futures:
            if not future.cancel():
                future.result()

"""Parallel execution of many runs, on threads of this process or on a Dask cluster."""

from __future__ import annotations

import contextlib
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor
from queue import SimpleQueue
from types import TracebackType
from typing import Any, Final

from loi_core.errors import ExecutorError, OptionError
from loi_core.runs.dask import CONNECT_TIMEOUT_S, connect
from loi_core.runs.processes import RunResult, RunT, kill_processes, supervise
from loi_core.support.keywords import suggest_keywords
from loi_core.support.processors import usable_processors
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import described, shown

__all__ = ["Workers", "check_timeout"]

MAX_TIMEOUT_S: Final = 1e8  # three years
MAX_PROCESSES: Final = 4096


@suggest_keywords
class Workers:
    """Worker processes that execute runs in parallel; a context manager, which kills them at its end.

    A process that dies fails only the run that it was executing. Processes are reused, and each computes on one thread.
    They are spawned: a script that uses them directly needs ``if __name__ == "__main__":``.

    Parameters
    ----------
    processes : int, optional
        Number of processes; by default the number of processors.
    dask : str or cluster, optional
        A Dask cluster, or the address of its scheduler: each thread of its workers supervises one process. The
        scheduler restarts the runs of a lost worker elsewhere, a few times. The scheduler and all workers need this
        library, and the files of the runs under the same paths.

    Raises
    ------
    OptionError
        If both arguments are given, or a value is not allowed.
    ExecutorError
        If Dask is not installed, or no scheduler answers.
    """

    def __init__(self, processes: int | None = None, dask: Any = None) -> None:
        if dask is not None and processes is not None:
            msg = "`dask` and `processes` exclude each other; a cluster has its own number of workers"
            raise OptionError(msg)
        number = usable_processors() if processes is None else whole_number(processes)
        if number is None or not 1 <= number <= MAX_PROCESSES:
            msg = f"`processes` must be a whole number from 1 to {MAX_PROCESSES}, got {shown(processes)}"
            raise OptionError(msg)
        self._client: Any = None if dask is None else connect(dask)
        self._executor: Executor = (
            ThreadPoolExecutor(number, thread_name_prefix="loi-run")
            if self._client is None
            else self._client.get_executor(pure=False)
        )
        self._owner = uuid.uuid4().hex

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        kill_processes(self._owner)
        if self._client is None:
            self._executor.shutdown(cancel_futures=True)
            return
        thread = threading.Thread(target=self._kill_on_cluster, daemon=True)
        thread.start()
        thread.join(CONNECT_TIMEOUT_S)  # a suspended worker would block forever
        self._executor.shutdown(wait=False)
        self._client.close()

    def _kill_on_cluster(self) -> None:
        with contextlib.suppress(Exception):  # the cluster may have shut down
            self._client.run(kill_processes, self._owner, on_error="ignore")

    def map_unordered(
        self, function: Callable[[RunT], Any], runs: Iterable[RunT], *, timeout: float | None = None
    ) -> Iterator[RunResult[RunT]]:
        """Call a function with each run and yield the results in order of completion.

        Parameters
        ----------
        function : callable
            A function at the top level of a module, which the processes import.
        runs : iterable
            Anything that can be pickled.
        timeout : float, optional
            Time limit of a run in seconds, imports and compilation included; none by default.

        Raises
        ------
        OptionError
            If the time limit is not allowed.
        ExecutorError
            If the executor itself breaks. Runs that have not been yielded are lost.
        """
        check_timeout("timeout", timeout)
        completed: SimpleQueue[Future[RunResult[RunT]]] = SimpleQueue()
        pending: dict[Future[RunResult[RunT]], RunT] = {}
        try:
            for run in runs:
                try:
                    future = self._executor.submit(supervise, self._owner, function, run, timeout)
                except RuntimeError as error:  # broken, or shut down
                    raise _broken(error) from error
                pending[future] = run
                future.add_done_callback(completed.put)
                while not completed.empty():  # submission of many runs takes minutes, and early results must not wait
                    yield _result(completed.get(), pending)
            while pending:
                yield _result(completed.get(), pending)
        finally:
            for future in pending:
                future.cancel()


def check_timeout(name: str, timeout: object) -> None:
    """Raise :class:`OptionError` unless `timeout` is a positive number of seconds or None."""
    if timeout is not None and not 0.0 < real_number(timeout) <= MAX_TIMEOUT_S:
        msg = f"`{name}` must be a number of seconds, more than 0 and at most {MAX_TIMEOUT_S:g}, got {shown(timeout)}"
        raise OptionError(msg)


def _result(future: Future[RunResult[RunT]], pending: dict[Future[RunResult[RunT]], RunT]) -> RunResult[RunT]:
    run = pending.pop(future)
    try:
        return future.result()
    except (BrokenExecutor, CancelledError) as error:
        raise _broken(error) from error
    except Exception as error:  # noqa: BLE001 - an executor may raise anything for one of its tasks
        return RunResult(run, cause=described(error))


def _broken(error: BaseException) -> ExecutorError:
    return ExecutorError(f"the executor broke ({described(error)}); results so far are kept")

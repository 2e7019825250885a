"""Worker processes, each started, reused and killed by one supervising thread."""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import signal
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from loi_core.support.forking import ForkSafeLock
from loi_core.support.wording import described

__all__ = ["RunResult", "kill_processes", "supervise"]

# Each process computes on one thread: parallel runs use the cores better than threads within a run, and sums are the
# same wherever a run is executed.
ONE_THREAD: Final = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
MAX_TAIL_BYTES: Final = 4096  # of a dead process's output, reported with its run
RunT = TypeVar("RunT")


@dataclass(frozen=True)
class RunResult(Generic[RunT]):
    """The result of one run.

    Attributes
    ----------
    run : object
        The run itself.
    value : object
        Return value of the function; None if the run failed.
    cause : str
        Cause of the failure, on one line; empty if the run succeeded.
    details : str
        Traceback of the failure, or the last output of a process that died.
    """

    run: RunT
    value: Any = None
    cause: str = ""
    details: str = ""


def supervise(owner: str, function: Callable[[RunT], Any], run: RunT, timeout: float | None) -> RunResult[RunT]:
    """Execute one run in the worker process of this thread.

    Executors call this function. Since the run is executed in another process, executors may use threads, processes or
    a cluster, and a run that crashes harms none of their workers.

    Parameters
    ----------
    owner : str
        Identifies the processes for :func:`kill_processes`.
    function : callable
        Called with `run`.
    run : object
        Anything that can be pickled.
    timeout : float, optional
        Time limit in seconds, after which the process is killed.
    """
    thread = threading.get_ident()
    with _LOCK:
        if owner in _STOPPED:
            return RunResult(run, cause="the workers are shut down")
        if owner not in _PROCESSES:
            _PROCESSES[owner] = {}
            # A process of multiprocessing, such as a Dask worker, joins its children at exit, idle ones too.
            Finalize(None, kill_processes, (owner,), exitpriority=10)
        processes = _PROCESSES[owner]
        if thread not in processes:
            processes[thread] = _Process()
        process = processes[thread]
    result = process.execute(function, run, timeout)
    if process.killed:
        with _LOCK:
            processes.pop(thread, None)
    return result


def kill_processes(owner: str) -> None:
    """Kill all processes of an owner that this process supervises, and start no more for it."""
    with _LOCK:
        _STOPPED.add(owner)
        processes = list(_PROCESSES.pop(owner, {}).values())
    for process in processes:
        process.kill()


_LOCK: Final = ForkSafeLock()
_PROCESSES: Final[dict[str, dict[int, _Process]]] = {}  # by owner and supervising thread
_STOPPED: Final[set[str]] = set()


class _Process:
    """One worker process: a pool of size 1, so that the run that breaks the pool is known."""

    def __init__(self) -> None:
        descriptor, self._log = tempfile.mkstemp(prefix="loi-run-")
        os.close(descriptor)
        if multiprocessing.parent_process() is not None:
            multiprocessing.current_process().daemon = False  # Dask workers are daemonic, and could have no children
        spawn = multiprocessing.get_context("spawn")  # a fork would inherit locks that other threads hold
        self._pool = ProcessPoolExecutor(1, spawn, initializer=_initialise, initargs=(self._log,))
        with _inherited_settings():
            self._pid: Future[int] = self._pool.submit(os.getpid)
        self.killed = False

    def execute(self, function: Callable[[RunT], Any], run: RunT, timeout: float | None) -> RunResult[RunT]:
        """Execute one run; kill the process if it exceeds the time limit or dies."""
        try:
            return self._pool.submit(_call, self._log, function, run).result(timeout)
        except TimeoutError:
            return RunResult(run, None, f"no result after {timeout:g} s; its process was killed", self.kill())
        except BrokenProcessPool:
            return RunResult(run, None, "its process died", self.kill())
        except Exception as error:  # noqa: BLE001 - pickling calls methods of arbitrary objects
            return RunResult(run, None, described(error))

    def kill(self) -> str:
        """Kill the process and the processes that it has started; return its last output."""
        if self.killed:
            return ""
        self.killed = True
        with contextlib.suppress(BrokenProcessPool, OSError):
            pid = self._pid.result()
            if hasattr(os, "killpg"):
                os.killpg(pid, signal.SIGKILL)
            else:
                os.kill(pid, signal.SIGTERM)
        self._pool.shutdown(cancel_futures=True)
        log = Path(self._log)
        tail = log.read_bytes()[-MAX_TAIL_BYTES:].decode("utf-8", errors="replace")
        log.unlink()
        return tail


@contextlib.contextmanager
def _inherited_settings() -> Iterator[None]:
    """Settings for processes that are started inside: one thread, and no response to Ctrl-C."""
    environment = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if hasattr(signal, "pthread_sigmask") else None
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in environment.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _initialise(log: str) -> None:
    """Prepare a worker process: its output goes to a file, and it exits when its parent does."""
    if hasattr(os, "setsid"):
        os.setsid()  # a session of its own, so that all processes that a run starts can be killed with it
    output = os.open(log, os.O_WRONLY | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    faulthandler.enable()  # a crash in native code leaves a traceback in the log
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _call(log: str, function: Callable[[RunT], Any], run: RunT) -> RunResult[RunT]:
    os.truncate(log, 0)  # the output of earlier runs in this process
    try:
        return RunResult(run, function(run))
    except BaseException as error:  # noqa: BLE001 - any exception, SystemExit too, is a failure of this run alone
        return RunResult(run, None, described(error), traceback.format_exc())

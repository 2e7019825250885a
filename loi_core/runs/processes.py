"""Processes that carry out runs and can be ended; each is kept for the next run, with all that it has imported."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from typing import Final

from loi_core.runs.child import IDLE, SIZE
from loi_core.runs.reply import Reply
from loi_core.support.forking import ForkSafeLock

__all__ = ["end", "watch"]

# Each process computes on one thread: runs side by side use the cores better than threads within a run, and sums come
# out the same wherever it runs.
ONE_THREAD: Final = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
FRESH: Final = 0.8 * IDLE  # seconds for which a process is kept: less than until it ends by itself
TAIL: Final = 4096  # bytes of standard error that are told of a process that died


def watch(owner: str, payload: bytes, timeout: float | None) -> Reply:
    """Have a process carry out one run, and end it if it takes longer than `timeout` seconds.

    Executors run this. What it calls lies apart in a process, so that it makes no difference whether the executor has
    threads, processes or workers on other machines, and none of them is lost with a run.

    Parameters
    ----------
    owner : str
        Whose run it is; see :func:`end`.
    payload : bytes
        A function and its argument, pickled.
    timeout : float, optional
        In seconds.
    """
    crew = _crew(owner)
    process = crew.take()
    if process is None:
        return Reply(cause="the sweep has ended", died=True)
    try:
        reply = process.carry_out(payload, timeout)
    except BaseException:
        process.kill()
        raise
    finally:
        crew.give(process)
    return reply


def end(owner: str) -> None:
    """End all processes of this owner that were started from this process, and start no more."""
    _crew(owner).end()


class _Process:
    """One process, as seen from the one that started it."""

    def __init__(self) -> None:
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed when the process is
        path = [os.path.abspath(one) for one in sys.path]  # noqa: PTH100 - an empty one is the current folder
        code = f"import sys; sys.path[:] = {path!r}; from loi_core.runs.child import serve; serve()"
        self._process = subprocess.Popen(  # noqa: S603 - of this very Python
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env={**os.environ, **ONE_THREAD},
            start_new_session=True,  # so that Ctrl-C is ours alone to handle, and all that it starts ends with it
        )
        self._lock = threading.Lock()
        self._late = self._gone = False
        self._last_used = time.monotonic()

    @property
    def usable(self) -> bool:
        """Whether it can be given another run."""
        return not self._gone and time.monotonic() - self._last_used < FRESH and self._process.poll() is None

    def carry_out(self, payload: bytes, timeout: float | None) -> Reply:
        """One run, to its end, or that of the process."""
        assert self._process.stdin is not None and self._process.stdout is not None  # noqa: S101, PT018 - pipes
        timer = None if timeout is None else threading.Timer(timeout, self._expire)
        self._errors.seek(0)  # which the process shares: of every run only its own words are kept
        self._errors.truncate()
        if timer is not None:
            timer.daemon = True
            timer.start()
        try:
            self._process.stdin.write(SIZE.pack(len(payload)) + payload)
            self._process.stdin.flush()
            reply = pickle.load(self._process.stdout)  # noqa: S301 - of our own process
        except (OSError, EOFError, ValueError, pickle.UnpicklingError):
            self.kill()
            if self._late:
                return Reply(cause=f"no end after {timeout:g} s; its process was ended", details=self._said())
            return Reply(cause=self._ending(), details=self._said(), died=True)
        finally:
            if timer is not None:
                timer.cancel()
        self._last_used = time.monotonic()
        return reply if isinstance(reply, Reply) else Reply(cause="its process answered nonsense", died=True)

    def kill(self) -> None:
        """End it, with all that it has started."""
        with self._lock:
            if self._gone:
                return
            self._gone = True
            with contextlib.suppress(OSError):
                if hasattr(os, "killpg"):
                    os.killpg(self._process.pid, signal.SIGKILL)
                else:
                    self._process.kill()
            self._process.wait()

    def close(self) -> None:
        """Forget it, once it is ended and nobody waits for it."""
        for stream in (self._process.stdin, self._process.stdout, self._errors):
            with contextlib.suppress(OSError):
                stream.close()  # type: ignore[union-attr]  # pipes

    def _expire(self) -> None:
        self._late = True
        self.kill()

    def _ending(self) -> str:
        status = self._process.returncode
        if status is not None and status < 0:
            with contextlib.suppress(ValueError):
                return f"its process was ended by {signal.Signals(-status).name}"
        return f"its process ended with status {status}"

    def _said(self) -> str:
        with contextlib.suppress(OSError, ValueError):
            size = self._errors.seek(0, os.SEEK_END)
            self._errors.seek(max(0, size - TAIL))
            return self._errors.read(TAIL).decode("utf-8", errors="replace")
        return ""


class _Crew:
    """The processes of one owner."""

    def __init__(self) -> None:
        self._lock = ForkSafeLock()
        self._idle: list[_Process] = []
        self._busy: set[_Process] = set()
        self._ended = False

    def take(self) -> _Process | None:
        """One for a run; None if no more are to be started."""
        with self._lock:
            if self._ended:
                return None
            while self._idle:
                process = self._idle.pop()
                if process.usable:
                    break
                process.kill()
                process.close()
            else:
                process = _Process()
            self._busy.add(process)
            return process

    def give(self, process: _Process) -> None:
        """Take it back after a run, for the next one if it lives."""
        with self._lock:
            self._busy.discard(process)
            if process.usable and not self._ended:
                self._idle.append(process)
                return
        process.kill()
        process.close()

    def end(self) -> None:
        """End all; whoever waits for one is told that it died."""
        with self._lock:
            self._ended = True
            busy, idle = list(self._busy), self._idle
            self._idle = []
        for process in (*busy, *idle):
            process.kill()
        for process in idle:
            process.close()


_CREWS: Final[dict[str, _Crew]] = {}
_LOCK: Final = ForkSafeLock()


def _crew(owner: str) -> _Crew:
    with _LOCK:
        return _CREWS.setdefault(owner, _Crew())

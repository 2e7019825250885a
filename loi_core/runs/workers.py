"""Carrying out many runs over an executor, and telling how each of them ended, as it ends."""

from __future__ import annotations

import pickle
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from queue import SimpleQueue
from types import TracebackType
from typing import Any, Final, Generic, Protocol, TypeVar, runtime_checkable

from loi_core.errors import ExecutorError, OptionError
from loi_core.runs.processes import end, watch
from loi_core.runs.reply import Reply
from loi_core.support.processors import usable_processors
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import described, shown

__all__ = ["ATTEMPTS", "Ended", "Workers", "check_timeout"]

ATTEMPTS: Final = 2  # of a run whose process dies: it may have been in the way of others, or fall again by itself
MOST_SECONDS: Final = 1e8  # three years
MOST_PROCESSES: Final = 4096
Made = TypeVar("Made")


@runtime_checkable
class ReachesAll(Protocol):
    """An executor that can have something done by each of its workers."""

    def everywhere(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Call a function once in each of them."""


@dataclass(frozen=True)
class Ended(Generic[Made]):
    """A run that has ended.

    Attributes
    ----------
    run : object
        As it was given.
    value : object
        What came of it; None if it failed.
    cause : str
        Why it failed, on one line; empty if it did not.
    details : str
        Of a failure, a traceback or the last that its process said.
    attempts : int
        How often it was begun: more than once only if its process died.
    """

    run: Made
    value: Any = None
    cause: str = ""
    details: str = ""
    attempts: int = 1


class Workers:
    """Carries out runs side by side, each in a process of its own; a context manager, which ends those at its end.

    A process that dies takes nothing with it but its run, which is begun once more. One that takes too long is ended.
    It is kept for the next run, and computes on one thread.

    Parameters
    ----------
    executor : concurrent.futures.Executor, optional
        What waits for the processes and so says where they run and how many: threads, processes, or the workers of a
        cluster, see :class:`DaskExecutor`. Threads by default. It stays open.
    processes : int, optional
        How many runs go on side by side without an executor; by default as many as there are processors.

    Raises
    ------
    OptionError
        For both at once, or a number of processes that is not allowed.
    """

    def __init__(self, executor: Executor | None = None, processes: int | None = None) -> None:
        if executor is not None and processes is not None:
            msg = "`executor` and `processes` exclude each other; an executor knows how many workers it has"
            raise OptionError(msg)
        number = usable_processors() if processes is None else whole_number(processes)
        if number is None or not 1 <= number <= MOST_PROCESSES:
            msg = f"`processes` must be a whole number from 1 to {MOST_PROCESSES}, got {shown(processes)}"
            raise OptionError(msg)
        if executor is not None and not isinstance(executor, Executor):
            msg = f"`executor` must be a concurrent.futures.Executor, got {shown(executor)}"
            raise OptionError(msg)
        self._own = ThreadPoolExecutor(number, thread_name_prefix="loi-run") if executor is None else None
        self._executor: Executor = executor or self._own  # type: ignore[assignment]  # one of them is there
        self._owner = uuid.uuid4().hex

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        end(self._owner)
        if isinstance(self._executor, ReachesAll):
            self._executor.everywhere(end, self._owner)
        if self._own is not None:
            self._own.shutdown(cancel_futures=True)

    def carry_out(
        self, runs: Iterable[Made], function: Callable[[Made], Any], *, timeout: float | None = None
    ) -> Iterator[Ended[Made]]:
        """Call a function with each of the runs, and yield how each ended, in the order in which they do.

        Parameters
        ----------
        runs : iterable
            Anything that can be pickled.
        function : callable
            A function of a module, which the processes import.
        timeout : float, optional
            Seconds that a run may take, with what its process has to import; without bound by default.

        Raises
        ------
        OptionError
            For a time that is not allowed, or what cannot be pickled.
        ExecutorError
            If the executor itself breaks. Runs that have not been yielded are then not done.
        """
        check_timeout("timeout", timeout)
        ended: SimpleQueue[Future[Reply]] = SimpleQueue()
        waiting: dict[Future[Reply], tuple[Made, bytes, int]] = {}

        def begin(run: Made, payload: bytes, attempt: int) -> None:
            try:
                future = self._executor.submit(watch, self._owner, payload, timeout)
            except (BrokenExecutor, RuntimeError) as error:  # broken, or shut down
                raise _broken(error) from error
            waiting[future] = (run, payload, attempt)
            future.add_done_callback(ended.put)

        def told(future: Future[Reply]) -> Iterator[Ended[Made]]:
            """How the run of a future has ended; nothing if it is begun once more."""
            run, payload, attempt = waiting.pop(future)
            reply = _reply(future)
            if reply.died and attempt < ATTEMPTS:
                begin(run, payload, attempt + 1)
            elif reply.value is None:
                again = f", in each of {attempt} attempts" if reply.died else ""
                yield Ended(run, None, reply.cause + again, reply.details, attempt)
            else:
                yield Ended(run, pickle.loads(reply.value), attempts=attempt)  # noqa: S301 - of our own process

        try:
            for run in runs:
                begin(run, _pickled(function, run), 1)
                while not ended.empty():  # to submit many takes minutes, after which the first must not be lost
                    yield from told(ended.get())
            while waiting:
                yield from told(ended.get())
        finally:
            for future in waiting:
                future.cancel()


def check_timeout(name: str, timeout: object) -> None:
    """Raise :class:`OptionError` unless this is a time limit: a number of seconds, or None."""
    if timeout is not None and not 0.0 < real_number(timeout) <= MOST_SECONDS:
        msg = f"`{name}` must be a number of seconds, more than 0 and at most {MOST_SECONDS:g}, got {shown(timeout)}"
        raise OptionError(msg)


def _pickled(function: Callable[[Made], Any], run: Made) -> bytes:
    name = getattr(function, "__qualname__", shown(function))
    if getattr(function, "__module__", None) == "__main__":
        msg = f"{name} must be a function of a module that processes can import, not of the program that is run"
        raise OptionError(msg)
    try:
        return pickle.dumps((function, run))
    except Exception as error:  # pickling calls what objects define, and that may raise anything
        msg = f"{name} and its runs must be such as can be pickled ({described(error)})"
        raise OptionError(msg) from error


def _reply(future: Future[Reply]) -> Reply:
    """What an executor has brought; what its workers could not even begin has failed as well."""
    try:
        return future.result()
    except (BrokenExecutor, CancelledError) as error:
        raise _broken(error) from error
    except Exception as error:  # noqa: BLE001 - whatever an executor may raise for one of its tasks
        return Reply(cause=described(error))


def _broken(error: BaseException) -> ExecutorError:
    return ExecutorError(f"the executor broke ({described(error)}); what had ended is kept")

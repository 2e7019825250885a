"""What has to hold for every input, however broken, and the running of one input to see whether it does.

The result is an answer or one of our errors, said in one line; within the time and memory of the input's kind; without
a file that is half written or that nobody asked for; and nothing that lies in a file is executed.
"""

from __future__ import annotations

import contextlib
import random
import resource
import shutil
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import NoReturn

from loi_core.errors import LoiError
from loi_core.tradeoff.memory import peak_memory, restart_peak

__all__ = ["MARKER", "BrokenClaimError", "Call", "Kind", "check", "fail", "marked"]

MARKER = "executed"  # what a pickle in a file would leave beside it, were it ever loaded

Call = Callable[[], str]
"""Hands the input to the library and says what came of it."""


class BrokenClaimError(AssertionError):
    """A claim does not hold."""


def fail(finding: str) -> NoReturn:
    """Say which claim does not hold."""
    raise BrokenClaimError(finding)


class HangError(BaseException):
    """The time of an input is over; not an Exception, so that nobody takes it for damage in a file."""


@dataclass(frozen=True)
class Kind:
    """Inputs of one sort.

    Attributes
    ----------
    name : str
    make : callable
        Puts the input that a generator of random numbers draws into an empty folder; returns the call that takes it.
    weight : int
        How many inputs for each one of the kind with the fewest.
    writes : bool
        Whether the call is meant to write files.
    seconds : float
        Bound of its time, generous, since tests share their machine.
    megabytes : int
        Bound of the memory that it takes on top of what there is, for a moment at least.
    """

    name: str
    make: Callable[[random.Random, Path], Call]
    weight: int = 1
    writes: bool = False
    seconds: float = 20.0
    megabytes: int = 256


class Marked:
    """Unpickling this makes a file."""

    def __init__(self, folder: Path) -> None:
        self.marker = str(folder / MARKER)

    def __reduce__(self) -> tuple[object, ...]:
        return (open, (self.marker, "w"))


def marked(folder: Path) -> Marked:
    """An object that shows whether it has been unpickled."""
    return Marked(folder)


def check(kind: Kind, seed: int, root: Path) -> str:
    """Run one input; returns what came of it, raises :class:`BrokenClaimError` with the way to repeat it."""
    folder = root / "input"
    folder.mkdir()
    try:
        call = kind.make(random.Random(f"{kind.name} {seed}"), folder)  # noqa: S311 - nothing is secret
        before = _files(folder)
        with _within(kind), _quiet():
            try:
                outcome = call()
            except LoiError as error:
                _one_line(str(error))
                outcome = type(error).__name__
        after = _files(folder)
        if (folder / MARKER).exists():
            fail("a file was executed")
        if not kind.writes and after != before:
            fail(f"files came or went: {sorted(after ^ before)}")
        if any(Path(name).name.startswith(".") for name in after - before):
            fail(f"temporary files were left: {sorted(after - before)}")
    except Exception as error:
        error.add_note(f"kind {kind.name!r}, seed {seed}")
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return outcome


def _files(folder: Path) -> set[str]:
    return {str(one.relative_to(folder)) for one in folder.rglob("*")}


def _one_line(message: str) -> None:
    if not message.strip():
        fail("the error says nothing")
    if "Traceback" in message or len(message) > 20000:
        fail(f"the error says too much: {message[:200]}")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    if caught:
        fail(f"a warning: {caught[0].message} ({caught[0].filename}:{caught[0].lineno})")


@contextlib.contextmanager
def _within(kind: Kind) -> Iterator[None]:
    """Time and memory of one call."""

    def stop(_: int, __: FrameType | None) -> None:
        raise HangError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, kind.seconds)
    start, held, children = time.monotonic(), restart_peak(), _children()
    try:
        yield
    except HangError:
        fail(f"it takes more than {kind.seconds} s")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    peak = max(peak_memory() or 0, _children() if _children() > children else 0)
    if time.monotonic() - start > kind.seconds:
        fail(f"it takes more than {kind.seconds} s")
    if held is not None and peak - held > kind.megabytes * 2**20:
        fail(f"it takes {(peak - held) / 2**20:.0f} MiB")


def _children() -> int:
    """The most memory that a process started by this one has had, in bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss

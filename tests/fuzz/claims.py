"""Promises for every input, however broken, and a runner that checks them for one generated input.

The result is an answer or a one-line error of the library, within a time limit, without unfinished or
unexpected files, and without executing anything in a file.
"""

from __future__ import annotations

import contextlib
import random
import shutil
import signal
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import NoReturn

from loi_core.errors import LoiError

__all__ = ["BrokenPromiseError", "Call", "Kind", "Marked", "check"]

MARKER = "executed"
MAX_SECONDS = 20.0  # generous, since tests share their machine

Call = Callable[[], str]
"""Hands the input to the library and returns the kind of answer."""


class BrokenPromiseError(AssertionError):
    """A promise does not hold."""


class TimeLimitError(BaseException):  # not an Exception, so that no reader takes it for damage
    """The time for an input is over."""


@dataclass(frozen=True)
class Kind:
    """Inputs of one kind.

    Attributes
    ----------
    name : str
    make : callable
        Puts an input, drawn from a random generator, into an empty folder and returns the call that reads it.
    weight : int
        Number of inputs for each input of the kind with the fewest.
    writes : bool
        Whether the call may write files.
    """

    name: str
    make: Callable[[random.Random, Path], Call]
    weight: int = 1
    writes: bool = False


class Marked:
    """An object whose unpickling creates a marker file."""

    def __init__(self, folder: Path) -> None:
        self.marker = str(folder / MARKER)

    def __reduce__(self) -> tuple[object, ...]:
        return (open, (self.marker, "w"))


def check(inputs: Kind, seed: int, root: Path) -> str:
    """Run one input; return the kind of answer, or raise BrokenPromiseError with the seed that repeats it."""
    folder = root / "input"
    folder.mkdir()
    try:
        call = inputs.make(random.Random(f"{inputs.name} {seed}"), folder)  # noqa: S311 - nothing is secret
        files_before = _files(folder)
        with _time_limit(), warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                answer = call()
            except LoiError as error:
                message, answer = str(error), type(error).__name__
                if not message.strip() or "Traceback" in message or len(message) > 20_000:
                    _fail(f"the error is {message[:200]!r}")
        files_after = _files(folder)
        if (folder / MARKER).exists():
            _fail("a file was executed")
        if not inputs.writes and files_after != files_before:
            _fail(f"files were created or removed: {sorted(files_after ^ files_before)}")
        if any(Path(name).name.startswith(".") for name in files_after - files_before):
            _fail(f"temporary files were left: {sorted(files_after - files_before)}")
    except Exception as error:
        error.add_note(f"kind {inputs.name!r}, seed {seed}")
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return answer


def _fail(reason: str) -> NoReturn:
    raise BrokenPromiseError(reason)


def _files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


@contextlib.contextmanager
def _time_limit() -> Iterator[None]:
    def stop(_: int, __: FrameType | None) -> None:
        raise TimeLimitError

    handler = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, MAX_SECONDS)
    try:
        yield
    except TimeLimitError:
        _fail(f"the call takes more than {MAX_SECONDS} s")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, handler)

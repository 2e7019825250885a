"""What runs may do, as functions of a module that processes can import."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any


def double(number: int) -> int:
    return 2 * number


def place(_: Any) -> tuple[int, str]:
    """In which process it runs, and on how many threads."""
    return os.getpid(), os.environ["OMP_NUM_THREADS"]


def refuse(number: int) -> int:
    msg = f"not {number}\nnor another"
    raise ArithmeticError(msg)


def quit_with(status: int) -> None:
    raise SystemExit(status)


def talk(number: int) -> int:
    print("a word on standard output")
    os.system("echo and one of a program")  # noqa: S605, S607
    return number + len(input() if number < 0 else "")


def hang_on(number: int) -> int:
    """In C, without letting go of the interpreter, for a number below 0."""
    return len(str(7 ** (10**8))) if number < 0 else number


def die_once(mark: Path) -> str:
    """Killed the first time, as for lack of memory."""
    if not mark.exists():
        mark.write_text("x")
        os.kill(os.getpid(), signal.SIGKILL)
    return "lived"


def die(_: object) -> None:
    os.write(2, b"out of everything\n")
    os.abort()


def wait_for(path: Path) -> int:
    """Says who it is, and waits until the file is gone."""
    path.with_suffix(f".{os.getpid()}").write_text("x")
    while path.exists():
        time.sleep(0.02)
    return os.getpid()

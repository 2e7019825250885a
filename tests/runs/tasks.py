"""Functions for runs, in a module that worker processes can import."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any


def double(number: int) -> int:
    return 2 * number


def process_settings(_: Any) -> tuple[int, str]:
    """Return the process id and the number of threads."""
    return os.getpid(), os.environ["OMP_NUM_THREADS"]


def raise_error(number: int) -> int:
    msg = f"not {number}\nnor another"
    raise ArithmeticError(msg)


def quit_with(status: int) -> None:
    raise SystemExit(status)


def print_and_read(number: int) -> int:
    print("a word on standard output")
    os.system("echo and one of a program")  # noqa: S605, S607
    return number + len(input() if number < 0 else "")


def hang(number: int) -> int:
    """For a negative number, compute in C without releasing the interpreter."""
    return len(str(7 ** (10**8))) if number < 0 else number


def kill_process(number: int) -> int:
    """For a negative number, end the process as the system does when memory runs out."""
    if number < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def abort(_: object) -> None:
    os.write(2, b"out of everything\n")
    os.abort()


def wait_for_removal(path: Path) -> int:
    """Write the process id beside the file, and wait until the file is removed."""
    path.with_suffix(f".{os.getpid()}").write_text("x")
    while path.exists():
        time.sleep(0.02)
    return os.getpid()

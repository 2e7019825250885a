"""Exclusive use of a file or folder: a lock that ends with the process that holds it."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from loi_core.errors import InUseError
from loi_core.io.files import unwritable

__all__ = ["LOCK", "exclusive_use"]

LOCK: Final = ".loi-lock"
"""Prefix of the names of lock files."""


@contextlib.contextmanager
def exclusive_use(lock: Path, subject: Path) -> Iterator[None]:
    """Hold the lock file `lock`, so that no other fit uses `subject`, in this process or in another.

    Raises
    ------
    InUseError
        If the lock is held already.
    WriteError
        If the lock file cannot be created.
    """
    from filelock import FileLock, Timeout  # here, since most programs that import loi never lock anything

    held = FileLock(lock)
    try:
        lock.parent.mkdir(parents=True, exist_ok=True)
        with warnings.catch_warnings():
            # On file systems without flock, filelock warns at every call that the existence of the file is the lock.
            warnings.simplefilter("ignore", UserWarning)
            held.acquire(timeout=0)
    except Timeout:
        msg = f"{subject} is in use by another fit; wait until it ends, or stop it"
        raise InUseError(msg) from None
    except OSError as error:
        raise unwritable(lock, error) from error
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # Windows does not remove open files
            lock.unlink()
        held.release()

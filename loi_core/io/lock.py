"""A lock on a file that ends with the process that holds it, however that ends: nothing has to be cleared up by hand.

The operating system holds it (``flock``; on Windows ``msvcrt.locking``), so the file that is left by a process that was
killed locks nothing. On network disks it holds between machines if the disk passes locks on; where a disk refuses to
lock at all, :class:`LockWarning` says so and the work goes on.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import os
import socket
import stat
import warnings
from pathlib import Path
from types import TracebackType
from typing import Any, Final

from loi_core.errors import InUseError
from loi_core.io.files import unwritable
from loi_core.support.wording import printable

__all__ = ["LOCK", "FileLock", "LockWarning"]

LOCK: Final = ".loi-lock"
"""What the name of a lock begins with."""

HELD: Final = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)  # what systems say of a lock that somebody has
FAR: Final = 2**30  # the byte that Windows locks: beyond the text, which others are to read
MOST_OWNER: Final = 200  # bytes


def _module(name: str) -> Any:
    """A module that not every system has, or None."""
    with contextlib.suppress(ImportError):
        return importlib.import_module(name)
    return None


fcntl: Any = _module("fcntl")
msvcrt: Any = _module("msvcrt")


class LockWarning(UserWarning):
    """A disk cannot lock files: nothing keeps two processes from writing to the same place."""


class FileLock:
    """A lock, to hold in a ``with`` statement.

    Parameters
    ----------
    path : Path
        The file that is locked. It is made, and removed again, and so are the folders that it lies in.
    what : Path
        What it stands for, which the error names.
    """

    def __init__(self, path: Path, what: Path) -> None:
        self._path = path
        self._what = what
        self._handle: int | None = None
        self._made: list[Path] = []

    @property
    def held(self) -> bool:
        """Whether this has the lock."""
        return self._handle is not None

    def acquire(self) -> None:
        """Take the lock.

        Raises
        ------
        InUseError
            If somebody has it.
        WriteError
            If the file cannot be made.
        """
        try:
            self._make_folders()
            while self._handle is None:
                handle = os.open(self._path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
                try:
                    self._take(handle)
                finally:
                    if self._handle is None:
                        os.close(handle)
        except InUseError:
            raise
        except OSError as error:
            self._remove_folders()
            raise unwritable(self._path, error) from error
        _HELD.add(self)

    def release(self) -> None:
        """Give it back, and remove its file, and the folders that were made for it if they are still empty."""
        if self._handle is None:
            return
        handle, self._handle = self._handle, None
        _HELD.discard(self)
        with contextlib.suppress(OSError):  # Windows removes no file that is open
            self._path.unlink()  # before somebody else can have the lock: it is our file that goes
        os.close(handle)
        if fcntl is None:
            with contextlib.suppress(OSError):
                self._path.unlink()
        self._remove_folders()

    def forget(self) -> None:
        """Let go of it in a process that was forked: it stays with the one that took it."""
        handle, self._handle = self._handle, None
        if handle is not None:
            with contextlib.suppress(OSError):
                os.close(handle)

    def __enter__(self) -> None:
        self.acquire()

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        self.release()

    def _take(self, handle: int) -> None:
        """Lock an open file, and keep it if that is the one that lies there."""
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "not a regular file")
        try:
            _lock(handle)
        except OSError as error:
            if error.errno in HELD:
                raise self._in_use() from None
            msg = (
                f"{self._what}: this disk cannot lock files ({error.strerror}); see to it yourself that no other fit "
                "uses it"
            )
            warnings.warn(msg, LockWarning, stacklevel=5)
        if not _lies_at(self._path, handle):  # whoever had it has removed it in between
            return
        with contextlib.suppress(OSError):  # a full disk is told when something is written that matters
            os.ftruncate(handle, 0)
            os.write(handle, f"{os.getpid()} on {socket.gethostname()}\n".encode())
        self._handle = handle

    def _in_use(self) -> InUseError:
        owner = ""
        with contextlib.suppress(OSError, ValueError), self._path.open("rb") as stream:
            owner = printable(stream.read(MOST_OWNER).decode("utf-8"))
        who = f"process {owner}" if owner else "another process"
        return InUseError(f"{self._what} is in use by {who}; wait until it ends, or stop it")

    def _make_folders(self) -> None:
        missing = []
        folder = self._path.parent
        while not folder.exists():
            missing.append(folder)
            folder = folder.parent
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._made = missing

    def _remove_folders(self) -> None:
        with contextlib.suppress(OSError):  # they hold something by now
            for folder in self._made:
                folder.rmdir()
        self._made = []


def _lock(handle: int) -> None:
    """Lock an open file at once, or raise OSError."""
    if fcntl is not None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    elif msvcrt is not None:
        os.lseek(handle, FAR, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        finally:
            os.lseek(handle, 0, os.SEEK_SET)
    else:
        raise OSError(errno.ENOSYS, "no locks on this system")


def _lies_at(path: Path, handle: int) -> bool:
    try:
        return os.path.samestat(path.stat(follow_symlinks=False), os.fstat(handle))
    except FileNotFoundError:
        return False


_HELD: Final[set[FileLock]] = set()


def _forget_all() -> None:
    for lock in list(_HELD):
        lock.forget()
    _HELD.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_all)  # or a child that lives longer would hold a dead process's lock

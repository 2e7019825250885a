"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

from loi_core.errors import LoiError, OptionError, WriteError
from loi_core.support.wording import described, shown

__all__ = [
    "TEMPORARY",
    "atomic_path",
    "check_writable",
    "open_regular",
    "read_bytes",
    "remove_temporaries",
    "unwritable",
    "write_bytes",
    "write_text",
]


TEMPORARY: Final = ".loi-unfinished-"
"""What the name of a file begins with while it is written."""


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` to write to; it becomes `path` only if the block ends without an error.

    The temporary name keeps the suffix, from which libraries tell the format.

    Raises
    ------
    WriteError
        If the file system refuses any of it; `path` is as it was.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f"{TEMPORARY}{path.stem}-", suffix=path.suffix, dir=path.parent)
        temporary = Path(name)
        os.close(handle)
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes files private; these are meant to be shared
        temporary.replace(path)
    except OSError as error:
        if isinstance(error, LoiError):
            raise
        raise unwritable(path, error) from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):  # it is there no more, or nothing can be removed here any more
                temporary.unlink()


def unwritable(path: Path, error: OSError) -> WriteError:
    """The error that says which file could not be written, and why: what the system says does not always name it."""
    refused = WriteError(f"{path} could not be written: {error.strerror or described(error)}")
    refused.errno = error.errno
    return refused


def remove_temporaries(path: Path) -> None:
    """Remove what :func:`atomic_path` has left of `path` in processes that were killed while they wrote."""
    ours = re.escape(f"{TEMPORARY}{path.stem}-")
    name = re.compile(rf"{ours}[a-z0-9_]{{8}}{re.escape(path.suffix)}")  # as mkstemp names them
    with contextlib.suppress(OSError):
        for each in path.parent.iterdir():
            if name.fullmatch(each.name) and stat.S_ISREG(each.lstat().st_mode):
                each.unlink()


def check_writable(name: str, folder: Path) -> None:
    """Raise :class:`OptionError` unless files can be put into `folder`, or it can be made."""
    place = folder.absolute()
    try:
        while not _is_there(place):
            place = place.parent
    except (OSError, ValueError) as error:  # a name too long, a loop of links, a null character
        msg = f"`{name}` must lead to a folder that can be written to, got {shown(str(folder))} ({described(error)})"
        raise OptionError(msg) from None
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        why = "cannot be written to" if place.is_dir() else "is not a folder"
        msg = f"`{name}` must lead to a folder that can be written to, but {place} {why}"
        raise OptionError(msg)


def _is_there(place: Path) -> bool:
    try:
        place.lstat()  # a link that leads nowhere is there, although nothing can be put into it
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file to read; OSError for anything else: a pipe would be waited for, and a device has no end."""
    if not stat.S_ISREG(path.stat().st_mode):
        msg = "not a regular file"
        raise OSError(msg)
    return path.open("rb")


def read_bytes(path: Path, most: int) -> bytes:
    """What is in a regular file; OSError if it is missing, not one, or of more than `most` bytes."""
    with open_regular(path) as stream:
        content = stream.read(most + 1)
    if len(content) > most:
        msg = f"larger than {most} bytes"
        raise OSError(msg)
    return content


def write_bytes(path: Path, content: bytes) -> None:
    """Write `content` to `path`, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: Path, content: str) -> None:
    """Write `content` to `path` as UTF-8, whole or not at all; what has none, as in some file names, becomes `?`."""
    write_bytes(path, content.encode("utf-8", errors="replace"))

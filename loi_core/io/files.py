"""Files that are written whole or not at all, and reads of bounded size."""

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
    "finished_name",
    "open_regular",
    "read_bytes",
    "remove_temporaries",
    "unwritable",
    "write_bytes",
    "write_text",
]


TEMPORARY: Final = ".loi-unfinished-"
"""Prefix of the name of a file that is being written."""

TEMPORARY_NAME: Final = re.compile(
    rf"{re.escape(TEMPORARY)}(?P<stem>.+)-[a-z0-9_]{{8}}(?P<suffix>(?:\.[^.]*)?)", re.DOTALL
)
"""Names that `tempfile.mkstemp` makes in :func:`atomic_path`."""


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, which replaces `path` if the block ends without an error.

    The temporary name keeps the suffix, because libraries choose the format by it.

    Raises
    ------
    WriteError
        If the file system refuses the write; `path` is unchanged.
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
        temporary.chmod(0o666 & ~umask)  # mkstemp makes files private
        temporary.replace(path)
    except OSError as error:
        if isinstance(error, LoiError):
            raise
        raise unwritable(path, error) from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):  # it has been renamed, or the file system is read-only by now
                temporary.unlink()


def unwritable(path: Path, error: OSError) -> WriteError:
    """Return the error for a file that could not be written; messages of the system do not always name the file."""
    write_error = WriteError(f"{path} could not be written: {error.strerror or described(error)}")
    write_error.errno = error.errno
    return write_error


def finished_name(name: str) -> str | None:
    """Return the name of the file that a temporary file of this name becomes; None for every other file."""
    match = TEMPORARY_NAME.fullmatch(name)
    return f"{match['stem']}{match['suffix']}" if match else None


def remove_temporaries(path: Path) -> None:
    """Remove temporary files that killed processes have left of `path`."""
    with contextlib.suppress(OSError):
        for file in path.parent.iterdir():
            if finished_name(file.name) == path.name and stat.S_ISREG(file.lstat().st_mode):
                file.unlink()


def check_writable(option: str, folder: Path) -> None:
    """Raise :class:`OptionError` unless files can be written to `folder`, or it can be created."""
    existing = folder.absolute()
    try:
        while not _exists(existing):
            existing = existing.parent
    except (OSError, ValueError) as error:  # a name too long, a loop of links, a null character
        msg = f"`{option}` must lead to a folder that can be written to, got {shown(str(folder))} ({described(error)})"
        raise OptionError(msg) from None
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        reason = "cannot be written to" if existing.is_dir() else "is not a folder"
        msg = f"`{option}` must lead to a folder that can be written to, but {existing} {reason}"
        raise OptionError(msg)


def _exists(path: Path) -> bool:
    try:
        path.lstat()  # a broken link exists, although nothing can be written into it
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; OSError for anything else, since a pipe would block and a device has no end."""
    if not stat.S_ISREG(path.stat().st_mode):
        msg = "not a regular file"
        raise OSError(msg)
    return path.open("rb")


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """Return the content of a regular file; OSError if it is missing, not regular, or larger than `max_bytes`."""
    with open_regular(path) as stream:
        content = stream.read(max_bytes + 1)
    if len(content) > max_bytes:
        msg = f"larger than {max_bytes} bytes"
        raise OSError(msg)
    return content


def write_bytes(path: Path, content: bytes) -> None:
    """Write `content` to `path`, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: Path, content: str) -> None:
    """Write `content` to `path` as UTF-8, whole or not at all; lone surrogates, as in some file names, become `?`."""
    write_bytes(path, content.encode("utf-8", errors="replace"))

"""The folder that a fit writes its results to.

A marker file shows that a fit owns the folder, and lists the files that fits have written. Only listed files are ever
removed, and nothing is written or removed through a link.
"""

from __future__ import annotations

import contextlib
import json
import re
import stat
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Final

from loi_core.errors import OptionError
from loi_core.io.files import TEMPORARY, check_writable, finished_name, read_bytes, unwritable, write_text
from loi_core.io.lock import LOCK
from loi_core.support.wording import printable, shown

__all__ = [
    "CHECKPOINT_FILE",
    "FRAME_NAME",
    "HISTORY_FILE",
    "LOCK_FILE",
    "MARKER_FILE",
    "PAGE_FILE",
    "RESULT_FILE",
    "SCALES_FILE",
    "ResultFolder",
    "check_owned",
]

MARKER_FILE: Final = "loi-fit.json"
CHECKPOINT_FILE: Final = "checkpoint.npz"
LOCK_FILE: Final = LOCK
HISTORY_FILE: Final = "history.csv"
SCALES_FILE: Final = "scales.csv"
RESULT_FILE: Final = "result.json"
PAGE_FILE: Final = "report.html"
FRAME_NAME: Final = re.compile(r"[0-9]{6,}\.png")
MAX_MARKER_BYTES: Final = 2**24


def check_owned(option: str, folder: Path, marker: str) -> None:
    """Raise :class:`OptionError` unless a folder is writable, and is new, empty, or holds the marker file."""
    check_writable(option, folder)
    names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    foreign = [name for name in names if not name.startswith((TEMPORARY, LOCK))]
    if foreign and marker not in foreign:
        msg = (
            f"`{option}` must be a new or empty folder, or one with the file {marker}, which `loi` has written; "
            f"{shown(str(folder))} holds {shown(foreign[0])} and no {marker}"
        )
        raise OptionError(printable(msg))


class ResultFolder:
    """The folder of a fit's results.

    Parameters
    ----------
    path : Path
        The folder. It need not exist.

    Raises
    ------
    OptionError
        If it cannot be written to, holds files and no marker of a fit, or has a link in place of a folder of results.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        check_owned("output", path, MARKER_FILE)
        self._listed = self._read_marker()
        for name in sorted(self._listed):
            self._check_no_link(name)

    def claim(self) -> None:
        """Write the marker file, before any result."""
        if not (self.path / MARKER_FILE).exists():
            self._write_marker()

    def file(self, name: str) -> Path:
        """List a result in the marker file, and return its path.

        Raises
        ------
        OptionError
            If a folder on the way to it is a link or a file.
        """
        if name not in self._listed:
            self._check_no_link(name)
            self._listed = self._read_marker() | {name}
            self._write_marker()
        return self.path / name

    def pictures(self, folder: str) -> list[str]:
        """Return the names of the listed files in a folder of this one, sorted, relative to this folder."""
        return sorted(name for name in self._read_marker() if name.startswith(f"{folder}/"))

    def remove(self, names: Iterable[str]) -> None:
        """Remove the files with these names that are listed; files that a user has added stay."""
        self._listed = self._read_marker()
        removed = set(names) & self._listed
        for name in removed:
            path = self.path / name
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise unwritable(path, error) from error
        if removed:
            self._listed -= removed
            self._write_marker()

    def remove_unfinished(self) -> None:
        """Remove unfinished copies of listed files and of the page, left by killed fits.

        No other process may be writing here.
        """
        written = {PurePosixPath(name) for name in self._read_marker() | {MARKER_FILE, PAGE_FILE}}
        for folder in {path.parent for path in written}:
            complete = {path.name for path in written if path.parent == folder}
            with contextlib.suppress(OSError):  # the folder has not been made yet
                for file in (self.path / folder).iterdir():
                    if finished_name(file.name) in complete and stat.S_ISREG(file.lstat().st_mode):
                        file.unlink()

    def _read_marker(self) -> set[str]:
        return _listed_files(self.path / MARKER_FILE)

    def _write_marker(self) -> None:
        content = {"made by": "loi fit, which owns the files listed here", "files": sorted(self._listed)}
        write_text(self.path / MARKER_FILE, json.dumps(content, indent=1) + "\n")

    def _check_no_link(self, name: str) -> None:
        """Raise :class:`OptionError` if a folder on the way to a result is a link or a file."""
        for parent in PurePosixPath(name).parents[:-1]:
            try:
                mode = (self.path / parent).lstat().st_mode
            except FileNotFoundError:
                continue
            if not stat.S_ISDIR(mode):
                kind = "a link" if stat.S_ISLNK(mode) else "a file"
                msg = f"`output`: {self.path / parent} is {kind}; results need a folder there"
                raise OptionError(printable(msg))


def _listed_files(marker: Path) -> set[str]:
    """Return the files that a marker lists; none if it cannot be read, so that nothing is removed."""
    try:
        files = json.loads(read_bytes(marker, MAX_MARKER_BYTES))["files"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()
    return {name for name in files if isinstance(name, str) and _is_inside(name)} if isinstance(files, list) else set()


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return (
        bool(path.parts) and not path.is_absolute() and ".." not in path.parts and "\\" not in name and "\0" not in name
    )

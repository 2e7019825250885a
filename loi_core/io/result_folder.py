"""The folder that a fit writes its results to; a marker file shows that a fit owns it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from loi_core.errors import OptionError
from loi_core.io.files import TEMPORARY, check_writable, unwritable, write_text
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
        If it cannot be written to, or holds files and no marker of a fit.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        check_owned("output", path, MARKER_FILE)

    def claim(self) -> None:
        """Write the marker file, before any result."""
        if not (self.path / MARKER_FILE).exists():
            write_text(self.path / MARKER_FILE, json.dumps({"made by": "loi fit, which owns this folder"}) + "\n")

    def file(self, name: str) -> Path:
        """Return the path of a result, in a folder with the marker."""
        self.claim()
        return self.path / name

    def pictures(self, folder: str) -> list[str]:
        """Return the names of the PNG files in a folder of this one, sorted, relative to this folder."""
        return sorted(f"{folder}/{path.name}" for path in (self.path / folder).glob("*.png"))

    def remove(self, names: Iterable[str]) -> None:
        """Remove these files if they exist."""
        for name in names:
            path = self.path / name
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise unwritable(path, error) from error

    def remove_unfinished(self) -> None:
        """Remove unfinished files of killed fits; no other process may be writing here."""
        self.remove(str(path.relative_to(self.path)) for path in self.path.rglob(f"{TEMPORARY}*"))

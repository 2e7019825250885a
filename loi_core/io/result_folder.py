"""The folder that a fit writes its results to: which files there are its own, and no others are changed.

A file beside the results, ``loi-files.json``, lists what a fit has written. A folder that holds anything, but not that
list, is somebody else's and is refused. Only what is listed is ever removed, and nothing is written or removed through
a link that leads out.
"""

from __future__ import annotations

import json
import re
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from loi_core.errors import OptionError
from loi_core.io.files import TEMPORARY, check_writable, read_bytes, remove_temporaries, unwritable, write_text
from loi_core.io.lock import LOCK
from loi_core.support.wording import printable, shown

__all__ = [
    "CHECKPOINT_FILE",
    "FRAME_NAME",
    "HISTORY_FILE",
    "LIST_FILE",
    "LOCK_FILE",
    "PAGE_FILE",
    "RESULT_FILE",
    "SCALES_FILE",
    "ResultFolder",
    "is_listed",
]

LIST_FILE: Final = "loi-files.json"
CHECKPOINT_FILE: Final = "checkpoint.npz"
LOCK_FILE: Final = LOCK
HISTORY_FILE: Final = "history.csv"
SCALES_FILE: Final = "scales.csv"
RESULT_FILE: Final = "result.json"
PAGE_FILE: Final = "report.html"
FRAME_NAME: Final = re.compile(r"[0-9]{6,}\.png")
MOST_LIST: Final = 2**24  # bytes

PICTURE: Final = r"(?:initial|final|target|error)\.png"
TEXT: Final = r"(?:parameters\.json|history\.csv|scales\.csv|result\.json|report\.html)"
GRADIENT: Final = r"gradients/(?:start|end)(?:-[a-z]+-[0-9.e+-]+){3}\.png"
OWN: Final = re.compile(
    rf"(?:{PICTURE}|{TEXT}|checkpoint\.npz|frames/[0-9]{{6,}}\.png|effects/[\w -]+\.png|{GRADIENT}"
    rf"|compare/[\w-]+/(?:{PICTURE}|{TEXT}))"
)
"""What a fit may call a file. A list that says otherwise was not written by one."""


class ResultFolder:
    """A folder of results.

    Parameters
    ----------
    path : Path
        The folder. It need not be there.
    name : str
        What errors call it.

    Raises
    ------
    OptionError
        If it cannot be written to, or holds something and is not a folder of results.
    """

    def __init__(self, path: Path, *, name: str = "output") -> None:
        self.path = path
        self._name = name
        check_writable(name, path)
        self._listed = self._read_list()
        for folder in sorted({parent for file in self._listed for parent in Path(file).parents}):
            self._check_not_led_out(path / folder)

    @property
    def names(self) -> frozenset[str]:
        """What is on the list."""
        return frozenset(self._listed)

    def claim(self, files: Iterable[str]) -> None:
        """Put files on the list before they are written, so that none is ever left that is not on it."""
        new = set(files) - self._listed
        strange = next((file for file in new if not OWN.fullmatch(file)), None)
        if strange is not None:
            msg = f"{strange!r} is no name of a result"
            raise ValueError(msg)
        for file in new:
            for parent in Path(file).parents:
                self._check_not_led_out(self.path / parent)
        if new:
            self._listed |= new
            self._write_list()

    def file(self, name: str) -> Path:
        """Where a file of this name is to be written, once it is on the list."""
        self.claim([name])
        return self.path / name

    def remove(self, names: Iterable[str]) -> None:
        """Remove those of these files that are on the list, from both."""
        gone = set(names) & self._listed
        for name in gone:
            path = self.path / name
            if _is_own_file(path):
                try:
                    path.unlink()
                except OSError as error:
                    raise unwritable(path, error) from error
        if gone:
            self._listed -= gone
            self._write_list()

    def remove_unfinished(self) -> None:
        """Remove what fits that were killed have left half written; nobody else may be writing here."""
        for name in (LIST_FILE, *self._listed):
            remove_temporaries(self.path / name)

    def listed(self, folder: str) -> list[str]:
        """The files on the list that lie in a folder of this one, in order."""
        return sorted(name for name in self._listed if name.startswith(f"{folder}/"))

    def _write_list(self) -> None:
        content = {"made by": "loi fit; files that are not listed here are not touched", "files": sorted(self._listed)}
        write_text(self.path / LIST_FILE, json.dumps(content, indent=1) + "\n")

    def _read_list(self) -> set[str]:
        try:
            held = [each.name for each in self.path.iterdir()]
        except FileNotFoundError:
            return set()
        if all(name.startswith((TEMPORARY, LOCK)) for name in held):
            return set()
        try:
            content = json.loads(read_bytes(self.path / LIST_FILE, MOST_LIST))
            files = content["files"]
            if isinstance(files, list) and all(isinstance(file, str) and OWN.fullmatch(file) for file in files):
                return set(files)
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            pass
        msg = (
            f"`{self._name}` must be a new or empty folder, or one that a fit has written; {shown(str(self.path))} "
            f"holds {shown(sorted(held)[0])} and no {LIST_FILE} of a fit"
        )
        raise OptionError(printable(msg))

    def _check_not_led_out(self, folder: Path) -> None:
        """Raise :class:`OptionError` if a folder within this one is a link, or no folder at all."""
        if folder == self.path:
            return
        try:
            mode = folder.lstat().st_mode
        except FileNotFoundError:
            return
        if not stat.S_ISDIR(mode):
            what = "a link" if stat.S_ISLNK(mode) else "no folder"
            msg = f"`{self._name}`: {folder} is {what}; results are written to folders of their own only"
            raise OptionError(printable(msg))


def is_listed(file: Path) -> bool:
    """Whether a fit has put a file on the list of its folder."""
    try:
        return file.name in ResultFolder(file.parent).names
    except OptionError:
        return False


def _is_own_file(path: Path) -> bool:
    """Whether there is a regular file, and not a link to one."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except FileNotFoundError:
        return False

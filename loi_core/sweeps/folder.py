"""The result folder of a sweep: its records and run folders, locked against a second sweep."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from loi_core.io.files import write_text
from loi_core.io.lock import LOCK, exclusive_use
from loi_core.io.result_folder import check_owned
from loi_core.runs import read_record, write_record
from loi_core.sweeps.plan import SweepRun

__all__ = ["SweepFolder"]

MARKER: Final = "loi-sweep.json"
RECORDS: Final = "records"
RUNS: Final = "runs"


class SweepFolder:
    """The result folder of a sweep.

    Parameters
    ----------
    path : Path
        The folder, which need not exist.

    Raises
    ------
    OptionError
        If it is not writable, or is not empty and does not belong to a sweep.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        check_owned("output", path, MARKER)

    @property
    def runs(self) -> Path:
        """Folder of the runs; each has a folder with the files of `loi fit`."""
        return self.path / RUNS

    def read(self, run: SweepRun) -> dict[str, Any] | None:
        """Return the record of a run; None if the run is not finished."""
        return read_record(self._record_path(run), run.identity)

    def write(self, run: SweepRun, content: dict[str, Any]) -> None:
        """Write the record of a finished run."""
        write_record(self._record_path(run), run.identity, content)

    def _record_path(self, run: SweepRun) -> Path:
        return self.path / RECORDS / f"{run.name}.json"

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the folder against other processes.

        Raises
        ------
        InUseError
            If another process has locked it.
        """
        marker = self.path / MARKER
        if not marker.exists():
            write_text(marker, json.dumps({"made by": "loi sweep; the folder and all in it are its own"}) + "\n")
        with exclusive_use(self.path / LOCK, self.path):
            yield

"""The folder of a sweep: its records, its runs, and that only one sweep at a time works in it."""

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

MARK: Final = "loi-sweep.json"
RECORDS: Final = "records"
RUNS: Final = "runs"


class SweepFolder:
    """A folder of results of a sweep.

    Parameters
    ----------
    path : Path
        The folder. It need not be there.

    Raises
    ------
    OptionError
        If it cannot be written to, or holds something and is not of a sweep.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        check_owned("output", path, MARK)

    @property
    def runs(self) -> Path:
        """Holds a folder for each run, with what `loi fit` writes."""
        return self.path / RUNS

    def read(self, run: SweepRun) -> dict[str, Any] | None:
        """What is on record of a run; None if it has not ended."""
        return read_record(self._record(run), run.identity)

    def keep(self, run: SweepRun, content: dict[str, Any]) -> None:
        """Put on record how a run has ended."""
        write_record(self._record(run), run.identity, content)

    def _record(self, run: SweepRun) -> Path:
        return self.path / RECORDS / f"{run.name}.json"

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Keep others from working in it.

        Raises
        ------
        InUseError
            If somebody else does.
        """
        mark = self.path / MARK
        if not mark.exists():
            write_text(mark, json.dumps({"made by": "loi sweep; the folder and all in it are its own"}) + "\n")
        with exclusive_use(self.path / LOCK, self.path):
            yield

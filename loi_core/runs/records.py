"""Records of runs: a file for each that has ended, which says of which very run it is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from loi_core.io.files import read_bytes, write_text

__all__ = ["read_record", "write_record"]

MOST: Final = 2**26  # bytes of a record
RUN: Final = "run"


def read_record(path: Path, identity: str) -> dict[str, Any] | None:
    """What is on record of a run; None if there is no such file, or it is damaged, or is of another run.

    Parameters
    ----------
    path : Path
        The file.
    identity : str
        All that the run depends on: a change of any of it makes it another run.

    Raises
    ------
    OSError
        If there is a file that cannot be read.
    """
    try:
        record = json.loads(read_bytes(path, MOST))
    except (FileNotFoundError, ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) and record.get(RUN) == identity else None


def write_record(path: Path, identity: str, content: Mapping[str, Any]) -> None:
    """Put plain values on record for a run, whole or not at all."""
    write_text(path, json.dumps({RUN: identity, **content}) + "\n")

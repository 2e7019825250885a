"""Records of finished runs: one JSON file each, which identifies its run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from loi_core.io.files import read_bytes, write_text
from loi_core.support.keywords import suggest_keywords

__all__ = ["read_record", "write_record"]

MAX_RECORD_BYTES: Final = 2**26
RUN: Final = "run"


@suggest_keywords
def read_record(path: Path, identity: str) -> dict[str, Any] | None:
    """Return the record of a run; None if the file is missing, damaged, or belongs to another run.

    Parameters
    ----------
    path : Path
        The file.
    identity : str
        Everything that the run depends on: another identity is another run.

    Raises
    ------
    OSError
        If the file exists and cannot be read.
    """
    try:
        record = json.loads(read_bytes(path, MAX_RECORD_BYTES))
    except (FileNotFoundError, ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) and record.get(RUN) == identity else None


@suggest_keywords
def write_record(path: Path, identity: str, content: Mapping[str, Any]) -> None:
    """Write the record of a run, plain JSON values, atomically."""
    write_text(path, json.dumps({RUN: identity, **content}) + "\n")

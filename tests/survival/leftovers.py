"""The files of a fit without the times in them: equal in two folders if the fits were equal."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["different"]

SECONDS_COLUMN = 4  # of a checkpoint's history
TIMED_LINK = re.compile(r'href="data:(?:text/csv|application/json);base64,[^"]*"')  # files that are compared themselves
TIMED_CELL = re.compile(r'(<tr><td>[^<]*</td>(?:<td class="n">[^<]*</td>){2})<td class="n">[^<]*</td>')


def different(first: Path, second: Path) -> list[str]:
    """Return the names of files that differ between two folders."""
    contents = [
        {str(path.relative_to(folder)): _content(path) for path in folder.rglob("*") if path.is_file()}
        for folder in (first, second)
    ]
    names = contents[0].keys() | contents[1].keys()
    return sorted(name for name in names if contents[0].get(name) != contents[1].get(name))


def _content(path: Path) -> Any:
    if path.name == "history.csv":
        return [{**row, "seconds": ""} for row in csv.DictReader(io.StringIO(path.read_text()))]
    if path.name == "result.json":
        result = json.loads(path.read_text())
        return {**result, "output": "", "trials": [{**trial, "seconds": None} for trial in result["trials"]]}
    if path.name == "report.html":
        return TIMED_LINK.sub("", TIMED_CELL.sub(r"\1", path.read_text()))
    if path.suffix == ".npz":
        with np.load(path) as stored:
            arrays = {name: stored[name] for name in stored.files}
        arrays["history"] = np.delete(arrays["history"], SECONDS_COLUMN, axis=1)
        return {name: (value.dtype.str, value.shape, value.tobytes()) for name, value in arrays.items()}
    return path.read_bytes()

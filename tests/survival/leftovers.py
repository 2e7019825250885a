"""What a fit leaves behind, but for the time that it took: in two folders the same, if the fits were."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["different", "leftovers"]

SECONDS = 4  # the column of a checkpoint's history
# Of files that are compared themselves.
TIMED_LINK = re.compile(r'href="data:(?:text/csv|application/json);base64,[^"]*"')
TIMED = re.compile(r'(<tr><td>[^<]*</td>(?:<td class="n">[^<]*</td>){2})<td class="n">[^<]*</td>')


def leftovers(folder: Path) -> dict[str, Any]:
    """Every file by its name, as something that can be compared."""
    return {str(path.relative_to(folder)): _content(path) for path in folder.rglob("*") if path.is_file()}


def different(one: Path, other: Path) -> list[str]:
    """The files that are not the same in two folders."""
    first, second = leftovers(one), leftovers(other)
    return sorted(name for name in first.keys() | second.keys() if first.get(name) != second.get(name))


def _content(path: Path) -> Any:
    if path.name == "history.csv":
        return [{**row, "seconds": ""} for row in csv.DictReader(io.StringIO(path.read_text()))]
    if path.name == "result.json":
        told = json.loads(path.read_text())
        return {**told, "output": "", "trials": [{**trial, "seconds": None} for trial in told["trials"]]}
    if path.name == "report.html":
        return TIMED_LINK.sub("", TIMED.sub(r"\1", path.read_text()))
    if path.suffix == ".npz":
        with np.load(path) as stored:
            arrays = {name: stored[name] for name in stored.files}
        arrays["history"] = np.delete(arrays["history"], SECONDS, axis=1)
        return {name: (value.dtype.str, value.shape, value.tobytes()) for name, value in arrays.items()}
    return path.read_bytes()

"""Outcomes in a folder: a file and a picture for each run, so that nothing is done twice."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

from examples.paper.table1.run import Outcome, Run
from loi_core.io.files import write_text
from loi_core.io.images import write_png

__all__ = ["is_done", "keep", "load", "picture_path", "slug"]


def keep(folder: Path, run: Run, outcome: Outcome) -> None:
    """Write the picture, then the record, each whole or not at all: a record says that the run is done."""
    write_png(picture_path(folder, run), outcome.image)
    numbers = {field.name: getattr(outcome, field.name) for field in dataclasses.fields(Outcome)}
    del numbers["image"]
    record = {"run": _told(run), **numbers}
    write_text(_record_path(folder, run), json.dumps(record) + "\n")


def is_done(folder: Path, run: Run) -> bool:
    """Whether this very run, with these settings, is in the folder."""
    return load(folder, run) is not None


def load(folder: Path, run: Run) -> dict[str, Any] | None:
    """The numbers of a run, or None if it is not in the folder or was another."""
    try:
        record: dict[str, Any] = json.loads(_record_path(folder, run).read_text(encoding="utf-8"))
    except (FileNotFoundError, json.JSONDecodeError):
        return None
    return record if record.get("run") == _told(run) else None


def picture_path(folder: Path, run: Run) -> Path:
    """Where the final image is."""
    return _record_path(folder, run).with_suffix(".png")


def _record_path(folder: Path, run: Run) -> Path:
    parts = [run.setting.name, run.setting.method, run.column.name]
    return folder.joinpath(*map(slug, parts), f"{run.seed:03d}.json")


def slug(name: str) -> str:
    """`name` as a file's: small letters, digits and dashes."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def _told(run: Run) -> str:
    """All of what a run depends on, in words: a change of any of it makes it another run."""
    return repr(run)

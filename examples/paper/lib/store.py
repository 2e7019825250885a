"""A folder of outcomes: a record and a picture for each run, so that a finished run is not repeated."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any, Protocol

from loi_core.io.images import write_png
from loi_core.runs import read_record, write_record

__all__ = ["Run", "is_done", "keep", "load", "picture_path", "slug"]


class Run(Protocol):
    """One fit of a table. Its ``repr`` contains every setting that its outcome depends on, and identifies the run."""

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the folders that hold the record: setting, method and column."""

    @property
    def seed(self) -> int:
        """Seed of the start."""


def keep(folder: Path, run: Run, outcome: Any) -> None:
    """Write the picture, then the record, each atomically: a record marks the run as done.

    `outcome` is a dataclass of numbers and an ``image``.
    """
    write_png(picture_path(folder, run), outcome.image)
    numbers = {field.name: getattr(outcome, field.name) for field in dataclasses.fields(outcome)}
    del numbers["image"]
    write_record(_record_path(folder, run), repr(run), numbers)


def is_done(folder: Path, run: Run) -> bool:
    """Return whether the folder has a record of this run with exactly these settings."""
    return load(folder, run) is not None


def load(folder: Path, run: Run) -> dict[str, Any] | None:
    """Return the numbers of a run, or None if the folder has no record with its settings."""
    return read_record(_record_path(folder, run), repr(run))


def picture_path(folder: Path, run: Run) -> Path:
    """Return the path of the final image."""
    return _record_path(folder, run).with_suffix(".png")


def _record_path(folder: Path, run: Run) -> Path:
    return folder.joinpath(*map(slug, run.parts), f"{run.seed:03d}.json")


def slug(name: str) -> str:
    """Return `name` as a file name of small letters, digits and dashes."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")

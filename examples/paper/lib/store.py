"""Outcomes in a folder: a file and a picture for each run, so that nothing is done twice."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any, Protocol

from loi_core.io.images import write_png
from loi_core.runs import read_record, write_record

__all__ = ["Run", "is_done", "keep", "load", "picture_path", "slug"]


class Run(Protocol):
    """One fit of a table. Its ``repr`` has all that it depends on: a change of any of it makes it another run."""

    @property
    def parts(self) -> tuple[str, ...]:
        """What it is filed under: its setting, its method and its column, as names."""

    @property
    def seed(self) -> int:
        """Of its start."""


def keep(folder: Path, run: Run, outcome: Any) -> None:
    """Write the picture, then the record, each whole or not at all: a record says that the run is done.

    `outcome` is a dataclass of numbers and an ``image``.
    """
    write_png(picture_path(folder, run), outcome.image)
    numbers = {field.name: getattr(outcome, field.name) for field in dataclasses.fields(outcome)}
    del numbers["image"]
    write_record(_record_path(folder, run), repr(run), numbers)


def is_done(folder: Path, run: Run) -> bool:
    """Whether this very run, with these settings, is in the folder."""
    return load(folder, run) is not None


def load(folder: Path, run: Run) -> dict[str, Any] | None:
    """The numbers of a run, or None if it is not in the folder or was another."""
    return read_record(_record_path(folder, run), repr(run))


def picture_path(folder: Path, run: Run) -> Path:
    """Where the final image is."""
    return _record_path(folder, run).with_suffix(".png")


def _record_path(folder: Path, run: Run) -> Path:
    return folder.joinpath(*map(slug, run.parts), f"{run.seed:03d}.json")


def slug(name: str) -> str:
    """`name` as a file's: small letters, digits and dashes."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")

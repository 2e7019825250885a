"""What is known of the runs of a table: records in a folder, and figures that the table has had before."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol, TypeAlias

from examples.paper.lib.store import Run, load

__all__ = ["KEY", "Fit", "Known", "key_of", "read_figures"]

KEY: Final = ("setting", "method", "rate", "steps", "column", "seed")
"""The columns of a CSV that tell a run from the others of its table."""

Key: TypeAlias = tuple[str, ...]


class _Setting(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def method(self) -> str: ...
    @property
    def rate(self) -> float: ...


class _Column(Protocol):
    @property
    def name(self) -> str: ...


class Fit(Run, Protocol):
    """One run of a table: a setting's fit of a column, from one of its starts."""

    @property
    def setting(self) -> _Setting:
        """How it is done."""

    @property
    def column(self) -> _Column:
        """Of what."""

    @property
    def steps(self) -> int:
        """Of the whole fit."""


@dataclass(frozen=True)
class Known:
    """Where runs are looked up.

    Attributes
    ----------
    folder : Path
        Of records; see :func:`examples.paper.lib.store.keep`.
    figures : dict
        Of runs that are not in the folder, by their keys.
    columns : tuple
        Those that the figures are of. Others may share a name with one of them.
    """

    folder: Path
    figures: Mapping[Key, Mapping[str, float]] = field(default_factory=dict)
    columns: tuple[Any, ...] = ()

    def of(self, run: Fit) -> Mapping[str, Any] | None:
        """The record of a run, or the figures that are left of it; None if neither is there."""
        record = load(self.folder, run)
        return record if record is not None else self._figures(run)

    def has_figures_only(self, runs: Sequence[Fit]) -> bool:
        """Whether the pictures of some runs are gone."""
        return any(load(self.folder, run) is None and self._figures(run) is not None for run in runs)

    def _figures(self, run: Fit) -> Mapping[str, float] | None:
        return self.figures.get(key_of(run)) if run.column in self.columns else None


def key_of(run: Fit) -> Key:
    """What stands in the columns `KEY` of a CSV for a run."""
    setting = run.setting
    return tuple(map(str, (setting.name, setting.method, setting.rate, run.steps, run.column.name, run.seed)))


def read_figures(path: Path) -> dict[Key, dict[str, float]]:
    """What a CSV says of its runs; nothing if there is none."""
    if not path.is_file():
        return {}
    rows = csv.DictReader(io.StringIO(path.read_text(encoding="utf-8")))
    return {
        tuple(row[name] for name in KEY): {
            name: float(value) for name, value in row.items() if name not in KEY and value
        }
        for row in rows
    }

"""Results of a table's runs: stored records, and the figures of earlier runs that only the CSV still holds."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Generic, Protocol, TypeAlias, TypeVar

from examples.paper.lib.store import load

__all__ = ["KEY", "AnyFit", "ColumnType", "Fit", "Results", "key_of", "read_figures"]

KEY: Final = ("setting", "method", "rate", "steps", "column", "seed")
"""Columns of a CSV that identify a run within its table."""

Key: TypeAlias = tuple[str, ...]


class _Setting(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def method(self) -> str: ...
    @property
    def rate(self) -> float: ...
    @property
    def steps(self) -> int: ...


class _Column(Protocol):
    @property
    def name(self) -> str: ...


SettingType = TypeVar("SettingType", bound=_Setting)
ColumnType = TypeVar("ColumnType", bound=_Column)


@dataclass(frozen=True)
class Fit(Generic[SettingType, ColumnType]):
    """One run of a table: a fit with one setting, of one column, from the start of one seed."""

    setting: SettingType
    column: ColumnType
    seed: int

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the folders that hold the record: setting with its rate, method and column."""
        return f"{self.setting.name} {self.setting.rate:g}", self.setting.method, self.column.name

    @property
    def steps(self) -> int:
        """Number of steps of the whole fit."""
        return self.setting.steps


AnyFit: TypeAlias = Fit[Any, Any]


@dataclass(frozen=True)
class Results:
    """Results of runs: the records of a folder, then the figures of a CSV.

    Attributes
    ----------
    folder : Path
        Folder of the records, see :func:`examples.paper.lib.store.keep`.
    figures : dict
        Figures from the CSV by the key of their run; a record in the folder takes precedence.
    columns : tuple
        Columns that the figures belong to: a different column may have the same name.
    """

    folder: Path
    figures: Mapping[Key, Mapping[str, float]] = field(default_factory=dict)
    columns: tuple[Any, ...] = ()

    def of(self, run: AnyFit) -> Mapping[str, Any] | None:
        """Return the record of a run, else its figures, else None."""
        record = load(self.folder, run)
        return record if record is not None else self._figures(run)

    def has_figures_only(self, runs: Sequence[AnyFit]) -> bool:
        """Return whether a run has figures but no record, and therefore no picture."""
        return any(load(self.folder, run) is None and self._figures(run) is not None for run in runs)

    def _figures(self, run: AnyFit) -> Mapping[str, float] | None:
        return self.figures.get(key_of(run)) if run.column in self.columns else None


def key_of(run: AnyFit) -> Key:
    """Return the values of a run in the CSV columns `KEY`."""
    setting = run.setting
    return tuple(map(str, (setting.name, setting.method, setting.rate, run.steps, run.column.name, run.seed)))


def read_figures(path: Path) -> dict[Key, dict[str, float]]:
    """Return the figures of every run in a CSV by its key; an empty dictionary if there is no such file."""
    if not path.is_file():
        return {}
    rows = csv.DictReader(io.StringIO(path.read_text(encoding="utf-8")))
    return {
        tuple(row[name] for name in KEY): {
            name: float(value) for name, value in row.items() if name not in KEY and value
        }
        for row in rows
    }

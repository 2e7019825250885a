"""The table of a sweep: one row per run, as CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

from loi_core.io.files import write_text
from loi_core.report.tables import csv_text
from loi_core.sweeps.plan import Sweep, format_value

__all__ = ["CSV_FILE", "DONE", "FAILED", "MISSING", "Row", "rows_of", "write_table"]

Row: TypeAlias = Mapping[str, Any]
"""Values by column."""

CSV_FILE: Final = "sweep.csv"
DONE: Final = "done"
FAILED: Final = "failed"
MISSING: Final = "missing"
COLUMNS_BEFORE_ERRORS: Final = ("status", "objective", "verdict", "psnr", "psnr_initial", "value")
COLUMNS_AFTER_ERRORS: Final = ("best_step", "steps", "seconds", "cause")


def rows_of(sweep: Sweep, records: Mapping[str, Mapping[str, Any]]) -> list[Row]:
    """Return the rows of all runs, in order; `records` holds the records of finished runs by name."""
    errors = sorted({name for record in records.values() for name in record.get("errors") or {}})
    rows: list[Row] = []
    for run in sweep.runs:
        record = records.get(run.name, {})
        row: dict[str, Any] = {"run": run.name, "scene": run.label, **run.varied}
        row |= {name: record.get(name) for name in COLUMNS_BEFORE_ERRORS}
        row["status"] = MISSING if not record else FAILED if record.get("cause") else DONE
        row |= {f"error.{name}": (record.get("errors") or {}).get(name) for name in errors}
        row |= {name: record.get(name) for name in COLUMNS_AFTER_ERRORS}
        rows.append(row)
    return rows


def write_table(folder: Path, rows: Sequence[Row]) -> Path:
    """Write ``sweep.csv`` and return its path."""
    path = folder / CSV_FILE
    write_text(path, csv_text(list(rows[0]), ([_cell(value) for value in row.values()] for row in rows)))
    return path


def _cell(value: object) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else format_value(value)

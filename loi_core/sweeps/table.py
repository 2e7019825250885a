"""The table of a sweep: one row per run, as CSV and as Parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

from loi_core.io.files import atomic_path, write_text
from loi_core.report.tables import csv_text
from loi_core.sweeps.plan import Sweep, format_value

__all__ = ["CSV_FILE", "DONE", "FAILED", "MISSING", "PARQUET_FILE", "Row", "rows_of", "write_table"]

Row: TypeAlias = Mapping[str, Any]
"""Values by column."""

CSV_FILE: Final = "sweep.csv"
PARQUET_FILE: Final = "sweep.parquet"
DONE: Final = "done"
FAILED: Final = "failed"
MISSING: Final = "missing"
NUMBERS: Final = ("psnr", "psnr_initial", "value", "best_step", "steps", "seconds")
COLUMNS_BEFORE_ERRORS: Final = ("status", "objective", "verdict", "psnr", "psnr_initial", "value")
COLUMNS_AFTER_ERRORS: Final = ("best_step", "steps", "seconds", "cause")
TEXTS: Final = ("run", "scene", "status", "objective", "verdict", "cause")


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
    """Write ``sweep.csv``, and ``sweep.parquet`` if pyarrow is installed; return the path of the CSV file."""
    path = folder / CSV_FILE
    write_text(path, csv_text(list(rows[0]), ([_cell(value) for value in row.values()] for row in rows)))
    _write_parquet(folder / PARQUET_FILE, rows)
    return path


def _cell(value: object) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else format_value(value)


def _write_parquet(path: Path, rows: Sequence[Row]) -> None:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ModuleNotFoundError:
        return
    columns = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        if _is_numeric(name, values):
            columns[name] = pa.array([None if value is None else float(value) for value in values], pa.float64())
        else:
            columns[name] = pa.array([None if value is None else format_value(value) for value in values], pa.string())
    with atomic_path(path) as temporary:
        parquet.write_table(pa.table(columns), temporary)


def _is_numeric(name: str, values: Sequence[Any]) -> bool:
    if name in NUMBERS or name.startswith("error."):
        return True
    return name not in TEXTS and all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)

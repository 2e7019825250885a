"""The table of a sweep: a row for each run, as CSV and as Parquet."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

from loi_core.io.files import atomic_path, write_text
from loi_core.sweeps.plan import Sweep, spelled

__all__ = ["CSV_FILE", "DONE", "FAILED", "MISSING", "PARQUET_FILE", "Row", "rows_of", "write_table"]

Row: TypeAlias = Mapping[str, Any]
"""Values by column."""

CSV_FILE: Final = "sweep.csv"
PARQUET_FILE: Final = "sweep.parquet"
DONE: Final = "done"
FAILED: Final = "failed"
MISSING: Final = "missing"
BEFORE: Final = ("run", "scene")
MEASURES: Final = ("status", "objective", "verdict", "psnr", "psnr_initial", "value")
AFTER: Final = ("best_step", "steps", "seconds", "attempts", "cause")
NUMBERS: Final = ("psnr", "psnr_initial", "value", "best_step", "steps", "seconds", "attempts")


def rows_of(sweep: Sweep, records: Mapping[str, Mapping[str, Any]]) -> list[Row]:
    """The rows of all runs, in order; `records` are those of runs that have ended, by name."""
    errors = sorted({name for record in records.values() for name in record.get("errors") or {}})
    rows: list[Row] = []
    for run in sweep.runs:
        record = records.get(run.name)
        row: dict[str, Any] = {"run": run.name, "scene": run.label, **run.varied}
        measured = record or {}
        row |= {name: measured.get(name) for name in MEASURES}
        row["status"] = MISSING if record is None else FAILED if record.get("cause") else DONE
        row |= {f"error.{name}": (measured.get("errors") or {}).get(name) for name in errors}
        row |= {name: measured.get(name) for name in AFTER}
        rows.append(row)
    return rows


def write_table(folder: Path, rows: Sequence[Row]) -> Path:
    """Write ``sweep.csv``, and ``sweep.parquet`` where pyarrow is installed; the path of the first."""
    path = folder / CSV_FILE
    write_text(path, _csv(rows))
    _write_parquet(folder / PARQUET_FILE, rows)
    return path


def _csv(rows: Sequence[Row]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(rows[0])
    writer.writerows([_cell(value) for value in row.values()] for row in rows)
    return stream.getvalue()


def _cell(value: object) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else spelled(value)


def _write_parquet(path: Path, rows: Sequence[Row]) -> None:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ModuleNotFoundError:
        return
    columns = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        if _is_number(name, values):
            columns[name] = pa.array([None if one is None else float(one) for one in values], pa.float64())
        else:
            columns[name] = pa.array([None if one is None else spelled(one) for one in values], pa.string())
    with atomic_path(path) as temporary:
        parquet.write_table(pa.table(columns), temporary)


def _is_number(name: str, values: Sequence[Any]) -> bool:
    if name in NUMBERS or name.startswith("error."):
        return True
    return name not in (*BEFORE, *MEASURES, *AFTER) and all(
        isinstance(one, int | float) and not isinstance(one, bool) for one in values
    )

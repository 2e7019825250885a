"""The tables of a result folder as columns of numbers, whatever program wrote them."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from loi_core.support.values import parsed_number

__all__ = ["SCALE_COLUMNS", "ScaleRows", "csv_text", "read_columns", "read_scale_rows"]

SCALE_COLUMNS: Final = ("step", "sigma", "alpha", "beta", "value")
MAX_COLUMNS: Final = 128
MAX_NAME_LENGTH: Final = 200

ScaleRows = Mapping[tuple[float, float, float], Mapping[int, float]]
"""The value of each scale (sigma, alpha, beta) by step."""


def csv_text(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a CSV file with a line of column names."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    return stream.getvalue()


def read_columns(text: str) -> dict[str, list[float]]:
    """Read a CSV file with a line of names as columns; text that is not a number becomes NaN.

    Returns
    -------
    dict
        Empty if the text is not such a file.
    """
    rows = csv.reader(io.StringIO(text))
    try:
        names = [name[:MAX_NAME_LENGTH] for name in next(rows, [])][:MAX_COLUMNS]
        columns: dict[str, list[float]] = {name: [] for name in names}
        if len(columns) != len(names):
            return {}
        for row in rows:
            for index, name in enumerate(names):
                columns[name].append(parsed_number(row[index]) if index < len(row) else math.nan)
    except csv.Error:
        return {}
    return columns


def read_scale_rows(text: str) -> ScaleRows:
    """Read ``scales.csv``; rows with a field that is not finite are left out."""
    columns = read_columns(text)
    if not set(SCALE_COLUMNS) <= set(columns):
        return {}
    values: dict[tuple[float, float, float], dict[int, float]] = {}
    for step, sigma, alpha, beta, value in zip(*(columns[name] for name in SCALE_COLUMNS), strict=True):
        if all(map(math.isfinite, (step, sigma, alpha, beta, value))):
            values.setdefault((sigma, alpha, beta), {})[int(step)] = value
    return values

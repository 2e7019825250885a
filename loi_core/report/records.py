"""The tables of a result folder as columns of numbers, whoever wrote them."""

from __future__ import annotations

import csv
import io
import math
from typing import Final

from loi_core.report.scales import COLUMNS

__all__ = ["ScaleRows", "number", "read_columns", "read_scale_rows"]

MOST_COLUMNS: Final = 128
LONGEST_NAME: Final = 200

ScaleRows = dict[tuple[float, float, float], dict[int, float]]
"""By (sigma, alpha, beta), step to value."""


def read_columns(text: str) -> dict[str, list[float]]:
    """A CSV file with a line of names as columns; what is no number is NaN. Empty if it is no such file."""
    rows = csv.reader(io.StringIO(text))
    try:
        names = [name[:LONGEST_NAME] for name in next(rows, [])][:MOST_COLUMNS]
        columns: dict[str, list[float]] = {name: [] for name in names}
        if len(columns) != len(names):
            return {}
        for row in rows:
            for index, name in enumerate(names):
                columns[name].append(number(row[index]) if index < len(row) else math.nan)
    except csv.Error:
        return {}
    return columns


def read_scale_rows(text: str) -> ScaleRows:
    """``scales.csv``; rows that are none are left out."""
    columns = read_columns(text)
    if not set(COLUMNS) <= set(columns):
        return {}
    found: ScaleRows = {}
    for step, sigma, alpha, beta, value in zip(*(columns[name] for name in COLUMNS), strict=True):
        if all(map(math.isfinite, (step, sigma, alpha, beta, value))):
            found.setdefault((sigma, alpha, beta), {})[int(step)] = value
    return found


def number(text: str) -> float:
    """The number that a text says; NaN if it says none."""
    try:
        return float(text)
    except ValueError:
        return math.nan

"""Ranking of settings: runs that differ only in seed and start are averaged."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from loi_core.sweeps.plan import REPEATS, Sweep, format_value
from loi_core.sweeps.table import DONE, FAILED, Row

__all__ = ["Standing", "standings_of"]


@dataclass(frozen=True)
class Standing:
    """The result of one setting over its seeds and starts.

    Attributes
    ----------
    setting : dict of str
        Values of the varied keys, as text; and the scene, if the sweep has several.
    rows : tuple of dict
        Rows of its runs.
    mean, worst : float
        Mean and worst value of the ranking measure over finished runs; NaN without any.
    best : dict or None
        Row of the best run.
    converged : int
        Number of runs whose verdict is "converged".
    """

    setting: Mapping[str, str]
    rows: tuple[Row, ...]
    mean: float
    worst: float
    best: Row | None
    converged: int

    @property
    def done(self) -> int:
        """Number of finished runs."""
        return sum(row["status"] == DONE for row in self.rows)

    @property
    def failed(self) -> int:
        """Number of failed runs."""
        return sum(row["status"] == FAILED for row in self.rows)

    @property
    def name(self) -> str:
        """The setting as text."""
        return ", ".join(f"{key} = {value}" for key, value in self.setting.items()) or "as in the file"


def standings_of(sweep: Sweep, rows: Sequence[Row]) -> tuple[Standing, ...]:
    """Return the standings of all settings, best first: PSNR descends, every other measure ascends."""
    keys = [key for key in sweep.runs[0].varied if key not in REPEATS]
    if len(sweep.scenes) > 1:
        keys.insert(0, "scene")
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(format_value(row[key]) for key in keys), []).append(row)
    standings = [_standing(dict(zip(keys, values, strict=True)), group, sweep.rank) for values, group in groups.items()]
    sign = _sign(sweep.rank)
    return tuple(sorted(standings, key=lambda row: math.inf if math.isnan(row.mean) else sign * row.mean))


def _standing(setting: Mapping[str, str], rows: Sequence[Row], rank: str) -> Standing:
    measured = (row for row in rows if row["status"] == DONE and _is_measured(row.get(rank)))
    done = sorted(measured, key=lambda row: _sign(rank) * float(row[rank]))
    if not done:
        return Standing(setting, tuple(rows), math.nan, math.nan, None, 0)
    values = [float(row[rank]) for row in done]
    converged = sum(row["verdict"] == "converged" for row in done)
    return Standing(setting, tuple(rows), sum(values) / len(values), values[-1], done[0], converged)


def _is_measured(value: Any) -> bool:
    return isinstance(value, int | float) and not math.isnan(value)


def _sign(rank: str) -> float:
    """Return 1 if smaller values of a measure are better, otherwise -1."""
    return -1.0 if rank == "psnr" else 1.0

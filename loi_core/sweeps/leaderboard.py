"""Which setting did best: runs that differ in seed and start alone, taken together and ranked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from loi_core.sweeps.plan import REPEATS, Sweep, spelled
from loi_core.sweeps.table import DONE, FAILED, Row

__all__ = ["Standing", "standings_of"]


@dataclass(frozen=True)
class Standing:
    """How one setting did, over its seeds and starts.

    Attributes
    ----------
    setting : dict of str
        What it has of all that varies, as it is spelled; the scene too, if there are several.
    rows : tuple of dict
        Its runs.
    mean, worst : float
        Of the measure that ranks, over the runs that are done; NaN if none is.
    best : dict or None
        The best of those runs.
    converged : int
        How many of them found their target, by their own verdict.
    """

    setting: Mapping[str, str]
    rows: tuple[Row, ...]
    mean: float
    worst: float
    best: Row | None
    converged: int

    @property
    def done(self) -> int:
        """How many of its runs are done."""
        return sum(row["status"] == DONE for row in self.rows)

    @property
    def failed(self) -> int:
        """How many of them have failed."""
        return sum(row["status"] == FAILED for row in self.rows)

    @property
    def name(self) -> str:
        """The setting in words."""
        return ", ".join(f"{key} = {value}" for key, value in self.setting.items()) or "as in the file"


def standings_of(sweep: Sweep, rows: Sequence[Row]) -> tuple[Standing, ...]:
    """All settings, the best first: by PSNR the largest, by all else the smallest mean."""
    keys = [key for key in sweep.runs[0].varied if key not in REPEATS]
    if len(sweep.scenes) > 1:
        keys.insert(0, "scene")
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(spelled(row[key]) for key in keys), []).append(row)
    found = [_standing(dict(zip(keys, values, strict=True)), some, sweep.rank) for values, some in groups.items()]
    return tuple(sorted(found, key=lambda one: math.inf if math.isnan(one.mean) else _sign(sweep.rank) * one.mean))


def _standing(setting: Mapping[str, str], rows: Sequence[Row], rank: str) -> Standing:
    def badness(row: Row) -> float:
        return _sign(rank) * float(row[rank])

    done = sorted((row for row in rows if row["status"] == DONE and _is_measured(row.get(rank))), key=badness)
    if not done:
        return Standing(setting, tuple(rows), math.nan, math.nan, None, 0)
    values = [float(row[rank]) for row in done]
    converged = sum(row["verdict"] == "converged" for row in done)
    return Standing(setting, tuple(rows), sum(values) / len(values), values[-1], done[0], converged)


def _is_measured(value: Any) -> bool:
    return isinstance(value, int | float) and not math.isnan(value)


def _sign(rank: str) -> float:
    return -1.0 if rank == "psnr" else 1.0

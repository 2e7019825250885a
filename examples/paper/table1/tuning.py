"""Search for the learning rate of each method, on seeds outside the table."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from examples.paper.table1.problem import COLUMNS
from examples.paper.table1.run import Run
from examples.paper.table1.settings import OURS, Method

__all__ = ["RATES", "tuning_runs"]

RATES: Final = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
SEEDS: Final = (100, 101)
SEARCH_COLUMNS: Final = (COLUMNS[1], COLUMNS[3], COLUMNS[4])  # 16, 64 and 256 disks


def tuning_runs(method: Method) -> list[Run]:
    """Return the runs of a method at every rate."""
    return [
        Run(replace(OURS[method], name=f"rate {rate:g}", rate=rate), column, seed)
        for rate in RATES
        for column in SEARCH_COLUMNS
        for seed in SEEDS
    ]

"""The search for each method's learning rate, on seeds that the table does not use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from examples.paper.store import load
from examples.paper.table1.problem import COLUMNS
from examples.paper.table1.run import Run
from examples.paper.table1.settings import OURS, Method
from loi_core.support.markdown import markdown

__all__ = ["tuning_runs", "tuning_table"]

RATES: Final = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
SEEDS: Final = (100, 101)
SEEN: Final = (COLUMNS[1], COLUMNS[3], COLUMNS[4])  # 16, 64 and 256 disks


def tuning_runs(method: Method) -> list[Run]:
    """Every rate for a method."""
    return [
        Run(replace(OURS[method], name=f"rate {rate:g}", rate=rate), column, seed)
        for rate in RATES
        for column in SEEN
        for seed in SEEDS
    ]


def tuning_table(folder: Path, rows: Mapping[str, Sequence[Run]]) -> list[str]:
    """Mean PSNR of each rate, the best of each method in bold; only of methods and rates of which all runs are done."""
    table = []
    for name, runs in rows.items():
        means = [_mean(folder, [run for run in runs if run.setting.rate == rate]) for rate in RATES]
        best = max((one for one in means if one is not None), default=None)
        if best is not None:
            cells = ["" if one is None else f"**{one:.2f}**" if one == best else f"{one:.2f}" for one in means]
            table.append([name, *cells])
    return markdown(["pixels a step", *(f"{rate:g}" for rate in RATES)], table)


def _mean(folder: Path, runs: Sequence[Run]) -> float | None:
    found = [record["psnr"] for record in (load(folder, run) for run in runs) if record is not None]
    return float(np.mean(found)) if len(found) == len(runs) else None

"""Time per step, and time until a fit stays near its target."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from examples.paper.lib.results import Results
from examples.paper.lib.study import Subtable
from examples.paper.table2.run import Run
from loi_core.support.markdown import markdown

__all__ = ["cost_of"]


def cost_of(results: Results, subtable: Subtable[Run]) -> list[str]:
    """Return a table of median seconds per step, and until a run stays near its target, over the runs that arrive."""
    rows = [
        [name, *(_cell(results, [run for run in runs if run.column == column]) for column in subtable.columns)]
        for name, runs in subtable.rows.items()
    ]
    return markdown(["seconds a step / to an error of 0.05", *(column.name for column in subtable.columns)], rows)


def _cell(results: Results, runs: Sequence[Run]) -> str:
    records = [record for run in runs if "step" in (record := results.of(run) or {})]
    if not records:
        return ""
    step = np.median([record["step"] for record in records])
    arrivals = [record["near"] for record in records if math.isfinite(record["near"])]
    arrival = f"{np.median(arrivals):.0f}" if arrivals else "never"
    return f"{step:.2f} / {arrival}, {len(arrivals)} of {len(records)}"

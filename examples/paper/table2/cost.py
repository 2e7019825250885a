"""What a step costs, and how long it takes to come near."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from examples.paper.lib.results import Results
from examples.paper.lib.study import Subtable
from examples.paper.table2.problem import Column
from examples.paper.table2.run import Run
from loi_core.support.markdown import markdown

__all__ = ["cost_of"]


def cost_of(results: Results, part: Subtable[Run]) -> list[str]:
    """Seconds a step, and until a run is near its target for good: medians over the starts that come so near."""
    rows = [
        [name, *(_cell(results, [run for run in runs if run.column == column]) for column in part.columns)]
        for name, runs in part.rows.items()
    ]
    return markdown(["seconds a step / to an error of 0.05", *map(_title, part.columns)], rows)


def _cell(results: Results, runs: Sequence[Run]) -> str:
    records = [record for run in runs if "step" in (record := results.of(run) or {})]
    if not records:
        return ""
    step = np.median([record["step"] for record in records])
    near = [record["near"] for record in records if math.isfinite(record["near"])]
    arrived = f"{np.median(near):.0f}" if near else "never"
    return f"{step:.2f} / {arrived}, {len(near)} of {len(records)}"


def _title(column: Column) -> str:
    return column.name

"""What a step costs, and how long it takes to come near."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from examples.paper.store import load
from examples.paper.study import Part
from examples.paper.table2.problem import Column
from examples.paper.table2.run import Run
from loi_core.support.markdown import markdown

__all__ = ["NEAR", "cost_of"]

NEAR: Final = 0.05  # units of the scene, mean over the parameters


def cost_of(folder: Path, part: Part[Run]) -> list[str]:
    """Seconds a step, and until the mean error is below `NEAR` for good: medians over the starts that come so near."""
    rows = [
        [name, *(_cell(folder, [run for run in runs if run.column == column]) for column in part.columns)]
        for name, runs in part.rows.items()
    ]
    return markdown(["seconds a step / to an error of 0.05", *map(_title, part.columns)], rows)


def _cell(folder: Path, runs: Sequence[Run]) -> str:
    done = [(run, record) for run in runs if (record := load(folder, run)) is not None]
    if not done:
        return ""
    records = [record for _, record in done]
    step = np.median([(record["seconds"] - record["setup"]) / (run.steps - 1) for run, record in done])
    near = [seconds for one in records if (seconds := _arrival(one)) is not None]
    arrived = f"{np.median(near):.0f}" if near else "never"
    return f"{step:.2f} / {arrived}, {len(near)} of {len(records)}"


def _arrival(record: Mapping[str, Any]) -> float | None:
    """When the error was below the bound and stayed there; None if it never did."""
    far = [place for place, error in enumerate(record["errors"]) if error >= NEAR]
    first = far[-1] + 1 if far else 0
    return float(record["clock"][first]) if first < len(record["clock"]) else None


def _title(column: Column) -> str:
    return column.name

"""What the runs came to, as Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from examples.paper.means import Mean
from examples.paper.store import load
from examples.paper.table3.problem import COLUMNS, Column
from examples.paper.table3.published import PAPER
from examples.paper.table3.run import Run
from loi_core.support.markdown import markdown

__all__ = ["csv_of", "table_of", "tuning_table"]

FIELDS = ("setting", "method", "rate", "steps", "column", "seed", "psnr", "ssim", "mae", "seconds")


def csv_of(folder: Path, runs: Sequence[Run]) -> str:
    """A line for each run that is done."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, FIELDS, lineterminator="\n")
    writer.writeheader()
    for run in runs:
        record = load(folder, run)
        if record is not None:
            setting = run.setting
            row: dict[str, Any] = {
                "setting": setting.name,
                "method": setting.method,
                "rate": setting.rate,
                "steps": setting.steps,
            }
            row |= {"column": run.column.name, "seed": run.seed}
            row |= {name: f"{record[name]:.4f}" for name in ("psnr", "ssim", "mae")}
            writer.writerow(row | {"seconds": f"{record['seconds']:.1f}"})
    return stream.getvalue()


def table_of(folder: Path, rows: Mapping[str, Sequence[Run]], columns: Sequence[Column]) -> list[str]:
    """PSNR with its interval and the least of all seeds, and MAE or SSIM; the paper's figures beneath."""
    table = []
    for name, runs in rows.items():
        table.append([name, *(_cell(folder, [run for run in runs if run.column == at], at) for at in columns)])
        if name in PAPER and tuple(columns) == COLUMNS:
            table.append(["&nbsp;&nbsp;the paper's", *(f"{psnr:.2f} / {other:.2f}" for psnr, other in PAPER[name])])
    return markdown(["", *(f"{column.name}, {column.error}" for column in columns)], table)


def tuning_table(folder: Path, rows: Mapping[str, Sequence[Run]], rates: Sequence[float]) -> list[str]:
    """Mean PSNR over all columns at each rate, the best of each method in bold."""
    table = []
    for name, runs in rows.items():
        means = []
        for rate in rates:
            own = [run for run in runs if run.setting.rate == rate]
            found = [record["psnr"] for run in own if (record := load(folder, run)) is not None]
            means.append(sum(found) / len(found) if own and len(found) == len(own) else None)
        best = max((one for one in means if one is not None), default=None)
        if best is not None:
            table.append(
                [name, *("" if one is None else f"**{one:.2f}**" if one == best else f"{one:.2f}" for one in means)]
            )
    return markdown(["pixels a step", *(f"{rate:g}" for rate in rates)], table)


def _cell(folder: Path, runs: Sequence[Run], column: Column) -> str:
    records = [record for run in runs if (record := load(folder, run)) is not None]
    if not records:
        return ""
    psnr = Mean.of([record["psnr"] for record in records])
    other = Mean.of([record[column.error.lower()] for record in records])
    spread = "" if psnr.count == 1 else f" ± {psnr.half:.1f} (least {psnr.least:.1f})"
    missing = "" if len(records) == len(runs) else f", {len(records)} of {len(runs)} seeds"
    return f"{psnr.value:.2f}{spread} / {other.value:.3f}{missing}"

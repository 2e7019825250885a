"""What the runs came to, as Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from examples.paper.means import Mean
from examples.paper.store import load
from examples.paper.table1.problem import COLUMNS, Column
from examples.paper.table1.published import PAPER
from examples.paper.table1.run import Run
from loi_core.support.markdown import markdown

__all__ = ["csv_of", "table_of"]

FIELDS = ("setting", "method", "rate", "steps", "column", "seed", "psnr", "ssim", "found", "seconds")


def csv_of(folder: Path, runs: Sequence[Run]) -> str:
    """A line for each run that is done."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, FIELDS, lineterminator="\n")
    writer.writeheader()
    for run in runs:
        record = load(folder, run)
        if record is not None:
            setting = run.setting
            row = {
                "setting": setting.name,
                "method": setting.method,
                "rate": setting.rate,
                "steps": sum(stage.steps for stage in setting.stages),
                "column": run.column.name,
                "seed": run.seed,
            }
            row |= {name: f"{record[name]:.4f}" for name in ("psnr", "ssim", "found")}
            writer.writerow(row | {"seconds": f"{record['seconds']:.1f}"})
    return stream.getvalue()


def table_of(folder: Path, rows: Mapping[str, Sequence[Run]], columns: Sequence[Column]) -> list[str]:
    """PSNR with its interval, the least of all seeds, and SSIM, row by row; the paper's figures beneath."""
    table = []
    for name, runs in rows.items():
        table.append([name, *(_cell(folder, [run for run in runs if run.column == at]) for at in columns)])
        if name in PAPER and tuple(columns) == COLUMNS:
            table.append(["&nbsp;&nbsp;the paper's", *(f"{psnr:.2f} / {ssim:.2f}" for psnr, ssim in PAPER[name])])
    return markdown(["disks", *(column.name for column in columns)], table)


def _cell(folder: Path, runs: Sequence[Run]) -> str:
    records = [record for run in runs if (record := load(folder, run)) is not None]
    if not records:
        return ""
    psnr = Mean.of([record["psnr"] for record in records])
    ssim = Mean.of([record["ssim"] for record in records])
    spread = "" if psnr.count == 1 else f" ± {psnr.half:.1f} (least {psnr.least:.1f})"
    missing = "" if len(records) == len(runs) else f", {len(records)} of {len(runs)} seeds"
    return f"{psnr.value:.2f}{spread} / {ssim.value:.3f}{missing}"

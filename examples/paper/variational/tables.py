"""What the runs came to, as Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Final

from examples.paper.lib.means import Mean
from examples.paper.lib.store import load
from examples.paper.variational.run import Run
from loi_core.support.markdown import markdown

__all__ = ["csv_of", "kept_lines", "search_table", "starts_table", "summary"]

FEW: Final = 4  # runs, of which an interval says nothing
COLUMNS: Final = ("method", "rate", "sigma", "final", "side", "samples", "steps", "seed")  # that tell runs apart


def csv_of(folder: Path, runs: Sequence[Run], groups: Sequence[str]) -> str:
    """A line for each run that is done; `groups` name its errors."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*COLUMNS, "found", "psnr", *groups, "seconds"])
    for run in runs:
        record = load(folder, run)
        if record is not None:
            setting, size = run.setting, run.size
            how = [setting.method, setting.rate, setting.sigma, setting.final, size.side, size.samples, size.steps]
            errors = [f"{error:.4f}" for error in record["errors"]]
            found = [run.seed, record["found"], f"{record['psnr']:.3f}"]
            writer.writerow([*how, *found, *errors, f"{record['seconds']:.3f}"])
    return stream.getvalue()


def kept_lines(numbers: str, before: Path) -> str:
    """A CSV of :func:`csv_of`, and the lines of the one `before`, if there is one, of runs that it has not."""
    if not before.is_file():
        return numbers
    known = {_run_of(line) for line in numbers.splitlines()}
    others = [line for line in before.read_text(encoding="utf-8").splitlines() if _run_of(line) not in known]
    return numbers + "".join(f"{line}\n" for line in others)


def _run_of(line: str) -> tuple[str, ...]:
    return tuple(line.split(",")[: len(COLUMNS)])


def summary(folder: Path, rows: Mapping[str, Sequence[Run]], groups: Sequence[str]) -> list[str]:
    """A line for each method: how many starts it finds, and means over all of them."""
    table = []
    for name, runs in rows.items():
        records = [record for run in runs if (record := load(folder, run)) is not None]
        if not records:
            continue
        setting = runs[0].setting
        psnr = Mean.of([record["psnr"] for record in records])
        errors = [
            " / ".join(f"{fold([record['errors'][k] for record in records]):.3f}" for fold in (fmean, median))
            for k in range(len(groups))
        ]
        spread = "" if psnr.count < FEW else f" ± {psnr.half:.1f}"
        found = f"{sum(record['found'] for record in records)} of {len(records)}"
        how = [f"{setting.rate:g}", f"{setting.sigma:g}"]
        seconds = f"{fmean([record['seconds'] for record in records]):.2f}"
        table.append([name, *how, found, f"{psnr.value:.2f}{spread}", *errors, seconds])
    if not table:
        return ["None of these runs is done yet."]
    named = [f"MAE, {group}: mean / median" for group in groups]
    return markdown(["method", "rate", "sigma", "found", "PSNR", *named, "seconds a step"], table)


def starts_table(folder: Path, rows: Mapping[str, Sequence[Run]]) -> list[str]:
    """PSNR of every start, in bold where it is found."""
    table = []
    for name, runs in rows.items():
        cells = []
        for run in runs:
            record = load(folder, run)
            cell = "" if record is None else f"{record['psnr']:.1f}"
            cells.append(f"**{cell}**" if record is not None and record["found"] else cell)
        table.append([name, *cells])
    count = max(map(len, rows.values()))
    return markdown(["PSNR, dB", *(str(number) for number in range(1, count + 1))], table)


def search_table(folder: Path, rows: Mapping[str, Sequence[Run]]) -> list[str]:
    """PSNR on the search's start for every rate and sigma; the best of each method in bold."""
    table, heads = [], []
    for name, runs in rows.items():
        records = [load(folder, run) for run in runs]
        heads = [f"{run.setting.rate:g} / {run.setting.sigma:g}" for run in runs]
        best = max((record["psnr"] for record in records if record is not None), default=None)
        cells = ["" if record is None else f"{record['psnr']:.2f}" for record in records]
        table.append(
            [
                name,
                *(
                    f"**{cell}**" if record is not None and record["psnr"] == best else cell
                    for cell, record in zip(cells, records, strict=True)
                ),
            ]
        )
    return markdown(["rate / sigma", *heads], table)

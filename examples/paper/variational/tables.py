"""Results of the runs as Markdown and CSV."""

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

__all__ = ["csv_of", "merged_csv", "search_table", "starts_table", "summary"]

MIN_INTERVAL_RUNS: Final = 4  # an interval of fewer runs is not meaningful
COLUMNS: Final = ("method", "rate", "sigma", "final", "side", "samples", "steps", "seed")  # identify a run


def csv_of(folder: Path, runs: Sequence[Run], groups: Sequence[str]) -> str:
    """Return a CSV with a line for each finished run; `groups` are the labels of its errors."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*COLUMNS, "found", "psnr", *groups, "seconds"])
    for run in runs:
        record = load(folder, run)
        if record is not None:
            setting, size = run.setting, run.size
            settings = [setting.method, setting.rate, setting.sigma, setting.final, size.side, size.samples, size.steps]
            errors = [f"{error:.4f}" for error in record["errors"]]
            cells = [*settings, run.seed, record["found"], f"{record['psnr']:.3f}", *errors]
            writer.writerow([*cells, f"{record['seconds']:.3f}"])
    return stream.getvalue()


def merged_csv(numbers: str, path: Path) -> str:
    """Return a CSV of :func:`csv_of` with the lines of the file at `path`, if it exists, for all further runs."""
    if not path.is_file():
        return numbers
    runs = {_run_of(line) for line in numbers.splitlines()}
    further_lines = [line for line in path.read_text(encoding="utf-8").splitlines() if _run_of(line) not in runs]
    return numbers + "".join(f"{line}\n" for line in further_lines)


def _run_of(line: str) -> tuple[str, ...]:
    """Return the cells that identify the run of a line."""
    return tuple(line.split(",")[: len(COLUMNS)])


def summary(folder: Path, rows: Mapping[str, Sequence[Run]], groups: Sequence[str]) -> list[str]:
    """Return a table of the successful starts of each method, and of its means over all starts."""
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
        spread = "" if psnr.count < MIN_INTERVAL_RUNS else f" ± {psnr.half_width:.1f}"
        successes = f"{sum(record['found'] for record in records)} of {len(records)}"
        settings = [f"{setting.rate:g}", f"{setting.sigma:g}"]
        seconds = f"{fmean([record['seconds'] for record in records]):.2f}"
        table.append([name, *settings, successes, f"{psnr.value:.2f}{spread}", *errors, seconds])
    if not table:
        return ["None of these runs is done yet."]
    error_headings = [f"MAE, {group}: mean / median" for group in groups]
    return markdown(["method", "rate", "sigma", "found", "PSNR", *error_headings, "seconds a step"], table)


def starts_table(folder: Path, rows: Mapping[str, Sequence[Run]]) -> list[str]:
    """Return a table of the PSNR of every start, in bold where the fit succeeds."""
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
    """Return a table of the PSNR of the search for every rate and sigma, the best of each method in bold."""
    table, headings = [], []
    for name, runs in rows.items():
        records = [load(folder, run) for run in runs]
        headings = [f"{run.setting.rate:g} / {run.setting.sigma:g}" for run in runs]
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
    return markdown(["rate / sigma", *headings], table)

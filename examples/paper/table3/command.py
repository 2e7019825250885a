"""``python -m examples.paper table3``: the runs, then tables, contact sheets and convergence plots."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from examples.paper.pages import fill
from examples.paper.pictures import contact_sheet, convergence_plot
from examples.paper.runner import carry_out_all
from examples.paper.store import slug
from examples.paper.table3.problem import COLUMNS, Column, FloatArray, Problem
from examples.paper.table3.run import CURVE_STEPS, Run, carry_out
from examples.paper.table3.settings import LABELS, PROTOCOLS, RATES, Method, ours
from examples.paper.table3.tables import csv_of, table_of, tuning_table
from loi_core.errors import OptionError
from loi_core.io.files import check_writable, write_text

__all__ = ["main"]

PARTS: Final = ("tuning", "ours", "published")
SEEDS: Final = 10
TUNED: Final = 100  # the seed of the search, which no table has


@dataclass(frozen=True)
class _Part:
    """Runs by the name of their row."""

    rows: Mapping[str, Sequence[Run]]
    columns: tuple[Column, ...]

    @property
    def runs(self) -> list[Run]:
        """All of them, one start of everything before the next."""
        return sorted((run for runs in self.rows.values() for run in runs), key=lambda run: run.seed)


def main(words: Sequence[str] | None = None) -> None:
    """Carry out what is missing and write everything anew."""
    parser = argparse.ArgumentParser(prog="python -m examples.paper table3", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two methods, one start, one small column, few steps")
    parser.add_argument("--out", type=Path, default=Path("out/table3"), help="folder; what is in it is not done again")
    parser.add_argument("--processes", type=int, default=2, help="runs side by side, each on one thread (default: 2)")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="default: all")
    parser.add_argument("--methods", nargs="+", choices=list(LABELS), default=list(LABELS), help="default: all")
    parser.add_argument("--columns", nargs="+", metavar="NAME", help="columns of the table (default: all)")
    parser.add_argument("--report", action="store_true", help="do no more runs: report those that are done")
    parser.add_argument("--docs", type=Path, help="folder with table3.md, which gets the tables, numbers and pictures")
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"starts (default: {SEEDS}; the paper has 1 of some)")
    options = parser.parse_args(words)
    names = [column.name for column in COLUMNS]
    if set(options.columns or names) - set(names) or options.seeds < 1 or options.processes < 1:
        parser.error(f"--columns must be of {', '.join(map(repr, names))}; --seeds and --processes 1 or more")
    methods = tuple(method for method in LABELS if method in options.methods)
    columns = tuple(column for column in COLUMNS if column.name in (options.columns or names))
    parts = {name: _part(name, methods, columns, options.seeds) for name in options.parts}
    if options.quick:
        parts = {"ours": _quick()}
    try:
        check_writable("--out", options.out)
    except OptionError as error:
        parser.error(str(error))
    runs = options.out / "runs"
    for part in () if options.report else parts.values():
        carry_out_all(part.runs, carry_out, runs, options.processes)
    tables = {name: _table(name, part, runs) for name, part in parts.items()}
    lines = [line for name, table in tables.items() for line in (f"## {name}", "", *table, "")]
    every = list(dict.fromkeys(run for part in parts.values() for run in part.runs))
    write_text(options.out / "table.md", "\n".join(lines) + "\n")
    write_text(options.out / "runs.csv", csv_of(runs, every))
    _draw(parts, runs, options.out)
    print("\n".join(lines))
    if options.docs:
        fill(options.docs / "table3.md", tables)
        write_text(options.docs / "table3.csv", csv_of(runs, every))
        _draw(parts, runs, options.docs / "images" / "table3")


def _part(name: str, methods: Sequence[Method], columns: tuple[Column, ...], seeds: int) -> _Part:
    if name == "tuning":
        rows = {
            LABELS[method]: [Run(ours(method, rate), column, TUNED) for rate in RATES for column in columns]
            for method in methods
        }
        return _Part(rows, ())
    settings = PROTOCOLS["published" if name == "published" else "ours"]
    rows = {
        LABELS[method]: [
            Run(settings[method], column, seed) for column in columns for seed in range(min(seeds, column.seeds))
        ]
        for method in methods
    }
    return _Part(rows, columns)


def _quick() -> _Part:
    column = replace(COLUMNS[3], side=32)
    methods: tuple[Method, ...] = ("rgbxy_finetune", "loi")
    few = {method: replace(PROTOCOLS["ours"][method], steps=40, grid=16) for method in methods}
    return _Part({LABELS[method]: [Run(setting, column, 0)] for method, setting in few.items()}, (column,))


def _table(name: str, part: _Part, runs: Path) -> list[str]:
    return tuning_table(runs, part.rows, RATES) if name == "tuning" else table_of(runs, part.rows, part.columns)


def _draw(parts: Mapping[str, _Part], runs: Path, folder: Path) -> None:
    """A contact sheet for each column of each table, and its convergence."""
    for name, part in parts.items():
        at = {
            column.name: {row: [run for run in own if run.column == column] for row, own in part.rows.items()}
            for column in part.columns
        }
        for column, rows in at.items():
            contact_sheet(folder / f"{slug(f'{name}-{column}')}.png", runs, rows, _target)
        if at:
            convergence_plot(folder / f"{name}-convergence.png", runs, at, CURVE_STEPS)


def _target(run: Run) -> FloatArray:
    return next(iter(Problem.of(run.column, run.seed).targets.values()))

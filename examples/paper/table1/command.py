"""``python -m examples.paper table1``: the runs, then tables, contact sheets and convergence plots."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from examples.paper.pages import filled
from examples.paper.table1.pictures import contact_sheet, convergence_plot
from examples.paper.table1.problem import COLUMNS, HARDER, Column
from examples.paper.table1.run import Run
from examples.paper.table1.runner import carry_out_all
from examples.paper.table1.settings import ABLATIONS, LABELS, PROTOCOLS, Method
from examples.paper.table1.store import slug
from examples.paper.table1.tables import csv_of, table_of
from examples.paper.table1.tuning import tuning_runs, tuning_table
from loi_core.errors import OptionError
from loi_core.files import check_writable, write_text

__all__ = ["main"]

SEEDS: Final = 10
ABLATION_SEEDS: Final = 3
ABLATED: Final = (COLUMNS[3], COLUMNS[4], HARDER[2])
PARTS: Final = ("tuning", "ours", "published", "harder", "ablations")


@dataclass(frozen=True)
class Part:
    """Runs by the name of their row, and the columns over which a row goes; none for a search."""

    rows: Mapping[str, Sequence[Run]]
    columns: tuple[Column, ...]

    @property
    def runs(self) -> list[Run]:
        """All of them."""
        return [run for runs in self.rows.values() for run in runs]

    def at(self, column: Column) -> dict[str, list[Run]]:
        """Those of one column."""
        return {name: [run for run in runs if run.column == column] for name, runs in self.rows.items()}


@dataclass(frozen=True)
class Extent:
    """How much of the table is wanted.

    Attributes
    ----------
    parts : tuple of str
        Of `PARTS`.
    methods : tuple of str
        In the order of the table.
    columns, harder, ablated : tuple of Column
        Of the table, of the harder ones, and of the ablations.
    seeds, ablation_seeds : int
        How many starts.
    steps : int, optional
        Of every fit, instead of each setting's own.
    """

    parts: tuple[str, ...]
    methods: tuple[Method, ...]
    columns: tuple[Column, ...] = COLUMNS
    harder: tuple[Column, ...] = HARDER
    ablated: tuple[Column, ...] = ABLATED
    seeds: int = SEEDS
    ablation_seeds: int = ABLATION_SEEDS
    steps: int | None = None

    def part(self, part: str) -> Part:
        """The runs of one part, with the steps that are wanted."""
        if part == "tuning":
            rows = {LABELS[method]: tuning_runs(method) for method in self.methods}
            return Part(self._limited(rows), ())
        if part == "ablations":
            settings = {one.name: one for one in ABLATIONS}
            columns, seeds = self.ablated, self.ablation_seeds
        else:
            protocol, columns = ("ours", self.harder) if part == "harder" else (part, self.columns)
            settings = {LABELS[method]: PROTOCOLS[protocol][method] for method in self.methods}
            seeds = self.seeds
        return Part(
            self._limited(
                {
                    name: [Run(setting, column, seed) for column in columns for seed in range(seeds)]
                    for name, setting in settings.items()
                }
            ),
            columns,
        )

    @property
    def runs(self) -> list[Run]:
        """All runs of all parts."""
        return [run for name in self.parts for run in self.part(name).runs]

    def _limited(self, rows: Mapping[str, Sequence[Run]]) -> dict[str, list[Run]]:
        if self.steps is None:
            return {name: list(runs) for name, runs in rows.items()}
        steps = self.steps
        return {
            name: [replace(run, setting=replace(run.setting, steps=steps)) for run in runs]
            for name, runs in rows.items()
        }


def main(words: Sequence[str] | None = None) -> None:
    """Carry out what is missing and write everything anew."""
    parser = argparse.ArgumentParser(prog="python -m examples.paper table1", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two methods, one start, 4 disks, few steps")
    parser.add_argument("--out", type=Path, default=Path("out/table1"), help="folder; what is in it is not done again")
    parser.add_argument("--processes", type=int, default=2, help="runs side by side, each on one thread (default: 2)")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="default: all")
    parser.add_argument("--methods", nargs="+", choices=list(LABELS), default=list(LABELS), help="default: all")
    parser.add_argument("--columns", nargs="+", metavar="NAME", help="columns of the table (default: all)")
    parser.add_argument("--report", action="store_true", help="do no more runs: report those that are done")
    parser.add_argument("--docs", type=Path, help="folder with table1.md, which gets the tables, numbers and pictures")
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"starts (default: {SEEDS})")
    options = parser.parse_args(words)
    methods = tuple(method for method in LABELS if method in options.methods)
    if options.quick:
        extent = Extent(("ours",), ("pixel_l2", "loi"), (Column("4", 4, side=64),), (), (), 1, steps=60)
    else:
        every = (*COLUMNS, *HARDER)
        wanted = options.columns or [column.name for column in every]
        unknown = set(wanted) - {column.name for column in every}
        if unknown or options.seeds < 1 or options.processes < 1:
            names = ", ".join(repr(column.name) for column in every)
            parser.error(f"--columns must be of {names}; --seeds and --processes 1 or more")
        columns, harder, ablated = (
            tuple(one for one in some if one.name in wanted) for some in (COLUMNS, HARDER, ABLATED)
        )
        extent = Extent(tuple(options.parts), methods, columns, harder, ablated, options.seeds)
    try:
        check_writable("--out", options.out)
    except OptionError as error:
        parser.error(str(error))
    runs = options.out / "runs"
    for name in () if options.report else extent.parts:
        carry_out_all(extent.part(name).runs, runs, options.processes)
        report(extent, runs, options.out)
    print("\n".join(report(extent, runs, options.out)))
    if options.docs:
        page = options.docs / "table1.md"
        write_text(page, filled(page.read_text(encoding="utf-8"), tables(extent, runs)))
        write_text(options.docs / "table1.csv", csv_of(runs, extent.runs))
        draw(extent, runs, options.docs / "images" / "table1")


def report(extent: Extent, runs: Path, folder: Path) -> list[str]:
    """Write what is known of all runs of `extent`: ``table.md``, ``runs.csv`` and pictures; the lines of the first."""
    lines = [line for name, table in tables(extent, runs).items() for line in (f"## {name}", "", *table, "")]
    write_text(folder / "table.md", "\n".join(lines) + "\n")
    write_text(folder / "runs.csv", csv_of(runs, extent.runs))
    draw(extent, runs, folder)
    return lines


def tables(extent: Extent, runs: Path) -> dict[str, list[str]]:
    """The table of each part."""
    parts = {name: extent.part(name) for name in extent.parts}
    return {
        name: table_of(runs, part.rows, part.columns) if part.columns else tuning_table(runs, part.rows)
        for name, part in parts.items()
    }


def draw(extent: Extent, runs: Path, folder: Path) -> None:
    """A contact sheet for each column of each part, and the convergence of each table."""
    for name in extent.parts:
        part = extent.part(name)
        for column in part.columns:
            contact_sheet(folder / f"{name}-{slug(column.name)}.png", runs, part.at(column))
        if part.columns and name != "ablations":
            panels = {column.name: part.at(column) for column in part.columns}
            convergence_plot(folder / f"{name}-convergence.png", runs, panels)

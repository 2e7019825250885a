"""``python -m examples.paper table1``: the runs, then tables, contact sheets and convergence plots."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from examples.paper.pages import fill
from examples.paper.pictures import contact_sheet, convergence_plot
from examples.paper.runner import carry_out_all
from examples.paper.store import slug
from examples.paper.table1.extent import ABLATED, FEW, PARTS, SEEDS, Extent
from examples.paper.table1.problem import COLUMNS, HARDER, Column, Image, Problem
from examples.paper.table1.run import CURVE_STEPS, Run, carry_out
from examples.paper.table1.settings import LABELS, PROTOCOLS
from examples.paper.table1.tables import csv_of, table_of
from examples.paper.table1.tuning import tuning_table
from loi_core.errors import OptionError
from loi_core.io.files import check_writable, write_text

__all__ = ["main"]


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
    starts = f"starts (default: {SEEDS}, but {FEW} of remedies and ablations)"
    parser.add_argument("--seeds", type=int, default=SEEDS, help=starts)
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
        few = min(options.seeds, FEW)
        extent = Extent(tuple(options.parts), methods, columns, harder, ablated, options.seeds, few)
    try:
        check_writable("--out", options.out)
    except OptionError as error:
        parser.error(str(error))
    runs = options.out / "runs"
    for part in () if options.report else extent.tables.values():
        carry_out_all(part.runs, carry_out, runs, options.processes)
        report(extent, runs, options.out)
    print("\n".join(report(extent, runs, options.out)))
    if options.docs:
        fill(options.docs / "table1.md", tables(extent, runs))
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
    """The lines of each table."""
    return {
        name: table_of(runs, part.rows, part.columns) if part.columns else tuning_table(runs, part.rows)
        for name, part in extent.tables.items()
    }


def draw(extent: Extent, runs: Path, folder: Path) -> None:
    """A contact sheet for each column of each table, and the convergence of those that compare methods."""
    for name, part in extent.tables.items():
        for column in part.columns:
            one = name if name.endswith(column.name) else f"{name}-{column.name}"
            contact_sheet(folder / f"{slug(one)}.png", runs, part.at(column), _target)
        if name in PROTOCOLS or name == "harder":
            panels = {_title(column): part.at(column) for column in part.columns}
            convergence_plot(folder / f"{name}-convergence.png", runs, panels, CURVE_STEPS)


def _target(run: Run) -> Image:
    return Problem.of(run.column, run.seed).target


def _title(column: Column) -> str:
    return f"{column.name} disks" if column.name.isdigit() else column.name

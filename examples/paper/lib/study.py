"""A table of the paper: carry out its runs in parallel, each once, and write Markdown, CSV and pictures."""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import numpy as np

from examples.paper.lib.means import Mean
from examples.paper.lib.pages import fill
from examples.paper.lib.pictures import contact_sheet, convergence_plot
from examples.paper.lib.results import KEY, AnyFit, ColumnType, Results, key_of, read_figures
from examples.paper.lib.runner import carry_out_all
from examples.paper.lib.store import slug
from loi_core.errors import OptionError
from loi_core.io.files import check_writable, write_text
from loi_core.support.markdown import markdown

__all__ = ["Study", "Subtable", "add_options", "carry_out_and_report", "check_out", "selected_columns"]

RunType = TypeVar("RunType", bound=AnyFit)
HEADER_LINES: Final = 2  # of a table without rows


@dataclass(frozen=True)
class Subtable(Generic[RunType]):
    """A subtable of a study: rows of runs over columns, or a search over learning rates.

    Attributes
    ----------
    rows : dict of runs
        Runs by the name of their row.
    columns : tuple
        Columns of the table; empty for a search.
    rates : tuple of float
        Rates of a search, whose runs differ in ``setting.rate``.
    converges : bool
        Whether to plot the convergence of the rows.
    """

    rows: Mapping[str, Sequence[RunType]]
    columns: tuple[Any, ...] = ()
    rates: tuple[float, ...] = ()
    converges: bool = True

    @property
    def runs(self) -> list[RunType]:
        """All runs, ordered by their seeds."""
        return sorted((run for runs in self.rows.values() for run in runs), key=lambda run: run.seed)

    def at(self, column: Any) -> dict[str, list[RunType]]:
        """Return the runs of one column by the names of their rows."""
        return {name: [run for run in runs if run.column == column] for name, runs in self.rows.items()}


@dataclass(frozen=True)
class Study(Generic[RunType]):
    """A table of the paper: its runs, its measures and its published figures.

    Attributes
    ----------
    name : str
        Name of the page, of the CSV, and of the folder of pictures.
    carry_out : callable
        Return the outcome of a run; see :func:`examples.paper.lib.store.keep`.
    target : callable
        Return the target image of a run, shape (H, W, 3).
    measures : tuple of str
        Fields of an outcome that the CSV lists.
    second_measure : callable
        Return the name of the measure that a column shows after PSNR.
    curve_steps : int
        Steps between two points of a convergence curve.
    columns : tuple
        Columns with published figures.
    paper : dict
        Published pairs of PSNR and second measure, one for each column, by the name of their row.
    title : callable
        Return the heading of a column.
    animate : callable
        Draw further pictures of the runs of one folder into another.
    extra_tables : callable
        Return further tables by name, from the results and the subtables.
    unpublished_columns : tuple
        Further columns of the CSV, without published figures; all names of columns differ.
    """

    name: str
    carry_out: Callable[[RunType], Any]
    target: Callable[[RunType], Any]
    measures: tuple[str, ...]
    second_measure: Callable[[Any], str]
    curve_steps: int
    columns: tuple[Any, ...]
    paper: Mapping[str, Sequence[tuple[float, float]]]
    title: Callable[[Any], str] = field(default=lambda column: str(column.name))
    animate: Callable[[Mapping[str, Subtable[RunType]], Path, Path], None] = field(default=lambda *_: None)
    extra_tables: Callable[[Results, Mapping[str, Subtable[RunType]]], Mapping[str, list[str]]] = field(
        default=lambda *_: {}
    )
    unpublished_columns: tuple[Any, ...] = ()

    def csv_of(self, results: Results, runs: Sequence[RunType]) -> str:
        """Return a CSV with a line for each run that has a result, then for each further run with figures."""
        records = {key_of(run): record for run in runs if (record := results.of(run)) is not None}
        records |= {key: figures for key, figures in results.figures.items() if key not in records}
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow((*KEY, *self.measures, "seconds"))
        for key, record in records.items():
            cells = (f"{record[measure]:.4f}" if measure in record else "" for measure in self.measures)
            writer.writerow((*key, *cells, f"{record['seconds']:.1f}" if "seconds" in record else ""))
        return stream.getvalue()

    def table_of(self, results: Results, subtable: Subtable[RunType]) -> list[str]:
        """Return the lines of a subtable: PSNR with its interval and minimum, then the second measure.

        Published figures follow below their row. The table of a search shows the mean PSNR over all columns at each
        rate, the best of each row in bold.
        """
        if subtable.rates:
            return self._search(results, subtable)
        table = []
        for name, runs in subtable.rows.items():
            runs_by_column = [(column, [run for run in runs if run.column == column]) for column in subtable.columns]
            table.append([name, *(self._cell(results, column_runs, column) for column, column_runs in runs_by_column)])
            if name in self.paper and subtable.columns == self.columns:
                table.append(["&nbsp;&nbsp;the paper's", *map(_figures, self.paper[name])])
        return markdown(["", *map(self.title, subtable.columns)], table)

    def _cell(self, results: Results, runs: Sequence[RunType], column: Any) -> str:
        records = [record for run in runs if (record := results.of(run)) is not None]
        if not records:
            return ""
        psnr = Mean.of([record["psnr"] for record in records])
        second = Mean.of([record[self.second_measure(column)] for record in records])
        spread = "" if psnr.count == 1 else f" ± {psnr.half_width:.1f} (least {psnr.minimum:.1f})"
        missing = "" if len(records) == len(runs) else f", {len(records)} of {len(runs)} seeds"
        return f"{psnr.value:.2f}{spread} / {second.value:.3f}{missing}"

    def _search(self, results: Results, subtable: Subtable[RunType]) -> list[str]:
        table = []
        for name, runs in subtable.rows.items():
            means = [_mean(results, [run for run in runs if run.setting.rate == rate]) for rate in subtable.rates]
            best = max((mean for mean in means if mean is not None), default=None)
            if best is not None:
                cells = ["" if mean is None else f"**{mean:.2f}**" if mean == best else f"{mean:.2f}" for mean in means]
                table.append([name, *cells])
        return markdown(["pixels a step", *(f"{rate:g}" for rate in subtable.rates)], table)

    def tables(self, subtables: Mapping[str, Subtable[RunType]], results: Results) -> dict[str, list[str]]:
        """Return the lines of every table by its name."""
        tables = {name: self.table_of(results, subtable) for name, subtable in subtables.items()}
        return tables | dict(self.extra_tables(results, subtables))

    def write(self, subtables: Mapping[str, Subtable[RunType]], results: Results, folder: Path) -> dict[str, list[str]]:
        """Write ``table.md`` and ``runs.csv`` into a folder, and return the lines of every table by its name."""
        tables = self.tables(subtables, results)
        write_text(folder / "table.md", _page(tables))
        write_text(folder / "runs.csv", self.csv_of(results, _all_runs(subtables)))
        return tables

    def draw(self, subtables: Mapping[str, Subtable[RunType]], results: Results, folder: Path) -> None:
        """Draw a contact sheet for each column of each table, and the convergence of its rows.

        An existing picture stays when the new one would lack runs, because their images are gone.
        """
        runs = results.folder
        for name, subtable in subtables.items():
            for column in subtable.columns:
                if results.has_figures_only([run for row in subtable.at(column).values() for run in row]):
                    continue
                sheet = name if name.endswith(column.name) else f"{name}-{column.name}"
                contact_sheet(folder / f"{slug(sheet)}.png", runs, subtable.at(column), self.target)
            if subtable.columns and subtable.converges and not results.has_figures_only(subtable.runs):
                panels = {self.title(column): subtable.at(column) for column in subtable.columns}
                convergence_plot(folder / f"{name}-convergence.png", runs, panels, self.curve_steps)
        self.animate(subtables, runs, folder)


def add_options(
    parser: argparse.ArgumentParser, name: str, subtable_names: Sequence[str], quick: str, processes: int = 2
) -> None:
    """Add the options of every table; `quick` describes its quick tier."""
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument(
        "--out", type=Path, default=Path("out") / name, help="output folder; its finished runs are kept"
    )
    parser.add_argument("--processes", type=int, default=processes, help=f"parallel runs (default: {processes})")
    parser.add_argument("--parts", nargs="+", choices=subtable_names, default=list(subtable_names), help="default: all")
    parser.add_argument("--columns", nargs="+", metavar="NAME", help="columns of the table (default: all)")
    parser.add_argument("--report", action="store_true", help="report the finished runs and start none")
    parser.add_argument("--docs", type=Path, help=f"folder with {name}.md; update its tables, numbers and pictures")


def selected_columns(
    parser: argparse.ArgumentParser, options: argparse.Namespace, columns: Sequence[ColumnType]
) -> tuple[ColumnType, ...]:
    """Return the columns that ``--columns`` names, all by default; exit with a message if an option is wrong."""
    by_name = {column.name: column for column in columns}
    if not by_name.keys() >= set(options.columns or ()) or options.seeds < 1:
        parser.error(f"--columns must be among {', '.join(map(repr, by_name))}; --seeds must be 1 or more")
    return tuple(column for name, column in by_name.items() if options.columns is None or name in options.columns)


def carry_out_and_report(
    parser: argparse.ArgumentParser,
    options: argparse.Namespace,
    study: Study[RunType],
    subtables: Mapping[str, Subtable[RunType]],
) -> None:
    """Carry out the missing runs and write all tables and pictures; ``--docs`` also updates the documentation.

    The documentation's CSV supplies the figures of runs without a record in the folder, so that a table can grow over
    several calls.
    """
    if options.processes < 1:
        parser.error("--processes must be 1 or more")
    check_out(parser, options.out)
    runs = options.out / "runs"
    records = Results(runs)
    for subtable in () if options.report else subtables.values():
        carry_out_all(subtable.runs, study.carry_out, runs, options.processes)
        study.write(subtables, records, options.out)
    tables = study.write(subtables, records, options.out)
    study.draw(subtables, records, options.out)
    if not options.docs:
        print(_page(tables), end="")
        return
    csv_path = options.docs / f"{study.name}.csv"
    results = Results(runs, read_figures(csv_path), (*study.columns, *study.unpublished_columns))
    tables = study.tables(subtables, results)
    print(_page(tables), end="")
    # A table without any result keeps its documented lines.
    filled_tables = {name: table for name, table in tables.items() if len(table) > HEADER_LINES}
    fill(options.docs / f"{study.name}.md", filled_tables)
    write_text(csv_path, study.csv_of(results, _all_runs(subtables)))
    study.draw(subtables, results, options.docs / "images" / study.name)


def check_out(parser: argparse.ArgumentParser, folder: Path) -> None:
    """Exit with a message if the folder of ``--out`` is not writable, before hours of runs."""
    try:
        check_writable("--out", folder)
    except OptionError as error:
        parser.error(str(error))


def _mean(results: Results, runs: Sequence[AnyFit]) -> float | None:
    """Return the mean PSNR; None without runs, or if a run has no result."""
    values = [record["psnr"] for run in runs if (record := results.of(run)) is not None]
    return float(np.mean(values)) if values and len(values) == len(runs) else None


def _all_runs(subtables: Mapping[str, Subtable[RunType]]) -> list[RunType]:
    return list(dict.fromkeys(run for subtable in subtables.values() for run in subtable.runs))


def _page(tables: Mapping[str, Sequence[str]]) -> str:
    return "\n".join(line for name, table in tables.items() for line in (f"## {name}", "", *table, "")) + "\n"


def _figures(published: tuple[float, float]) -> str:
    """Return PSNR and the second measure as the paper prints them: a small error has more decimals."""
    psnr, second = published
    return f"{psnr:.2f} / {second:.2f}" if second == round(second, 2) else f"{psnr:.2f} / {second:.4f}"

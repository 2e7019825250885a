"""A table of the paper: its runs carried out side by side, each once, then Markdown, CSV and pictures of them."""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import numpy as np

from examples.paper.lib.known import KEY, Fit, Known, key_of, read_figures
from examples.paper.lib.means import Mean
from examples.paper.lib.pages import fill
from examples.paper.lib.pictures import contact_sheet, convergence_plot
from examples.paper.lib.runner import carry_out_all
from examples.paper.lib.store import slug
from loi_core.errors import OptionError
from loi_core.io.files import check_writable, write_text
from loi_core.support.markdown import markdown

__all__ = ["Part", "Study", "add_options", "carry_out_and_report", "check_out"]

Made = TypeVar("Made", bound=Fit)
HEADER: Final = 2  # lines of a table without rows


@dataclass(frozen=True)
class Part(Generic[Made]):
    """Runs by the name of their row, with the columns over which a row goes; or a search, with its rates.

    Attributes
    ----------
    rows : dict of runs
        By name.
    columns : tuple
        None of a search.
    rates : tuple of float
        Of a search; its runs are told apart by ``setting.rate``.
    converges : bool
        Whether a picture shows the convergence of its rows.
    """

    rows: Mapping[str, Sequence[Made]]
    columns: tuple[Any, ...] = ()
    rates: tuple[float, ...] = ()
    converges: bool = True

    @property
    def runs(self) -> list[Made]:
        """All of them, one start of everything before the next."""
        return sorted((run for runs in self.rows.values() for run in runs), key=lambda run: run.seed)

    def at(self, column: Any) -> dict[str, list[Made]]:
        """Those of one column."""
        return {name: [run for run in runs if run.column == column] for name, runs in self.rows.items()}


@dataclass(frozen=True)
class Study(Generic[Made]):
    """What is to be known of a table to carry it out and to print it.

    Attributes
    ----------
    name : str
        Of its page, its CSV, and its folder of pictures.
    carry_out : callable
        Gives the outcome of a run; see :func:`examples.paper.lib.store.keep`.
    target : callable
        Gives the picture that a run is after, shape (H, W, 3).
    measures : tuple of str
        Of an outcome, for the CSV.
    beside : callable
        The measure that stands beside PSNR in a column.
    apart : int
        Steps between two points of a convergence curve.
    title : callable
        Heads a column.
    animate : callable
        Draws further pictures, of runs in a folder, into another one.
    others : callable
        Gives further tables by their names, for what is known of the runs of the parts.
    columns : tuple
        For which there are figures of the paper.
    paper : dict
        Those figures, PSNR and what is beside it for each column, by the name of the row that they are of.
    further : tuple
        Columns of which the paper has none, and the CSV has; no two have one name.
    """

    name: str
    carry_out: Callable[[Made], Any]
    target: Callable[[Made], Any]
    measures: tuple[str, ...]
    beside: Callable[[Any], str]
    apart: int
    columns: tuple[Any, ...]
    paper: Mapping[str, Sequence[tuple[float, float]]]
    title: Callable[[Any], str] = field(default=lambda column: str(column.name))
    animate: Callable[[Mapping[str, Part[Made]], Path, Path], None] = field(default=lambda *_: None)
    others: Callable[[Known, Mapping[str, Part[Made]]], Mapping[str, list[str]]] = field(default=lambda *_: {})
    further: tuple[Any, ...] = ()

    def csv_of(self, known: Known, runs: Sequence[Made]) -> str:
        """A line for each run that is known, and then for each that only figures are left of."""
        records = {key_of(run): record for run in runs if (record := known.of(run)) is not None}
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow((*KEY, *self.measures, "seconds"))
        for key, record in {
            **records,
            **{key: one for key, one in known.figures.items() if key not in records},
        }.items():
            figures = (f"{record[one]:.4f}" if one in record else "" for one in self.measures)
            writer.writerow((*key, *figures, f"{record['seconds']:.1f}" if "seconds" in record else ""))
        return stream.getvalue()

    def table_of(self, known: Known, part: Part[Made]) -> list[str]:
        """PSNR with its interval and the least of all seeds, and what is beside it; the paper's figures beneath.

        Of a search: mean PSNR over all columns at each rate, the best of each row in bold.
        """
        if part.rates:
            return self._search(known, part)
        table = []
        for name, runs in part.rows.items():
            table.append(
                [name, *(self._cell(known, [run for run in runs if run.column == at], at) for at in part.columns)]
            )
            if name in self.paper and part.columns == self.columns:
                table.append(["&nbsp;&nbsp;the paper's", *map(_figures, self.paper[name])])
        return markdown(["", *map(self.title, part.columns)], table)

    def _cell(self, known: Known, runs: Sequence[Made], column: Any) -> str:
        records = [record for run in runs if (record := known.of(run)) is not None]
        if not records:
            return ""
        psnr = Mean.of([record["psnr"] for record in records])
        other = Mean.of([record[self.beside(column)] for record in records])
        spread = "" if psnr.count == 1 else f" ± {psnr.half:.1f} (least {psnr.least:.1f})"
        missing = "" if len(records) == len(runs) else f", {len(records)} of {len(runs)} seeds"
        return f"{psnr.value:.2f}{spread} / {other.value:.3f}{missing}"

    def _search(self, known: Known, part: Part[Made]) -> list[str]:
        table = []
        for name, runs in part.rows.items():
            means = [_mean(known, [run for run in runs if run.setting.rate == rate]) for rate in part.rates]
            best = max((one for one in means if one is not None), default=None)
            if best is not None:
                cells = ["" if one is None else f"**{one:.2f}**" if one == best else f"{one:.2f}" for one in means]
                table.append([name, *cells])
        return markdown(["pixels a step", *(f"{rate:g}" for rate in part.rates)], table)

    def tables(self, parts: Mapping[str, Part[Made]], known: Known) -> dict[str, list[str]]:
        """The lines of each table."""
        return {name: self.table_of(known, part) for name, part in parts.items()} | dict(self.others(known, parts))

    def write(self, parts: Mapping[str, Part[Made]], known: Known, folder: Path) -> dict[str, list[str]]:
        """Write ``table.md`` and ``runs.csv`` into a folder; the lines of each table."""
        tables = self.tables(parts, known)
        write_text(folder / "table.md", _page(tables))
        write_text(folder / "runs.csv", self.csv_of(known, _every(parts)))
        return tables

    def draw(self, parts: Mapping[str, Part[Made]], known: Known, folder: Path) -> None:
        """A contact sheet for each column of each table, and the convergence of its rows.

        What would show less than is known, since pictures of earlier runs are gone, is left as it is.
        """
        runs = known.folder
        for name, part in parts.items():
            for column in part.columns:
                if known.has_figures_only([run for row in part.at(column).values() for run in row]):
                    continue
                sheet = name if name.endswith(column.name) else f"{name}-{column.name}"
                contact_sheet(folder / f"{slug(sheet)}.png", runs, part.at(column), self.target)
            if part.columns and part.converges and not known.has_figures_only(part.runs):
                panels = {self.title(column): part.at(column) for column in part.columns}
                convergence_plot(folder / f"{name}-convergence.png", runs, panels, self.apart)
        self.animate(parts, runs, folder)


def add_options(
    parser: argparse.ArgumentParser, name: str, parts: Sequence[str], quick: str, processes: int = 2
) -> None:
    """Those that every table has; `quick` says what its quick tier is."""
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--out", type=Path, default=Path("out") / name, help="folder; what is in it is not done again")
    parser.add_argument("--processes", type=int, default=processes, help=f"runs side by side (default: {processes})")
    parser.add_argument("--parts", nargs="+", choices=parts, default=list(parts), help="default: all")
    parser.add_argument("--columns", nargs="+", metavar="NAME", help="columns of the table (default: all)")
    parser.add_argument("--report", action="store_true", help="do no more runs: report those that are done")
    parser.add_argument("--docs", type=Path, help=f"folder with {name}.md, which gets the tables, numbers and pictures")


def carry_out_and_report(
    parser: argparse.ArgumentParser, options: argparse.Namespace, study: Study[Made], parts: Mapping[str, Part[Made]]
) -> None:
    """Carry out what is missing and write everything anew, with ``--docs`` also what the documentation shows.

    There, what the CSV says of runs that are not in the folder counts as well, so that a table can grow in parts.
    """
    if options.processes < 1:
        parser.error("--processes must be 1 or more")
    check_out(parser, options.out)
    runs = options.out / "runs"
    done = Known(runs)
    for part in () if options.report else parts.values():
        carry_out_all(part.runs, study.carry_out, runs, options.processes)
        study.write(parts, done, options.out)
    tables = study.write(parts, done, options.out)
    study.draw(parts, done, options.out)
    if not options.docs:
        print(_page(tables), end="")
        return
    numbers = options.docs / f"{study.name}.csv"
    known = Known(runs, read_figures(numbers), (*study.columns, *study.further))
    tables = study.tables(parts, known)
    print(_page(tables), end="")
    # A table of which nothing is known, since what it was of is gone, stays as it is.
    fill(options.docs / f"{study.name}.md", {name: table for name, table in tables.items() if len(table) > HEADER})
    write_text(numbers, study.csv_of(known, _every(parts)))
    study.draw(parts, known, options.docs / "images" / study.name)


def check_out(parser: argparse.ArgumentParser, folder: Path) -> None:
    """End with a message if ``--out`` cannot be written to: before hours of runs, not after."""
    try:
        check_writable("--out", folder)
    except OptionError as error:
        parser.error(str(error))


def _mean(known: Known, runs: Sequence[Fit]) -> float | None:
    """Of PSNR; None if there are no such runs, or not all of them are done."""
    found = [record["psnr"] for run in runs if (record := known.of(run)) is not None]
    return float(np.mean(found)) if found and len(found) == len(runs) else None


def _every(parts: Mapping[str, Part[Made]]) -> list[Made]:
    return list(dict.fromkeys(run for part in parts.values() for run in part.runs))


def _page(tables: Mapping[str, Sequence[str]]) -> str:
    return "\n".join(line for name, table in tables.items() for line in (f"## {name}", "", *table, "")) + "\n"


def _figures(pair: tuple[float, float]) -> str:
    """As the paper prints them: a small error has more places."""
    psnr, other = pair
    return f"{psnr:.2f} / {other:.2f}" if other == round(other, 2) else f"{psnr:.2f} / {other:.4f}"

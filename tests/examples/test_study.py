"""Tests of the studies of the paper: a table can grow over several calls, and keeps figures of deleted records."""

from __future__ import annotations

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples.paper.lib.results import Fit
from examples.paper.lib.study import Study, Subtable, add_options, carry_out_and_report


@dataclass(frozen=True)
class Setting:
    name: str
    method: str
    rate: float = 1.0
    steps: int = 10


@dataclass(frozen=True)
class Column:
    name: str
    width: int = 4


class Run(Fit[Setting, Column]):
    @property
    def parts(self) -> tuple[str, ...]:
        return self.setting.name, self.setting.method, f"{self.column.name} {self.column.width}"


@dataclass(frozen=True)
class Outcome:
    image: Any
    psnr: float
    mae: float
    seconds: float
    curve: list[float]


def carry_out(run: Run) -> Outcome:
    return Outcome(np.full((4, 4, 3), 0.5), 20.0 + run.seed, 0.25, 1.5, [10.0, 20.0 + run.seed])


COLUMNS = (Column("Shadow"), Column("Envlight"))
STUDY = Study(
    name="table9",
    carry_out=carry_out,
    target=lambda _: np.full((4, 4, 3), 0.5),
    measures=("psnr", "mae"),
    second_measure=lambda _: "mae",
    curve_steps=5,
    columns=COLUMNS,
    paper={"ours": ((30.0, 0.1), (31.0, 0.2))},
)


def reported(folder: Path, out: str, *, seeds: int, report: bool = False, columns: Any = COLUMNS) -> list[str]:
    """Report a table, and return the cells of its row in the documentation."""
    parser = argparse.ArgumentParser()
    add_options(parser, "table9", ("ours",), "none", processes=1)
    arguments = ["--out", str(folder / out), "--docs", str(folder / "docs"), *(["--report"] if report else [])]
    runs = [Run(Setting("ours", "loi"), column, seed) for column in columns for seed in range(seeds)]
    subtable = Subtable({"ours": runs}, columns)
    carry_out_and_report(parser, parser.parse_args(arguments), STUDY, {"ours": subtable})
    (row,) = [line for line in (folder / "docs" / "table9.md").read_text().splitlines() if line.startswith("| ours")]
    return [cell.strip() for cell in row.strip("|").split("|")][1:]


@pytest.fixture
def docs(tmp_path: Path) -> Path:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "table9.md").write_text("# Nine\n\n<!-- ours -->\n<!-- end -->\n")
    return tmp_path


def test_figures_and_pictures_of_runs_without_records_are_kept(docs: Path) -> None:
    first = reported(docs, "out", seeds=1)
    assert first == ["20.00 / 0.250", "20.00 / 0.250"]
    sheet = docs / "docs" / "images" / "table9" / "ours-shadow.png"
    picture = sheet.read_bytes()
    rows = (docs / "docs" / "table9.csv").read_text()
    assert reported(docs, "elsewhere", seeds=3, report=True) == ["20.00 / 0.250, 1 of 3 seeds"] * 2
    assert (docs / "docs" / "table9.csv").read_text() == rows
    assert sheet.read_bytes() == picture
    assert not (docs / "elsewhere" / "runs").exists()  # figures do not count as finished runs


def test_new_runs_extend_and_replace_figures_of_runs_without_records(docs: Path) -> None:
    reported(docs, "out", seeds=1)
    numbers = docs / "docs" / "table9.csv"
    numbers.write_text(numbers.read_text().replace("20.0000", "10.0000"))
    assert reported(docs, "elsewhere", seeds=2, report=True)[0] == "10.00 / 0.250, 1 of 2 seeds"
    assert reported(docs, "elsewhere", seeds=2)[0].startswith("20.50 ± ")
    rows = list(csv.DictReader(numbers.read_text().splitlines()))
    assert {(row["column"], row["seed"], row["psnr"]) for row in rows} == {
        (column.name, str(seed), f"{20 + seed:.4f}") for column in COLUMNS for seed in range(2)
    }
    assert len(rows) == 4


def test_a_report_of_fewer_columns_keeps_all_other_rows_of_the_csv(docs: Path) -> None:
    reported(docs, "out", seeds=2)
    expected = set((docs / "docs" / "table9.csv").read_text().splitlines())
    reported(docs, "elsewhere", seeds=1, report=True, columns=COLUMNS[:1])
    assert set((docs / "docs" / "table9.csv").read_text().splitlines()) == expected


def test_a_table_without_results_keeps_its_documented_lines(docs: Path) -> None:
    page = docs / "docs" / "table9.md"
    page.write_text("<!-- ours -->\nwritten earlier\n<!-- end -->\n")
    parser = argparse.ArgumentParser()
    add_options(parser, "table9", ("ours",), "none", processes=1)
    arguments = ["--out", str(docs / "out"), "--docs", str(docs / "docs"), "--report"]
    search = Subtable({"ours": [Run(Setting("ours", "loi"), COLUMNS[0], 100)]}, rates=(1.0,))
    carry_out_and_report(parser, parser.parse_args(arguments), STUDY, {"ours": search})
    assert "written earlier" in page.read_text()


def test_figures_apply_only_to_their_own_column_despite_equal_names(docs: Path) -> None:
    reported(docs, "out", seeds=1)
    assert reported(docs, "elsewhere", seeds=1, report=True, columns=(Column("Shadow", 8),)) == [""]

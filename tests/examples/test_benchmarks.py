"""Benchmarks have all their rows, and name the peers that they cannot measure."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import pytest

from benchmarks import first_result, speed, timing
from tests.environments import ROOT, run

ROWS = ("balanced|path", "plain conv2d|path", "MS-SSIM", "pyramid", "AlexNet")


def test_the_speed_benchmark_writes_every_row_and_names_missing_peers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("pytorch_msssim", "torchmetrics", "torchmetrics.functional.image"):
        monkeypatch.setitem(sys.modules, name, None)  # as if it were not installed
    monkeypatch.setattr(timing, "SETTLE_SECONDS", 0.0)  # the test ignores times
    path = tmp_path / "rows.csv"
    options = ["--quick", "--seconds", "0.01", "--sizes", "32", "40x32", "--rows", *ROWS, "--csv", str(path)]
    assert speed.main(options) == 0
    with path.open() as file:
        rows = [row for row in csv.DictReader(file) if row["device"] == "cpu"]
    assert [row["size"] for row in rows] == ["32x32"] * 9 + ["40x32"] * 9
    measured = {(row["library"], row["what"], row["preset"]): row for row in rows}
    assert {("torch", "balanced", "path"), ("numpy", "balanced", "path"), ("jax", "balanced", "path")} < set(measured)
    notes = {row["library"]: row["note"] for row in rows if not row["ms"]}
    assert notes == {
        "pytorch-msssim": "not installed",
        "torchmetrics": "not installed",
        "kornia": "needs 64 pixels a side",
    }
    assert all(float(row["ms"]) > 0 and int(row["evaluations"]) >= 3 for row in rows if not row["note"])
    printed = capsys.readouterr().out
    assert "| balanced / pytorch-msssim | 256x192 | not measured | 1 or less |  |" in printed


def test_the_speed_benchmark_measures_peak_memory_in_a_fresh_process() -> None:
    arguments = ["--sizes", "96", "--memory-of", "torch|plain conv2d|path|cpu"]
    peak = float(run(sys.executable, "-m", "benchmarks.speed", *arguments, cwd=ROOT).split()[-1])
    stack = 17 * 3 * 96 * 96 * 4
    assert peak > 2 * stack  # autograd keeps histograms at two inner scales


@pytest.mark.parametrize("page", first_result.PAGES)
def test_a_first_program_is_timed_only_if_it_prints_the_output_on_its_page(page: str, tmp_path: Path) -> None:
    program, expected = first_result.first_program(ROOT / "docs" / "guide" / f"{page}.md")
    assert expected.strip()
    python = Path(sys.executable)
    assert first_result.program_seconds(python, f"print({expected!r}, end='')", expected, tmp_path) > 0.0
    with pytest.raises(ValueError, match="printed '', expected"):
        first_result.program_seconds(python, f"{program.splitlines()[0]!r}", expected, tmp_path)

"""The command ``loi tradeoff``: its measurements, its page and its errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core.cli import main
from loi_core.tradeoff import TOLERANCE, Row, Setting, pareto_set, run
from tests.helpers import Host
from tests.tradeoff.command import NUMPY, Plugins, tradeoff

ROW = {
    *("backend", "device", "accuracy", "dtype", "change", "sigma", "alpha", "beta", "levels", "seconds", "runs"),
    *("memory_bytes", "error", "parameter_error", "pareto", "problem"),
}

ANSWER = {
    *(
        "problem",
        "machine",
        "load",
        "rows",
        "missing",
        "stochastic",
        "noises",
        "recommendation",
        "interrupted",
        "report",
    ),
}


def test_two_images_are_measured_end_to_end(
    plugins: Plugins, without_numba: None, pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = tradeoff(tmp_path / "out", capsys, *pair)
    assert set(result) == ANSWER
    assert (result["problem"]["height"], result["problem"]["width"]) == (12, 10)
    assert all(set(row) == ROW for row in result["rows"])
    grid = [(row["accuracy"], row["dtype"]) for row in result["rows"] if row["change"] is None]
    assert sorted(grid) == sorted((a, d) for a in ("exact", "balanced", "fast") for d in ("float32", "float64"))
    assert {"half beta", "twice beta"} < {row["change"] for row in result["rows"]}
    for row in result["rows"]:
        assert row["problem"] is None
        assert row["seconds"] > 0.0
        assert row["runs"] >= 1
        assert row["parameter_error"] is None
        promised = {"exact": 1e-3 if row["dtype"] == "float32" else 1e-12, "balanced": 1e-2, "fast": 5e-2}
        assert row["error"] > 1e-3 if row["change"] else row["error"] <= promised[row["accuracy"]], row
    points = [(row["seconds"], row["error"]) for row in result["rows"]]
    assert [row["pareto"] for row in result["rows"]] == pareto_set(points)
    advised = result["rows"][result["recommendation"]["index"]]
    assert advised["change"] is None
    assert result["recommendation"]["error"] == advised["error"] <= TOLERANCE
    assert not result["interrupted"]
    stored = json.loads((tmp_path / "out" / "tradeoff.json").read_text())
    assert stored == {key: value for key, value in result.items() if key != "report"}


def test_the_page_of_a_tradeoff_contains_its_images_chart_and_tables(
    plugins: Plugins, in_this_process: None, pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tradeoff", "--seconds", "1e-3", "--output", str(tmp_path / "out"), *pair]) == 0
    printed = capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2
    assert "http:" not in page
    assert "https:" not in page
    assert page.count('<svg viewBox="0 0 420 250" role="img"') == 1
    sentence = json.loads((tmp_path / "out" / "tradeoff.json").read_text())["recommendation"]["sentence"]
    assert f"Recommended: {sentence}" in printed
    assert "without a renderer" in sentence
    assert "Large errors of float32" not in printed
    assert printed.count("| numpy") == page.count("<td>numpy</td>") == 10


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--image", "{a}"], "`--image` and `--reference` go together, got only `--image`"),
        (["--reference", "{a}"], "got only `--reference`"),
        (["--image", "{a}", "--reference", "{b}", "--scene", "disks"], "exclude each other"),
        (["--image", "{a}", "--reference", "{small}"], "must have the same shape, got (12, 10, 3) and (6, 10, 3)"),
        (["--image", "{a}", "--reference", "{a}"], "`image` has no gradient"),
        (["--image", "{a}", "--reference", "none.png"], "none.png: no such image file"),
        (["--scene", "teapot"], "`--scene` must be a file that ends in .toml, or one of disks, photograph"),
        (["--scene", "none.toml"], "none.toml: no such scene file"),
        (["--image", "{a}", "--reference", "{b}", "--backend", "fortran"], "no backend is called 'fortran'"),
        (["--seconds", "0"], "`--seconds` must be a finite number, more than 0, got 0.0"),
        (["--seconds", "nan"], "`--seconds` must be"),
        (["--output", "{a}"], "`--output` must lead to a folder"),
        (["--output", "a\0b"], "`--output` must lead to a folder"),
        (["--seconds", "soon"], "invalid float value: 'soon'"),
    ],
)
def test_wrong_calls_are_one_line_and_write_nothing(
    plugins: Plugins,
    pair: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    np.save(tmp_path / "small.npy", np.zeros((6, 10, 3)))
    paths = {name: str(tmp_path / f"{name}.npy") for name in ("a", "b", "small")}
    files = sorted(tmp_path.iterdir())
    options = ["--output", str(tmp_path / "out"), *(argument.format(**paths) for argument in arguments)]
    assert main(["tradeoff", *options]) == 2
    printed = capsys.readouterr()
    assert message in printed.err.splitlines()[-1]
    assert printed.out == ""
    assert sorted(tmp_path.iterdir()) == files


def test_ctrl_c_keeps_the_finished_measurements(
    plugins: Plugins,
    pair: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[str] = []

    def interrupted(factory: str, setting: Setting, *_: Any) -> tuple[Row, Host]:
        calls.append("")
        if len(calls) == 3:
            raise KeyboardInterrupt
        return Row(setting, "cpu", 1.0, 1), np.ones((12, 10, 3))

    monkeypatch.setattr(run, "measure_setting", interrupted)
    result = tradeoff(tmp_path / "out", capsys, *pair, code=1)
    assert result["interrupted"]
    assert len(result["rows"]) == 2
    assert (tmp_path / "out" / "report.html").is_file()


def test_a_busy_machine_is_reported(
    plugins: Plugins,
    pair: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        run, "measure_setting", lambda _, setting, *__: (Row(setting, "cpu", 1.0, 1), np.ones((12, 10, 3)))
    )
    for load, is_busy in ((1e3, True), (0.0, False)):
        monkeypatch.setattr("os.getloadavg", lambda load=load: (load, 0.0, 0.0))
        assert main(["tradeoff", *pair, "--output", str(tmp_path / "out")]) == 0
        assert ("The machine was busy" in capsys.readouterr().out) == is_busy


def test_large_errors_of_float32_on_flat_images_are_explained(
    plugins: Plugins, in_this_process: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugins(NUMPY)
    for column, name in ((4, "left"), (36, "right")):
        flat = np.full((48, 48, 3), 0.05)
        flat[column : column + 8, column : column + 8] = 0.9
        np.save(tmp_path / f"{name}.npy", flat)
    distant = ["--image", str(tmp_path / "left.npy"), "--reference", str(tmp_path / "right.npy")]
    assert main(["tradeoff", "--seconds", "1e-3", "--output", str(tmp_path / "out"), *distant]) == 0
    assert "Large errors of float32" in capsys.readouterr().out

"""`loi doctor --stability` reports the true state of hard cases on the installed backends."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from loi_core.cli import main, stability
from loi_core.plugins import registry
from loi_core.stability import hard_cases

FEW = ("ordinary pair", "one NaN", "ties", "big-endian")
NUMPY = EntryPoint("numpy", "loi_core.plugins.measurement_backends:NumPy", registry.BACKENDS.name)
WRONG = """
from loi_core.plugins.measurement_backends import NumPy


class Wrong(NumPy):
    def prepare(self, request):
        evaluate = super().prepare(request)
        return lambda: (-evaluate()[0], evaluate()[1])


class Stops(NumPy):
    def prepare(self, request):
        raise KeyboardInterrupt
"""


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[EntryPoint]:
    (tmp_path / "unstable_backends.py").write_text(WRONG)
    monkeypatch.syspath_prepend(str(tmp_path))
    points = [NUMPY]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    monkeypatch.setattr(stability, "hard_cases", lambda: tuple(case for case in hard_cases() if case.name in FEW))
    return points


def test_the_table_of_hard_cases_has_every_case_and_dtype(
    few: list[EntryPoint], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", "--stability", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    verdicts = {(row["case"], row["dtype"]): row["verdict"] for row in rows}
    assert verdicts == {
        **{("ordinary pair", dtype): "ok" for dtype in ("float16", "float32", "float64")},
        **{("one NaN", dtype): "refused" for dtype in ("float32", "float64")},
        **{("ties", dtype): "loose" for dtype in ("float32", "float64")},
        ("big-endian", ">f4"): "refused",
    }
    first = rows[0]
    assert 0.0 <= first["loss_error"] <= first["loss_bound"]
    assert 0.0 < first["gradient_error"] <= first["gradient_bound"] < first["gradient_size"]
    assert next(row for row in rows if row["case"] == "one NaN")["loss"] is None
    assert main(["doctor", "--stability"]) == 0
    printed = capsys.readouterr().out
    assert [line.split()[:7] for line in printed.splitlines()[1:5]] == [
        ["numpy", "float32", "1", "1", "1", "0", "0"],
        ["numpy", "float64", "1", "1", "1", "0", "0"],
        ["numpy", "float16", "1", "0", "0", "0", "0"],
        ["numpy", "other", "arrays", "0", "0", "1", "0"],
    ]
    assert "8 rows" in printed


def test_a_wrong_or_broken_backend_fails_and_is_named(
    few: list[EntryPoint], capsys: pytest.CaptureFixture[str]
) -> None:
    few.append(EntryPoint("wrong", "unstable_backends:Wrong", registry.BACKENDS.name))
    few.append(EntryPoint("absent", "no_such_module:Backend [gpu]", registry.BACKENDS.name))
    assert main(["doctor", "--stability"]) == 1
    printed = capsys.readouterr().out
    assert "ordinary pair, wrong float32: not negative: the loss is -0.52" in printed
    assert "not tried: absent: " in printed
    assert "pip install 'unknown[gpu]'" in printed
    few[1:] = [EntryPoint("broken", "math:no_such_thing", registry.BACKENDS.name)]
    assert main(["doctor", "--stability", "--json"]) == 1
    assert "no_such_thing" in json.loads(capsys.readouterr().out)["broken"]["broken"]


def test_an_interrupted_run_keeps_the_finished_rows(few: list[EntryPoint], capsys: pytest.CaptureFixture[str]) -> None:
    few.append(EntryPoint("stops", "unstable_backends:Stops", registry.BACKENDS.name))
    assert main(["doctor", "--stability", "--json"]) == 1
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["dtype"] for row in rows] == ["float32", "float64", "float16"]

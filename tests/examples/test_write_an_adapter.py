"""Tests of the page on writing an adapter: its files form an installable package, and its commands run."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from tests.environments import ROOT, copied_python, run

PAGE = (ROOT / "docs" / "write-an-adapter.md").read_text()
FILES = dict(re.findall(r'^```\w+ title="([^"]+)"\n(.*?)^```$', PAGE, re.MULTILINE | re.DOTALL))
COMMANDS = [line for block in re.findall(r"^```sh\n(.*?)^```$", PAGE, re.M | re.S) for line in block.splitlines()]
# A new environment has no compiled code in its cache: without Numba the tests take less time.
ISOLATED_ENVIRONMENT = {"PYTHONPATH": "", "LOI_COMPILED": "0"}
TRUTH = [50.0, 44.0]


def test_every_block_of_the_page_is_a_file_or_a_command() -> None:
    assert list(FILES) == ["loi_blob.py", "pyproject.toml", "find.py", "scene.toml", "check.py", "charbonnier.py"]
    uses = ["python find.py", "loi fit scene.toml", "python check.py", "python charbonnier.py"]
    assert ["pip install .", "loi renderers", *uses] == COMMANDS
    assert PAGE.count("```") == 2 * (len(FILES) + 4)


def test_the_renderer_of_the_example_adapter_has_under_thirty_lines() -> None:
    assert len([line for line in FILES["loi_blob.py"].splitlines() if line.strip()]) < 30


class Shell:
    """Shell with the environment of the adapter, in a folder with the files of the page."""

    def __init__(self, folder: Path, python: Path) -> None:
        self.folder = folder
        self._path = f"{python.parent}{os.pathsep}{os.environ['PATH']}"

    def __call__(self, command: str) -> str:
        # The commands must not import the repository, from the working directory or through PYTHONPATH.
        environment = {**ISOLATED_ENVIRONMENT, "PIP_CONSTRAINT": str(ROOT / "constraints.txt")}
        return run("sh", "-c", command, cwd=self.folder, PATH=self._path, **environment)


@pytest.fixture(scope="module")
def shell(fresh: Path, tmp_path_factory: pytest.TempPathFactory) -> Shell:
    folder = tmp_path_factory.mktemp("blob")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    shell = Shell(folder, copied_python(fresh, tmp_path_factory.mktemp("plugin")))
    shell(COMMANDS[0])
    return shell


def test_the_example_adapter_is_listed_as_ready(shell: Shell) -> None:
    assert re.search(r"^blob +- +ready +loi-blob 0\.1\.0 ", shell("loi renderers"), re.MULTILINE)
    listed = {entry["name"]: entry for entry in json.loads(shell("loi renderers --json"))}
    assert listed["blob"] == {
        "name": "blob",
        "package": "loi-blob",
        "version": "0.1.0",
        "backend": "",
        "target": "loi_blob:Blob",
        "state": "ready",
        "problem": "",
        "fix": "",
    }
    assert listed["disks"]["state"] == listed["warp"]["state"] == "ready"


def test_the_example_adapter_converges_from_python_and_from_a_scene_file(shell: Shell) -> None:
    result = [float(word) for word in shell("python find.py").split()]
    np.testing.assert_allclose(result, TRUTH, atol=0.05)
    shell("loi fit scene.toml")
    result = json.loads((shell.folder / "scene-result" / "result.json").read_text())
    assert result["trials"][0]["parameter_errors"]["centre"] < 0.05
    assert (shell.folder / "scene-result" / "report.html").exists()


def test_the_example_adapter_passes_the_conformance_kit(shell: Shell) -> None:
    shell("python check.py")


def test_the_example_objective_passes_the_conformance_kit(shell: Shell) -> None:
    shell("python charbonnier.py")

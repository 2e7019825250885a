"""Blocks of the documentation are correct: Python runs, commands exist, settings are read."""

from __future__ import annotations

import importlib
import importlib.util
import re
import shlex
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core.io.images import write_png
from loi_core.plugins.registry import BACKENDS, OBJECTIVES, RENDERERS
from loi_core.scenes.reading import load_scene
from loi_core.sweeps.reading import read_sweep
from tests.docs.blocks import Block, blocks_of, run_python
from tests.docs.setups import SETUPS
from tests.environments import ROOT, run
from tests.public_names import PACKAGES
from tests.strategies import THOROUGH

GUIDE = sorted((ROOT / "docs" / "guide").glob("*.md"))
RESULTS = sorted((ROOT / "docs" / "results").glob("*.md"))
PAGES = [*GUIDE, *sorted((ROOT / "docs").glob("*.md")), *RESULTS, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
RUN_ELSEWHERE = {"write-an-adapter": "tests/examples/test_write_an_adapter.py"}
MAX_WORDS = 2000  # ten minutes of reading


def has_python(page: Path) -> bool:
    return any(block.language.startswith("python") for block in blocks_of(page))


def skip_without_imports(text: str) -> None:
    for package in ("torch", "jax", "mitsuba", "optax", "scipy", "cmaes"):
        if re.search(rf"^(?:import|from) {package}\b", text, re.MULTILINE):
            pytest.importorskip(package)


@pytest.mark.parametrize("page", [page for page in GUIDE if has_python(page)], ids=lambda page: page.stem)
def test_the_blocks_of_the_guide_run_and_print_the_output_on_the_page(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    skip_without_imports(page.read_text())
    monkeypatch.chdir(tmp_path)
    assert run_python(page, {"__name__": "__main__"}) > 0


@pytest.mark.parametrize("name", SETUPS)
def test_the_blocks_of_the_detailed_pages_run_after_their_setups(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = ROOT / "docs" / f"{name}.md"
    skip_without_imports(page.read_text() + SETUPS[name].replace("import torch, loi_torch", "import torch"))
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"__name__": "__main__"}
    exec(SETUPS[name], namespace)  # noqa: S102
    assert run_python(page, namespace, shortened=True) > 0


def test_no_page_with_python_is_left_out() -> None:
    detailed = {page.stem for page in (ROOT / "docs").glob("*.md") if has_python(page)}
    assert detailed == set(SETUPS) | set(RUN_ELSEWHERE)
    assert all((ROOT / test).exists() for test in RUN_ELSEWHERE.values())


def test_the_plan_on_the_page_about_accuracy_is_the_printed_plan() -> None:
    pytest.importorskip("numba")  # whose line the page shows
    assert run_python(ROOT / "docs" / "results" / "accuracy.md", {}) == 1


@pytest.mark.parametrize("page", GUIDE, ids=lambda page: page.stem)
def test_a_page_of_the_guide_takes_at_most_ten_minutes_to_read(page: Path) -> None:
    assert len(page.read_text().split()) <= MAX_WORDS


COMMANDS = [
    pytest.param(line.split(" # ")[0].strip(), id=f"{page.stem}: {line.strip()[:60]}")
    for page in PAGES
    for line in dict.fromkeys(
        [
            *(command for block in blocks_of(page) if block.language == "sh" for command in block.text.splitlines()),
            *re.findall(r"^ {4}((?:loi|make|python|pip) .*[^\\])$", page.read_text(), re.MULTILINE),
        ]
    )
]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_documentation_exists(command: str) -> None:
    words = shlex.split(command)
    match words[0]:
        case "loi":
            importlib.import_module("loi_core.cli.main")._parser().parse_args(words[1:])
        case "make":
            makefile = (ROOT / "Makefile").read_text()
            assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in words[1:])
        case "pip":
            extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
            extra_lists = re.findall(r"(?:loi|^\.)\[([^]]*)]", " ".join(words[2:]).replace("-e ", "\n")) + re.findall(
                r"-e \.\[([^]]*)]", " ".join(words)
            )
            assert {extra for names in extra_lists for extra in names.split(",")} <= set(extras)
        case "python" if words[1] == "-m":
            spec = importlib.util.find_spec(words[2])
            assert spec is not None
            assert spec.origin is not None
            folder = Path(spec.origin).parent
            sources = "".join(file.read_text() for file in [Path(spec.origin), *folder.rglob("*.py")])
            assert all(f'"{option}"' in sources for option in words[3:] if option.startswith("--"))
        case program:
            assert program in (".", "python", "ulimit", ".venv/bin/pip", ".venv/bin/pre-commit")


TABLES = [
    pytest.param(block, id=f"{page.stem}, line {block.line}")
    for page in PAGES
    for block in blocks_of(page)
    if block.language == "toml"
]


@pytest.mark.parametrize("block", TABLES)
def test_every_table_of_settings_is_read(block: Block, tmp_path: Path) -> None:
    table = tomllib.loads(block.text)
    (tmp_path / "scene.toml").write_text(block.text)
    for name, size in (("photo", (24, 32)), ("background", (24, 32)), ("picture", (8, 8))):
        write_png(tmp_path / f"{name}.png", np.full((*size, 3), 0.5))
    if table.get("renderer", {}).get("name") == "warp":
        assert set(load_scene(tmp_path / "scene.toml").views) != set()
    elif "vary" in table:
        guide = blocks_of(ROOT / "docs" / "guide" / "sweeps.md")
        (tmp_path / "scene.toml").write_text(next(block.text for block in guide if block.language == "toml"))
        (tmp_path / "sweep.toml").write_text(block.text)
        assert len(read_sweep(tmp_path / "sweep.toml").axes) == 2
    elif "project" in table:
        assert set(table["project"]["entry-points"]) <= {group.name for group in (RENDERERS, OBJECTIVES, BACKENDS)}
    else:
        assert {"renderer", "views"} & set(table)


def test_every_public_package_has_a_page_of_the_reference() -> None:
    pages = {page.stem: page.read_text() for page in (ROOT / "docs" / "api").glob("*.md")}
    assert all(f"```{{public-names}} {package}\n" in pages[package] for package in PACKAGES)


@pytest.mark.skipif(not THOROUGH, reason="two minutes; in the thorough tier, and `make docs`")
def test_the_site_builds_without_a_warning_and_every_public_name_has_an_entry(tmp_path: Path) -> None:
    pytest.importorskip("furo")
    printed = run(sys.executable, "-m", "sphinx", "-b", "html", "-W", "-n", str(ROOT / "docs"), str(tmp_path), cwd=ROOT)
    counts = re.search(r"(\d+) of (\d+) public names have an entry", printed)
    assert counts is not None
    assert counts[1] == counts[2]

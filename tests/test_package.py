"""The distribution: the content of the wheel, and the modules that an import loads."""

from __future__ import annotations

import json
import re
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path
from typing import Final

import pytest
from packaging.requirements import Requirement

from loi_core import __version__
from tests.docs.blocks import blocks_of
from tests.environments import ROOT, TEST_PACKAGES, build_sdist, build_wheel, copied_python, run, run_copied_tests
from tests.strategies import THOROUGH, thorough

PACKAGES = {"loi", "loi_core", "loi_torch", "loi_jax", "loi_mitsuba", "mitsuba_boundaries"}
FRAMEWORKS = ("torch", "jax", "mitsuba", "drjit", "numba", "matplotlib", "PIL", "scipy")


def test_the_wheel_has_exactly_the_packages(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == PACKAGES
    sources = {
        str(path.relative_to(ROOT)).removeprefix("adapters/")
        for folder in ("loi", "loi_core", "adapters")
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and path.suffix in (".py", ".typed", ".css", ".js", ".toml", ".png", ".ply", ".xml")
    }
    assert {name for name in names if ".dist-info/" not in name} == sources
    assert {f"{package}/py.typed" for package in PACKAGES} <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_the_description_on_pypi_has_only_absolute_links(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    description = archive.read(next(name for name in archive.namelist() if name.endswith("METADATA"))).decode()
    links = re.findall(r"\]\(([^)]+)\)", re.sub(r"```.*?```", "", description, flags=re.DOTALL))
    assert len(links) > 10
    assert [link for link in links if not link.startswith("https://")] == []


def test_the_sdist_builds_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    with tarfile.open(build_sdist(tmp_path)) as sdist:
        sdist.extractall(tmp_path, filter="data")
    (unpacked,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert {"CITATION.cff", "README.md", "LICENSE", "constraints.txt", "tests"} <= {
        path.name for path in unpacked.iterdir()
    }
    rebuilt = build_wheel(tmp_path / "rebuilt", unpacked)
    first, second = (zipfile.ZipFile(path) for path in (wheel, rebuilt))
    assert sorted(first.namelist()) == sorted(second.namelist())
    assert all(first.read(name) == second.read(name) for name in first.namelist())


README_SETUP: Final = """
import numpy as np
from loi.renderers import Disks
height, width = 24, 32
renderer = Disks(height, width, [[24.0, 16.0]], 3.0, [[1.0, 0.5, 0.2]])
photograph = renderer.render(renderer.parameters())
params = {**renderer.parameters(), "positions": np.array([[8.0, 8.0]])}
def update(params, gradient):
    slope = gradient["positions"]
    return {**params, "positions": params["positions"] - 0.2 * slope / max(np.linalg.norm(slope), 1e-12)}
"""


def test_the_first_lines_of_the_readme_find_a_disk_in_an_empty_environment(fresh: Path, tmp_path: Path) -> None:
    block = next(block for block in blocks_of(ROOT / "README.md") if block.language == "python")
    assert block.text.startswith("import loi\n")
    end = "assert np.abs(params['positions'] - [24.0, 16.0]).max() < 0.5, params\n"
    run(fresh, "-c", f"{README_SETUP}\n{block.text}\n{end}", cwd=tmp_path, LOI_COMPILED="0")


def test_the_commands_name_what_an_empty_environment_lacks(fresh: Path) -> None:
    listed = json.loads(run(fresh.parent / "loi", "renderers", "--json"))
    assert {renderer["name"]: renderer["state"] for renderer in listed} == {
        "disks": "ready",
        "disks-jax": "missing",
        "disks-torch": "missing",
        "mitsuba": "missing",
        "mitsuba-planned": "missing",
        "vector-torch": "missing",
        "mesh-torch": "missing",
        "warp": "ready",
        "warp-torch": "missing",
    }
    fixes = {renderer["name"]: renderer["fix"] for renderer in listed if renderer["state"] == "missing"}
    assert fixes == {
        "disks-jax": "pip install 'loi[jax]'",
        "disks-torch": "pip install 'loi[torch]'",
        "mitsuba": "pip install 'loi[mitsuba]'",
        "mitsuba-planned": "pip install 'loi[mitsuba]'",
        "vector-torch": "pip install 'loi[svg]'",
        "mesh-torch": "pip install 'loi[mesh]'",
        "warp-torch": "pip install 'loi[kornia]'",
    }
    doctor = json.loads(run(fresh.parent / "loi", "doctor", "--json", LOI_COMPILED="0"))
    states = {check["name"]: check["state"] for check in doctor}
    assert states["torch"] == states["jax"] == states["mitsuba"] == "missing"
    assert states["numba"] == "note"  # installed, and disabled
    installed = run(fresh, "-m", "pip", "list", "--format=freeze", "--disable-pip-version-check")
    assert not re.search(r"^(torch|jax|mitsuba|scipy|matplotlib)==", installed, re.MULTILINE)


def test_the_base_install_fits_a_bundled_scene_and_draws_its_report(fresh: Path, tmp_path: Path) -> None:
    code = (
        "from pathlib import Path\n"
        "from loi_core.cli.bundled import copy_scene\n"
        "print(copy_scene('disks', Path('disks')))\n"
    )
    scene = run(fresh, "-c", code, cwd=tmp_path).strip()
    command = (fresh.parent / "loi", "fit", scene, "--steps", "120", "--json")
    result = json.loads(run(*command, cwd=tmp_path, LOI_COMPILED="0"))
    assert result["trials"][0]["diagnosis"]["verdict"] == "converged"
    page = (tmp_path / "disks" / "result" / "report.html").read_text()
    assert page.count("<svg viewBox") >= 4


@thorough
def test_the_wheel_measures_the_cost_of_accuracy_in_an_empty_environment(fresh: Path, tmp_path: Path) -> None:
    code = "import numpy as np; np.save('a.npy', np.eye(12)); np.save('b.npy', np.eye(12)[::-1])"
    run(fresh, "-c", code, cwd=tmp_path)
    images = ("--image", "a.npy", "--reference", "b.npy")
    result = json.loads(
        run(fresh.parent / "loi", "tradeoff", *images, "--seconds", "1e-3", "--json", cwd=tmp_path, LOI_COMPILED="0")
    )
    assert {row["backend"] for row in result["rows"] if row["problem"] is None} == {"numpy"}
    assert {backend["name"]: backend["fix"] for backend in result["missing"]} == {
        "jax": "pip install 'loi[jax]'",
        "mitsuba": "pip install 'loi[mitsuba]'",
        "torch": "pip install 'loi[torch]'",
    }


def test_numba_is_installed_with_the_wheel_and_used(fresh: Path) -> None:
    code = (
        "import numpy as np, loi\n"
        "print(loi.LOIObjective(np.zeros((8, 8, 3))).plan())\n"  # compiles nothing
    )
    assert "in loops compiled by Numba" in run(fresh, "-c", code)


NO_NUMBA = {
    "darwin": ("x86_64",),
    "linux": ("riscv64", "ppc64le", "armv7l"),
    "win32": ("ARM64", "x86"),
}
NUMBA = {"darwin": ("arm64",), "linux": ("x86_64", "aarch64"), "win32": ("AMD64",)}


@pytest.mark.parametrize("system", NUMBA)
def test_numba_is_required_on_exactly_the_systems_with_wheels(system: str) -> None:
    requirements = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    (numba,) = (Requirement(text) for text in requirements if text.startswith("numba"))
    assert numba.marker is not None
    for machines, python, expected in (
        (NUMBA[system], "3.11", True),
        (NUMBA[system], "3.14", True),
        (NUMBA[system], "3.16", False),
        (NO_NUMBA[system], "3.12", False),
    ):
        for machine in machines:
            environment = {"sys_platform": system, "platform_machine": machine, "python_version": python}
            assert numba.marker.evaluate(environment) == expected


HIDE_PACKAGES = """
import importlib.abc, sys
class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.split(".")[0] in {absent!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
"""
ABSENT = {"torch", "jax", "jaxlib", "mitsuba", "drjit", "numba", "llvmlite", "kornia", "array_api_strict"}


def test_the_installed_core_passes_its_tests_with_numpy_alone(fresh: Path, tmp_path: Path) -> None:
    python = copied_python(fresh, tmp_path / "environment")
    pins = "-c", ROOT / "constraints.txt"
    run(sys.executable, "-m", "uv", "pip", "install", "--quiet", "--python", python, *pins, *TEST_PACKAGES)
    setup = HIDE_PACKAGES.format(absent=ABSENT)
    quick = ("pixels", "objectives/test_loss.py")
    output = run_copied_tests(
        python,
        tmp_path / "tests",
        *(("method", "objectives", "pixels", "renderers") if THOROUGH else quick),
        setup=setup,
    )
    assert re.search(r"[1-9]\d+ passed", output)


def test_importing_the_core_loads_no_framework() -> None:
    code = f"import sys, loi_core; print([n for n in {FRAMEWORKS!r} if n in sys.modules])"
    assert run(sys.executable, "-c", code).strip() == "[]"


def test_every_pinned_version_is_exact_and_every_requirement_is_pinned() -> None:
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][0-9A-Za-z.]*", line) for line in lines)
    pinned = {re.sub(r"[-_.]+", "-", line.split("==")[0]).lower() for line in lines}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"].values()
    requirements = [*project["dependencies"], *(requirement for extra in extras for requirement in extra)]
    names = {re.split(r"[<>=\[; ]", requirement)[0] for requirement in requirements} - {"loi", "mitsuba"}
    assert {re.sub(r"[-_.]+", "-", name).lower() for name in names} <= pinned


def test_the_workflows_run_every_python_that_the_package_names() -> None:
    yaml = pytest.importorskip("yaml")
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "test.yml").read_text())["jobs"]
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["classifiers"]
    pythons = [name for line in classifiers if re.fullmatch(r"3\.\d+", name := line.rpartition(" ")[2])]
    assert jobs["core"]["strategy"]["matrix"]["python"] == pythons
    ends = [row["python"] for row in jobs["versions"]["strategy"]["matrix"]["include"]]
    assert ends == [pythons[0], pythons[-1]]
    commands = [step.get("run", "") for job in jobs.values() for step in job["steps"]]
    folders = [word for command in commands for word in command.split() if word.startswith("tests/")]
    assert len(folders) > 3
    assert all((ROOT / folder).is_dir() for folder in folders)


def test_the_citation_names_this_version_and_the_paper() -> None:
    yaml = pytest.importorskip("yaml")
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert cited["cff-version"] == "1.2.0"
    assert cited["version"] == __version__
    assert cited["license"] == project["license"]
    paper = cited["preferred-citation"]
    assert [author["family-names"] for author in paper["authors"]] == ["Mehta", "Chandraker", "Ramamoorthi"]
    assert paper["title"] == "Locally Orderless Images for Optimization in Differentiable Rendering"
    assert paper["year"] == 2025

"""The distribution: what is in the wheel, what importing it loads, and how long that takes."""

from __future__ import annotations

import json
import re
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.environments import ROOT, fresh_python, run

PACKAGES = {"loi_core", "loi_torch", "loi_jax", "loi_mitsuba"}
FRAMEWORKS = ("torch", "jax", "mitsuba", "drjit", "numba", "matplotlib", "PIL", "scipy")


def test_the_wheel_holds_the_four_packages_and_nothing_else(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == PACKAGES
    sources = {
        str(path.relative_to(ROOT)).removeprefix("adapters/")
        for folder in ("loi_core", "adapters")
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and path.suffix in (".py", ".typed")
    }
    assert {name for name in names if ".dist-info/" not in name} == sources
    assert {f"{package}/py.typed" for package in PACKAGES} <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)


@pytest.fixture(scope="module")
def fresh(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fresh_python(tmp_path_factory.mktemp("fresh"), wheel)


def test_the_wheel_works_in_an_empty_environment(fresh: Path, tmp_path: Path) -> None:
    code = (
        "import numpy as np, loi_core as loi\n"
        "r = np.zeros((16, 16, 3)); r[8:12, 8:12] = 1.0\n"
        "v, g = loi.LOIObjective(r, loi.ScaleSpace.for_image(16, 16)).value_and_grad(r[::-1, ::-1].copy())\n"
        "assert float(v) > 0.0 and np.any(g)\n"
    )
    run(fresh, "-c", code)
    listed = json.loads(run(fresh.parent / "loi", "renderers", "--json"))
    assert {one["name"]: one["state"] for one in listed} == {
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
    fixes = {one["name"]: one["fix"] for one in listed if one["state"] == "missing"}
    assert fixes == {
        "disks-jax": "pip install 'loi[jax]'",
        "disks-torch": "pip install 'loi[torch]'",
        "mitsuba": "pip install 'loi[mitsuba]'",
        "mitsuba-planned": "pip install 'loi[mitsuba]'",
        "vector-torch": "pip install 'loi[torch]'",
        "mesh-torch": "pip install 'loi[torch]'",
        "warp-torch": "pip install 'loi[torch]'",
    }
    states = {one["name"]: one["state"] for one in json.loads(run(fresh.parent / "loi", "doctor", "--json"))}
    assert states["torch"] == states["jax"] == states["mitsuba"] == "missing"
    installed = run(fresh, "-m", "pip", "list", "--format=freeze", "--disable-pip-version-check")
    assert not re.search(r"^(torch|jax|mitsuba|scipy)==", installed, re.MULTILINE)


def test_the_wheel_measures_what_accuracy_costs_in_an_empty_environment(fresh: Path, tmp_path: Path) -> None:
    code = "import numpy as np; np.save('a.npy', np.eye(12)); np.save('b.npy', np.eye(12)[::-1])"
    run(fresh, "-c", code, cwd=tmp_path)
    images = ("--image", "a.npy", "--reference", "b.npy")
    found = json.loads(run(fresh.parent / "loi", "tradeoff", *images, "--seconds", "1e-3", "--json", cwd=tmp_path))
    assert {row["backend"] for row in found["rows"] if row["problem"] is None} == {"numpy"}
    assert {one["name"]: one["fix"] for one in found["missing"]} == {
        "jax": "pip install 'loi[jax]'",
        "mitsuba": "pip install 'loi[mitsuba]'",
        "torch": "pip install 'loi[torch]'",
    }


ALONE = """
import importlib.abc, sys
class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.split(".")[0] in {absent!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
import pytest
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", *{folders!r}]))
"""
ABSENT = {"torch", "jax", "jaxlib", "mitsuba", "drjit", "numba", "llvmlite", "kornia", "array_api_strict"}


def test_the_core_passes_its_tests_with_numpy_alone() -> None:
    folders = [str(ROOT / "tests" / name) for name in ("method", "pixels", "objectives", "renderers")]
    code = ALONE.format(absent=ABSENT, folders=folders)
    assert re.search(r"[1-9]\d+ passed", run(sys.executable, "-c", code, cwd=ROOT, HYPOTHESIS_PROFILE="quick"))


def test_importing_the_core_loads_no_framework() -> None:
    code = f"import sys, loi_core; print([n for n in {FRAMEWORKS!r} if n in sys.modules])"
    assert run(sys.executable, "-c", code).strip() == "[]"


def test_importing_the_core_takes_under_three_tenths_of_a_second_more_than_numpy() -> None:
    # Measured inside one process after NumPy is in, best of several: what is asked for is the library's own cost.
    code = "import numpy, time; start = time.perf_counter(); import loi_core; print(time.perf_counter() - start)"
    assert min(float(run(sys.executable, "-c", code)) for _ in range(5)) < 0.3


def test_every_pinned_version_is_exact_and_every_requirement_is_pinned() -> None:
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][0-9A-Za-z.]*", line) for line in lines)
    pinned = {re.sub(r"[-_.]+", "-", line.split("==")[0]).lower() for line in lines}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    names = {re.split(r"[<>=\[; ]", one)[0] for one in wanted} - {"loi", "mitsuba"}
    assert {re.sub(r"[-_.]+", "-", name).lower() for name in names} <= pinned

"""Backends: those of the project give the numbers of the core, and broken ones break nothing else."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import torch

from loi_core import LOIObjective, ScaleSpace
from loi_core.cli import main
from loi_core.plugins import registry
from loi_core.plugins.measurement_backends import BFLOAT16_PRODUCTS, MeasurementBackend, NumPy, Request
from loi_core.tradeoff import Setting, rows
from loi_core.tradeoff.memory import peak_memory
from tests.environments import ROOT
from tests.helpers import images, relative_error
from tests.tradeoff.command import NUMPY, Plugins, tradeoff

BROKEN = """\
import os

from loi_core.plugins.measurement_backends import NumPy


class Refuses:
    def __init__(self):
        raise RuntimeError("no licence\\nsecond line")


class Fails(NumPy):
    dtypes = ("float32",)

    def prepare(self, request):
        raise RuntimeError("out of luck")


class Crashes(Fails):
    def prepare(self, request):
        os._exit(7)
"""


def announced_backends() -> dict[str, MeasurementBackend]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    entries = project["entry-points"][registry.BACKENDS.name]
    return {name: EntryPoint(name, value, registry.BACKENDS.name).load()() for name, value in entries.items()}


@pytest.mark.parametrize("name", ["jax", "numpy", "torch"])
def test_every_backend_of_the_project_gives_the_numbers_of_the_core(name: str) -> None:
    backend = announced_backends()[name]
    image, reference = images((16, 12, 3), 3)
    scales = ScaleSpace((0, 2), (2, 5), 0.125)
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    for dtype, tolerance in (("float64", 1e-12), ("float32", 1e-3)):  # ties are what float32 sees differently
        assert dtype in backend.dtypes
        evaluate = backend.prepare(Request(image, reference, scales, "exact", dtype))
        for _ in range(2):
            got, slope = evaluate()
            assert got == pytest.approx(float(value), rel=tolerance)
            assert isinstance(slope, np.ndarray)
            assert slope.dtype == dtype
            assert relative_error(slope, gradient) < tolerance


def test_products_in_bfloat16_are_a_choice_of_torch_that_is_set_back() -> None:
    backend = announced_backends()["torch"]
    image, reference = images((40, 48, 3), 3)
    scales = ScaleSpace((0, 2), (2, 5), 0.125)
    value = float(LOIObjective(reference, scales).value(image))
    torch.set_float32_matmul_precision("high")
    try:
        got, slope = backend.prepare(Request(image, reference, scales, "exact", BFLOAT16_PRODUCTS))()
        assert torch.get_float32_matmul_precision() == "high"
    finally:
        torch.set_float32_matmul_precision("highest")
    assert slope.dtype == np.float32
    # Each of the products of a blur rounds both factors to 8 bits, and differences of CDFs are compared, not CDFs.
    assert got == pytest.approx(value, rel=2.0 * 4.0 * 2.0**-8)


def test_the_backends_of_the_project_are_all_tried() -> None:
    assert sorted(announced_backends()) == ["jax", "mitsuba", "numpy", "torch"]


def test_a_backend_is_found_by_its_name(plugins: Plugins) -> None:
    assert registry.BACKENDS.load("numpy") is NumPy
    assert [one.state for one in registry.BACKENDS.available()] == ["ready"]
    assert registry.available_renderers() == []


def test_a_broken_backend_is_reported_and_the_others_are_measured(
    plugins: Plugins,
    by_arrays: None,
    pair: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "broken_backends.py").write_text(BROKEN)
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins(
        NUMPY,
        EntryPoint("absent", "no_such_module:Backend [gpu]", registry.BACKENDS.name),
        *(EntryPoint(one.lower(), f"broken_backends:{one}", registry.BACKENDS.name) for one in ("Fails", "Refuses")),
    )
    found = tradeoff(tmp_path / "out", capsys, *pair)
    assert [(one["name"], one["fix"]) for one in found["missing"]] == [
        ("absent", "pip install 'unknown[gpu]'"),
        ("refuses", ""),
    ]
    assert found["missing"][1]["problem"] == "RuntimeError: no licence second line"
    by_backend = {name: [row for row in found["rows"] if row["backend"] == name] for name in ("numpy", "fails")}
    assert {row["problem"] for row in by_backend["fails"]} == {"RuntimeError: out of luck"}
    assert not any(row["pareto"] for row in by_backend["fails"])
    assert {row["problem"] for row in by_backend["numpy"]} == {None}
    assert found["rows"][found["recommendation"]["index"]]["backend"] == "numpy"


def test_a_backend_that_ends_its_process_ends_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_backends.py").write_text(BROKEN)
    monkeypatch.syspath_prepend(str(tmp_path))
    setting = Setting("crashes", "exact", "float32", ScaleSpace(1, 2, 0.25))
    said = rows.measure_setting("broken_backends:Crashes", setting, *images((8, 8, 1), 0), 1e-3)
    assert said == "its process ended with exit code 7"


def test_nothing_but_broken_backends_is_an_error(
    plugins: Plugins, pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugins(EntryPoint("absent", "no_such_module:Backend", registry.BACKENDS.name))
    assert main(["tradeoff", *pair, "--output", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "no backend can be measured: absent: ModuleNotFoundError" in said
    assert not (tmp_path / "out").exists()


def test_the_peak_of_memory_is_seen_after_it_has_passed() -> None:
    """In a process of its own: one that has held much may find room for more within what it has."""
    if peak_memory() is None:
        pytest.skip("the system does not tell")
    code = """
import numpy as np
from loi_core.tradeoff.memory import peak_memory, restart_peak
before = restart_peak()
np.ones(2**23).sum()  # 64 MiB, given back at once
print(peak_memory() - before)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert 60 * 2**20 < int(done.stdout) < 80 * 2**20


def test_a_larger_image_takes_more_memory() -> None:
    if peak_memory() is None:
        pytest.skip("the system does not tell")
    setting = Setting("numpy", "exact", "float64", ScaleSpace(1, 4, 0.125))
    small, large = (
        rows.measure_setting("loi_core.plugins.measurement_backends:NumPy", setting, *images((size, size, 3), 0), 1e-3)
        for size in (16, 192)
    )
    assert isinstance(small, rows.Sample)
    assert isinstance(large, rows.Sample)
    assert small.memory is not None
    assert large.memory is not None
    # The reference is kept as it is, blurred, and as places among the levels, all in float64; the gradient is a fourth.
    assert large.memory - small.memory > 4 * 192 * 192 * 3 * 8

"""Backends of the project return the numbers of the core, and broken backends affect no other."""

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
def test_every_backend_of_the_project_returns_the_numbers_of_the_core(name: str) -> None:
    backend = announced_backends()[name]
    image, reference = images((16, 12, 3), 3)
    scales = ScaleSpace((0, 2), (2, 5), 0.125)
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    for dtype, tolerance in (("float64", 1e-12), ("float32", 1e-3)):  # float32 decides ties differently
        assert dtype in backend.dtypes
        evaluate = backend.prepare(Request(image, reference, scales, "exact", dtype))
        for _ in range(2):
            actual, actual_gradient = evaluate()
            assert actual == pytest.approx(float(value), rel=tolerance)
            assert isinstance(actual_gradient, np.ndarray)
            assert actual_gradient.dtype == dtype
            assert relative_error(actual_gradient, gradient) < tolerance


def test_the_torch_switch_for_bfloat16_products_is_restored() -> None:
    backend = announced_backends()["torch"]
    image, reference = images((40, 48, 3), 3)
    scales = ScaleSpace((0, 2), (2, 5), 0.125)
    value = float(LOIObjective(reference, scales).value(image))
    torch.set_float32_matmul_precision("high")
    try:
        actual, gradient = backend.prepare(Request(image, reference, scales, "exact", BFLOAT16_PRODUCTS))()
        assert torch.get_float32_matmul_precision() == "high"
    finally:
        torch.set_float32_matmul_precision("highest")
    assert gradient.dtype == np.float32
    # Each product of a blur rounds both factors to 8 bits, and the differences of CDFs are compared.
    assert actual == pytest.approx(value, rel=2.0 * 4.0 * 2.0**-8)


def test_all_backends_of_the_project_are_announced() -> None:
    assert sorted(announced_backends()) == ["jax", "mitsuba", "numpy", "torch"]


def test_a_backend_is_loaded_by_name(plugins: Plugins) -> None:
    assert registry.BACKENDS.load("numpy") is NumPy
    assert [info.state for info in registry.BACKENDS.available()] == ["ready"]
    assert registry.available_renderers() == []


def test_a_broken_backend_is_reported_and_the_others_are_measured(
    plugins: Plugins,
    in_this_process: None,
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
        *(EntryPoint(name.lower(), f"broken_backends:{name}", registry.BACKENDS.name) for name in ("Fails", "Refuses")),
    )
    result = tradeoff(tmp_path / "out", capsys, *pair)
    assert [(backend["name"], backend["fix"]) for backend in result["missing"]] == [
        ("absent", "pip install 'unknown[gpu]'"),
        ("refuses", ""),
    ]
    assert result["missing"][1]["problem"] == "RuntimeError: no licence second line"
    by_backend = {name: [row for row in result["rows"] if row["backend"] == name] for name in ("numpy", "fails")}
    assert {row["problem"] for row in by_backend["fails"]} == {"RuntimeError: out of luck"}
    assert not any(row["pareto"] for row in by_backend["fails"])
    assert {row["problem"] for row in by_backend["numpy"]} == {None}
    assert result["rows"][result["recommendation"]["index"]]["backend"] == "numpy"


def test_a_backend_that_ends_its_process_affects_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_backends.py").write_text(BROKEN)
    monkeypatch.syspath_prepend(str(tmp_path))
    setting = Setting("crashes", "exact", "float32", ScaleSpace(1, 2, 0.25))
    row, gradient = rows.measure_setting("broken_backends:Crashes", setting, *images((8, 8, 1), 0), 1e-3)
    assert row.problem == "its process ended with exit code 7"
    assert gradient is None


def test_only_broken_backends_are_an_error(
    plugins: Plugins, pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugins(EntryPoint("absent", "no_such_module:Backend", registry.BACKENDS.name))
    assert main(["tradeoff", *pair, "--output", str(tmp_path / "out")]) == 2
    assert "no backend can be measured: absent: ModuleNotFoundError" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_peak_of_memory_is_known_after_the_memory_was_freed() -> None:
    """Runs in a separate process, since this process may reuse memory that it has freed."""
    if peak_memory() is None:
        pytest.skip("the system does not report memory")
    code = """
import numpy as np
from loi_core.tradeoff.memory import peak_memory, reset_peak
initial = reset_peak()
np.ones(2**23).sum()  # 64 MiB, freed at once
print(peak_memory() - initial)
"""
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert 60 * 2**20 < int(process.stdout) < 80 * 2**20


def test_a_larger_image_takes_more_memory() -> None:
    if peak_memory() is None:
        pytest.skip("the system does not report memory")
    setting = Setting("numpy", "exact", "float64", ScaleSpace(1, 4, 0.125))
    small, large = (
        rows.measure_setting("loi_core.plugins.measurement_backends:NumPy", setting, *images((size, size, 3), 0), 1e-3)[
            0
        ]
        for size in (16, 192)
    )
    assert small.memory is not None
    assert large.memory is not None
    # Four arrays of float64: the reference, its blur, its positions among the levels, and the gradient.
    assert large.memory - small.memory > 4 * 192 * 192 * 3 * 8

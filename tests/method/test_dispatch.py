"""Choice of the backend, also where Numba is missing, broken or disabled."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from numba.core.caching import _CacheLocator

from loi_core import LOIObjective
from loi_core.method import compiled
from loi_core.method.compiled import CompiledLoopsWarning
from loi_core.method.compiled.loop_comparison import LoopComparison
from loi_core.method.dispatch import ARRAY_API, NUMBA, choose_backend
from loi_core.support.arrays import Array
from tests.frameworks import array_api_strict, jax, jnp, torch
from tests.helpers import program_output

COMPARES = """
import sys, numpy as np
from loi_core import LOIObjective, ScaleSpace
image, reference = np.random.default_rng(0).uniform(size=(2, 40, 30, 1)).astype(np.float32)
objective = LOIObjective(reference, ScaleSpace(1, (1, 4), 0.25))
print(len({float(objective.value(image)) for _ in range(3)}), "numba" in sys.modules)
"""


def test_an_environment_variable_disables_numba() -> None:
    assert program_output(COMPARES, LOI_COMPILED="0") == "1 False"
    assert program_output(COMPARES, NUMBA_DISABLE_JIT="1") == "1 True"


def copy_compiled_kernels(target: Path) -> None:
    """Copy this process's cache of kernels, so that a test can damage the copy."""
    LOIObjective(np.zeros((4, 4, 1), np.float32)).value(np.ones((4, 4, 1), np.float32))
    folder = Path(compiled.__file__).parent
    subfolder = target / _CacheLocator.get_suitable_cache_subpath(str(folder / "levels.py"))
    shutil.copytree(folder / "__pycache__", subfolder, ignore=shutil.ignore_patterns("*.pyc"))


def test_a_damaged_cache_of_kernels_gives_one_warning(tmp_path: Path) -> None:
    copy_compiled_kernels(tmp_path)
    assert program_output(COMPARES, NUMBA_CACHE_DIR=str(tmp_path)) == "1 True"
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert files
    for path in files:
        os.truncate(path, path.stat().st_size // 2)
    assert program_output(COMPARES, NUMBA_CACHE_DIR=str(tmp_path)) == "1 TrueCompiledLoopsWarning"


def test_array_operations_replace_kernels_that_cannot_be_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        message = "no space left on device"
        raise OSError(message)

    image, reference = np.random.default_rng(0).uniform(size=(2, 20, 30, 1))
    value = float(LOIObjective(reference).value(image))
    monkeypatch.setattr(compiled, "_NUMBA", compiled._Numba())
    monkeypatch.setattr(LoopComparison, "compare", full)
    with pytest.warns(CompiledLoopsWarning, match="OSError: no space left on device"):
        assert float(LOIObjective(reference).value(image)) == pytest.approx(value, rel=1e-12)
    assert not compiled.available()
    assert float(LOIObjective(reference).value(image)) == pytest.approx(value, rel=1e-12)  # without another warning


def test_an_error_of_the_comparison_does_not_disable_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        message = "a mistake"
        raise ZeroDivisionError(message)

    image, reference = np.random.default_rng(0).uniform(size=(2, 20, 30, 1))
    objective = LOIObjective(reference)
    objective.value(image)
    monkeypatch.setattr(LoopComparison, "compare", fail)
    with pytest.raises(ZeroDivisionError, match="a mistake"):
        objective.value(image)
    assert compiled.available()


BROKEN = """
import importlib.abc, sys, time
class Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "numba":
            time.sleep(0.05)
            raise AttributeError("half of a Numba")
sys.meta_path.insert(0, Finder())
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from loi_core import LOIObjective
image, reference = np.random.default_rng(0).uniform(size=(2, 40, 30, 1))
objective = LOIObjective(reference)
with ThreadPoolExecutor(8) as threads:
    print(len(set(map(float, threads.map(objective.value, [image] * 16)))))
"""


def test_many_threads_compare_without_a_numba_that_cannot_be_imported() -> None:
    assert program_output(BROKEN) == "1"


@pytest.mark.parametrize(
    ("planes", "uses_numba"),
    [
        (lambda: np.zeros((1, 2, 2), np.float32), True),
        (lambda: torch.zeros((1, 2, 2), dtype=torch.float64), True),
        (lambda: torch.zeros((1, 2, 2), requires_grad=True), False),  # torch records operations
        (lambda: jnp.zeros((1, 2, 2), jnp.float32), True),
        (lambda: jnp.zeros((1, 2, 2), jnp.bfloat16), False),
        (lambda: array_api_strict.zeros((1, 2, 2)), False),
        (lambda: np.zeros((1, 2, 2), np.longdouble), False),
    ],
)
def test_kernels_compare_host_arrays_that_no_framework_differentiates(
    planes: Callable[[], Array], uses_numba: bool
) -> None:
    assert (choose_backend(planes()) is NUMBA) is uses_numba


def test_arrays_that_jax_traces_are_compared_by_array_operations() -> None:
    backends = []
    jax.jit(lambda planes: backends.append(choose_backend(planes)))(jnp.zeros((1, 2, 2), jnp.float32))
    assert backends == [ARRAY_API]


def test_a_plan_mentions_numba_only_where_kernels_run(monkeypatch: pytest.MonkeyPatch) -> None:
    objective = LOIObjective(np.zeros((4, 4, 3)))
    assert "Numba" in str(objective.plan())
    monkeypatch.setenv("LOI_COMPILED", "0")
    assert choose_backend(np.zeros((1, 2, 2))) is ARRAY_API
    assert "Numba" not in str(objective.plan())


@pytest.mark.parametrize("is_terminal", [True, False])
def test_the_first_compilation_is_announced_on_a_terminal(is_terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    numba = pytest.importorskip("numba")
    from loi_core.method.compiled.compiling import announced_on_terminals

    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: is_terminal)
    monkeypatch.setattr("sys.stderr", stream)
    with announced_on_terminals():
        for _ in range(2):
            assert numba.njit(lambda x: x + 1)(1) == 2
    assert stream.getvalue().count("\n") == int(is_terminal)
    numba.njit(lambda x: x + 2)(1)
    assert stream.getvalue().count("compiling") == int(is_terminal)

"""Run the tests of the Mitsuba adapter under one variant and with one thread, if Mitsuba is installed.

``LOI_MITSUBA_VARIANT=cuda_ad_rgb`` runs them on a GPU.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator

import pytest

from tests.frameworks import load_installed

VARIANT = os.environ.get("LOI_MITSUBA_VARIANT", "llvm_ad_rgb")

if importlib.util.find_spec("mitsuba") is None:  # pragma: no cover - depends on the environment
    collect_ignore_glob = ["*.py"]
else:
    import loi_mitsuba  # noqa: F401 - before Dr.Jit, to choose its LLVM

    # isort: split
    import drjit as dr
    import mitsuba as mi

    mi.set_variant(VARIANT)
    dr.set_thread_count(1)
    mi.set_log_level(mi.LogLevel.Error)  # Mitsuba logs advice about every new projective integrator


@pytest.fixture(autouse=True)
def _same_variant() -> Iterator[None]:
    """Restore the variant before and after each test, also for the fixtures of the module."""
    mi.set_variant(VARIANT)
    yield
    mi.set_variant(VARIANT)


@pytest.fixture
def kernel_history() -> Iterator[None]:
    """Record Dr.Jit's kernel history during the test."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history()
        yield
        dr.kernel_history()


load_installed("jax", "torch")

"""Frameworks for comparison with the core, imported at first use and configured alike everywhere.

Tests of a framework that is not installed are skipped. Names are placeholders of modules: ``torch.zeros(3)`` imports
torch.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
from types import ModuleType
from typing import Any, Final

import pytest

__all__ = [
    "array_api_strict",
    "jax",
    "jnp",
    "kornia",
    "load",
    "load_installed",
    "loi_jax",
    "loi_torch",
    "pytorch_msssim",
    "torch",
]


@functools.cache
def load(name: str) -> ModuleType:
    """Import a framework, with float64 and one thread, since tests run in several processes."""
    module = importlib.import_module(name)
    if name == "jax":
        module.config.update("jax_enable_x64", True)
    if name == "torch":
        module.set_num_threads(1)
    return module


def load_installed(*names: str) -> None:
    """Import the installed frameworks of a list, for modules that need them configured before the tests begin."""
    for name in names:
        if importlib.util.find_spec(name) is not None:
            load(name)


class _Framework:
    """A module that is imported when an attribute is used."""

    def __init__(self, name: str, package: str) -> None:
        self._name, self._package = name, package

    def __getattr__(self, name: str) -> Any:
        if name.startswith(("_", "pytest")):  # pytest inspects every object of a module
            raise AttributeError(name)
        pytest.importorskip(self._package)
        load(self._package)
        return getattr(load(self._name), name)


def _framework(name: str, package: str | None = None) -> Any:
    return _Framework(name, package or name)


array_api_strict: Final = _framework("array_api_strict")
jax: Final = _framework("jax")
jnp: Final = _framework("jax.numpy", "jax")
kornia: Final = _framework("kornia", "torch")
loi_jax: Final = _framework("loi_jax", "jax")
loi_torch: Final = _framework("loi_torch", "torch")
pytorch_msssim: Final = _framework("pytorch_msssim", "torch")
torch: Final = _framework("torch")

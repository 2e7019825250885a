"""The frameworks that tests compare the core with, imported when they are first used, and set up alike everywhere.

A test that uses one that is not installed is skipped. Names here stand for modules: ``torch.zeros(3)`` imports torch.
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
    """Import a framework, in float64 and on one thread: the tests run in several processes already."""
    module = importlib.import_module(name)
    if name == "jax":
        module.config.update("jax_enable_x64", True)
    if name == "torch":
        module.set_num_threads(1)
    return module


def load_installed(*names: str) -> None:
    """Import those frameworks of a list that are installed, where each has to be set up before the tests begin."""
    for name in names:
        if importlib.util.find_spec(name) is not None:
            load(name)


class _Framework:
    """A module that is imported when something of it is asked for."""

    def __init__(self, name: str, package: str) -> None:
        self._name, self._package = name, package

    def __getattr__(self, name: str) -> Any:
        if name.startswith(("_", "pytest")):  # what pytest asks of everything in a module
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

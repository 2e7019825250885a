"""The frameworks that tests compare the core with, imported when they are first used, and set up alike everywhere.

A test that uses one that is not installed is skipped. Names here stand for modules: ``torch.zeros(3)`` imports torch.
"""

from __future__ import annotations

import functools
import importlib
from types import ModuleType
from typing import Any, Final

import pytest

__all__ = ["array_api_strict", "jax", "jnp", "kornia", "load", "loi_jax", "loi_torch", "pytorch_msssim", "torch"]


@functools.cache
def load(name: str) -> ModuleType:
    """Import a framework, in float64 and on one thread: the tests run in several processes already."""
    module = importlib.import_module(name)
    if name == "jax":
        module.config.update("jax_enable_x64", True)
    if name == "torch":
        module.set_num_threads(1)
    return module


class _Framework:
    """A module that is imported when something of it is asked for."""

    def __init__(self, name: str, package: str) -> None:
        self._name, self._package = name, package

    def __getattr__(self, name: str) -> Any:
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

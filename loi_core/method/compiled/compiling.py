"""Numba's compiler with the settings of all kernels."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, TypeVar, cast

import numba
from numba.core import event

__all__ = ["announced_on_terminals", "compiled", "compiled_as_written", "compiled_sums"]

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile a function at its first call and cache it on disk; calls release the interpreter's lock.

    Products may be fused with sums; all other operations are rounded as written.
    """
    return _compiled(function, {"contract"})


def compiled_sums(function: F) -> F:
    """Compile like :func:`compiled`, with sums in any order, so that they can be vectorised."""
    return _compiled(function, {"contract", "reassoc", "nsz"})


def compiled_as_written(function: F) -> F:
    """Compile like :func:`compiled`, with every operation rounded as in IEEE 754, so that exact identities hold."""
    return _compiled(function, set())


class _Announcement(event.Listener):  # type: ignore[misc]  # Numba's types are not read, see pyproject.toml
    """Writes a line at the first compilation; kernels that are loaded from disk are none."""

    def __init__(self) -> None:
        self._is_silent = not sys.stderr.isatty()

    def on_start(self, event: Any) -> None:  # noqa: ARG002
        if not self._is_silent:
            sys.stderr.write("loi: compiling the comparison for this machine, once; ten to forty seconds\n")
            self._is_silent = True

    def on_end(self, event: Any) -> None:
        pass


def announced_on_terminals() -> AbstractContextManager[Any]:
    """Return a context that announces the first compilation on standard error, if standard error is a terminal."""
    installed: AbstractContextManager[Any] = event.install_listener("numba:compile", _Announcement())
    return installed


def _compiled(function: F, fastmath: set[str]) -> F:
    options: dict[str, Any] = {"nogil": True, "fastmath": fastmath, "error_model": "numpy"}
    try:
        return cast("F", numba.njit(cache=True, **options)(function))
    except RuntimeError:  # no writable cache folder: every process compiles
        return cast("F", numba.njit(**options)(function))

"""Numba's compiler with the settings of all kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

__all__ = ["compiled", "compiled_as_written", "compiled_sums"]

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


def _compiled(function: F, fastmath: set[str]) -> F:
    options: dict[str, Any] = {"nogil": True, "fastmath": fastmath, "error_model": "numpy"}
    try:
        return cast("F", numba.njit(cache=True, **options)(function))
    except RuntimeError:  # no writable cache folder: every process compiles
        return cast("F", numba.njit(**options)(function))

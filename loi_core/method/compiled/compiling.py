"""Numba's compiler, with the settings of all kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

__all__ = ["compiled", "compiled_as_written", "compiled_sums"]

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """`function`, compiled when it is first called and then kept on disk; other threads run meanwhile.

    Products may be fused with sums; nothing else is rounded otherwise than written.
    """
    return _compiled(function, {"contract"})


def compiled_sums(function: F) -> F:
    """The same, with sums in any order, so that they are made in vectors."""
    return _compiled(function, {"contract", "reassoc", "nsz"})


def compiled_as_written(function: F) -> F:
    """The same, with every operation rounded as IEEE 754 has it: what is equal or opposite on paper stays so."""
    return _compiled(function, set())


def _compiled(function: F, fast: set[str]) -> F:
    options: dict[str, Any] = {"nogil": True, "fastmath": fast, "error_model": "numpy"}
    try:
        return cast("F", numba.njit(cache=True, **options)(function))
    except RuntimeError:  # nowhere to keep it: every process compiles anew
        return cast("F", numba.njit(**options)(function))

"""The loss on the processor, compiled by Numba if that is installed, as it is wherever it has wheels.

Operations on whole arrays pass over memory hundreds of times; here each level of each plane stays in a core's cache
from its isophotes to its gradient, and cores work on different ones. Values and gradients are those of
:mod:`loi_core.method.array_comparison` up to rounding, and the same to the last bit with any number of threads.

Importing this package imports nothing else; Numba is loaded when something is first compared.
"""

from __future__ import annotations

import os
import warnings
from typing import Final

from loi_core.support.forking import ForkSafeLock
from loi_core.support.wording import described

__all__ = ["SWITCH", "CompiledLoopsWarning", "available", "compiles"]

SWITCH: Final = "LOI_COMPILED"
"""Environment variable: 0 compares by operations on whole arrays also where Numba is installed."""


class CompiledLoopsWarning(RuntimeWarning):
    """Numba is installed, but does not compile; everything is computed without it, several times slower."""


class _Numba:
    """Whether Numba can be used."""

    def __init__(self) -> None:
        self._lock = ForkSafeLock()
        self._usable: bool | None = None
        self._tried: set[str] = set()

    def usable(self) -> bool:
        if self._usable is None:
            with self._lock:  # one thread imports it; of several at once, Numba fails in some
                if self._usable is None:
                    self._usable = _can_compile()
        return self._usable

    def compiles(self, dtype: str) -> bool:
        """Whether the kernels for a dtype can be compiled, or loaded; from the first time on that they cannot, no."""
        if self.usable() and dtype not in self._tried:
            with self._lock:
                if dtype not in self._tried:
                    self._usable = _try_kernels(dtype)
                    self._tried.add(dtype)
        return self.usable()


_NUMBA: Final = _Numba()


def _can_compile() -> bool:
    try:
        import numba  # takes as long as all else together, so only where it is needed
    except Exception:  # noqa: BLE001  # one that does not know this NumPy, or this Python, raises what it likes
        return False
    return not numba.config.DISABLE_JIT


def available() -> bool:
    """Whether Numba is installed, can be loaded, compiles, and has not been switched off by ``LOI_COMPILED=0``."""
    return os.environ.get(SWITCH) != "0" and _NUMBA.usable()


def compiles(dtype: str) -> bool:
    """Whether loops for "float32" or "float64" can and may be used: when first asked, they are compiled, or loaded.

    Where Numba cannot, or what it has kept is damaged, one warning says so, and all is compared without it.
    """
    return available() and _NUMBA.compiles(dtype)


def _try_kernels(dtype: str) -> bool:
    try:
        from loi_core.method.compiled.loop_comparison import compare_something

        compare_something(dtype)
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001  # of Numba, of its cache's files, of what is in them
        msg = (
            f"Numba cannot compile loi's loops ({described(error)}); all is computed without it, several times slower. "
            f"Delete loi_core/method/compiled/__pycache__, or set NUMBA_CACHE_DIR to a folder with space; {SWITCH}=0 "
            f"keeps Numba out"
        )
        warnings.warn(msg, CompiledLoopsWarning, stacklevel=2)
        return False
    return True

"""The loss on the CPU, in loops compiled by Numba.

Whole-array operations pass over memory hundreds of times. Here each level of each plane stays in a core's cache from
its isophotes to its gradient, and cores work on different levels. Values and gradients equal the results of
:mod:`loi_core.method.array_comparison` up to rounding, and are the same to the last bit with any number of threads.

Importing this package does not import Numba; the first comparison does.
"""

from __future__ import annotations

import os
import warnings
from typing import Final

from loi_core.support.forking import ForkSafeLock
from loi_core.support.wording import described

__all__ = ["SWITCH", "CompiledLoopsWarning", "available", "compiles"]

SWITCH: Final = "LOI_COMPILED"
"""Environment variable: 0 disables the compiled loops."""


class CompiledLoopsWarning(RuntimeWarning):
    """Numba is installed but cannot compile, so whole-array operations are used, which are several times slower."""


class _Numba:
    """The state of Numba in this process."""

    def __init__(self) -> None:
        self._lock = ForkSafeLock()
        self._usable: bool | None = None
        self._tried: set[str] = set()

    def usable(self) -> bool:
        if self._usable is None:
            with self._lock:  # imports of Numba by several threads at once fail
                if self._usable is None:
                    self._usable = _can_compile()
        return self._usable

    def compiles(self, dtype: str) -> bool:
        """Return whether the kernels for a dtype can be compiled or loaded; False for good after the first failure."""
        if self.usable() and dtype not in self._tried:
            with self._lock:
                if dtype not in self._tried:
                    self._usable = _try_kernels(dtype)
                    self._tried.add(dtype)
        return self.usable()


_NUMBA: Final = _Numba()


def _can_compile() -> bool:
    try:
        import numba  # takes as long as all other imports together
    except Exception:  # noqa: BLE001  # a Numba for another NumPy or Python may raise anything
        return False
    return not numba.config.DISABLE_JIT


def available() -> bool:
    """Return whether Numba is installed, loads, compiles, and is not disabled by ``LOI_COMPILED=0``."""
    return os.environ.get(SWITCH) != "0" and _NUMBA.usable()


def compiles(dtype: str) -> bool:
    """Return whether loops for "float32" or "float64" may be used; the first call compiles or loads them.

    If that fails, one warning says so, and whole-array operations are used instead.
    """
    return available() and _NUMBA.compiles(dtype)


def _try_kernels(dtype: str) -> bool:
    try:
        from loi_core.method.compiled.compiling import announced_on_terminals
        from loi_core.method.compiled.loop_comparison import compile_kernels

        with announced_on_terminals():
            compile_kernels(dtype)
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001  # of Numba, of its cache files, or of their contents
        msg = (
            f"Numba cannot compile loi's loops ({described(error)}), so comparisons are several times slower. Delete "
            f"loi_core/method/compiled/__pycache__, or set NUMBA_CACHE_DIR to a folder with space; {SWITCH}=0 disables "
            f"Numba"
        )
        warnings.warn(msg, CompiledLoopsWarning, stacklevel=2)
        return False
    return True

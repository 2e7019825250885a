"""Choose the LLVM library for Dr.Jit before Dr.Jit is imported.

Dr.Jit loads libLLVM while it is being imported: the file that ``DRJIT_LIBLLVM_PATH`` names, or else the newest of the
system. Dr.Jit accepts LLVM 15, the newest of many distributions, but then aborts the process at the first kernel that
takes a minimum. The wheel `karellen-llvm-core`, a dependency of the extra ``mitsuba``, has a newer one.
"""

from __future__ import annotations

import ctypes
import functools
import os
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Final

__all__ = ["LLVMChoice", "LLVMError", "prepare"]

VARIABLE: Final = "DRJIT_LIBLLVM_PATH"
MIN_VERSION: Final = 16
WHEEL: Final = "karellen-llvm-core"
WHEEL_RUNTIME: Final = ("libunwind", "libc++abi", "libc++")  # in the order of their dependencies


class LLVMError(ImportError):
    """The LLVM that Dr.Jit has loaded is too old."""


@dataclass(frozen=True)
class LLVMChoice:
    """The LLVM library that Dr.Jit has loaded.

    Attributes
    ----------
    version : int or None
        Major version; None if Dr.Jit has found no LLVM. The scalar variants and those for CUDA need none.
    source : str
        ``DRJIT_LIBLLVM_PATH``, ``karellen-llvm-core``, or "Dr.Jit" if Dr.Jit chose the library itself.
    """

    version: int | None
    source: str


@functools.cache
def prepare() -> LLVMChoice:
    """Import Dr.Jit with an LLVM that it works with. Importing the package calls this; later calls do nothing.

    If ``DRJIT_LIBLLVM_PATH`` is set, that library is used; else the library of the wheel `karellen-llvm-core` if it is
    installed, and else the one that Dr.Jit finds.

    Returns
    -------
    LLVMChoice

    Raises
    ------
    LLVMError
        If Dr.Jit has loaded a version below 16, now or because it was imported before.
    """
    imported = "drjit" in sys.modules
    source = "Dr.Jit" if imported else _set_library()
    import drjit as dr

    version = int(dr.detail.llvm_version()[0])
    if 0 < version < MIN_VERSION:
        early = "import loi_mitsuba or mitsuba_boundaries before drjit and mitsuba, " if imported else ""
        msg = (
            f"Mitsuba needs LLVM {MIN_VERSION} or later, but Dr.Jit has loaded LLVM {version} ({source}); "
            f"{early}pip install {WHEEL}, or set {VARIABLE} to a newer libLLVM"
        )
        raise LLVMError(msg)
    return LLVMChoice(version if version > 0 else None, source)


def _set_library() -> str:
    """Set ``DRJIT_LIBLLVM_PATH`` to the wheel's library unless it is set; return the source of the library."""
    libraries = _wheel_files("libLLVM")
    source = VARIABLE if os.environ.get(VARIABLE) else WHEEL if libraries else "Dr.Jit"
    if source == WHEEL:
        os.environ[VARIABLE] = str(libraries[0])
    if Path(os.environ.get(VARIABLE, "")) in libraries:  # also where a parent process has set the variable
        _load_wheel_runtime()
    return source


def _wheel_files(stem: str) -> list[Path]:
    """Return the wheel's shared libraries of that name; an empty list if the wheel is not installed."""
    try:
        files = metadata.distribution(WHEEL).files or []
    except metadata.PackageNotFoundError:
        return []
    # `resolve` would follow links of folders, but libLLVM finds its other libraries relative to its own path.
    located = [Path(os.path.normpath(str(file.locate()))) for file in files if file.name.startswith(f"{stem}.so.")]
    return [path for path in located if path.is_file()]


def _load_wheel_runtime() -> None:
    """Load the C++ runtime of the wheel's libLLVM, so that the dynamic linker need not find it.

    A start-up hook of another package creates the links to these files, such as libc++.so.1. The hook has not run in
    the process that installed the package, and cannot run where site-packages is read-only.
    """
    for stem in WHEEL_RUNTIME:
        for path in _wheel_files(stem):
            ctypes.CDLL(str(path))

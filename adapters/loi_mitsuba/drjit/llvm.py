"""Which LLVM Dr.Jit compiles with, chosen before Dr.Jit makes the choice by itself.

Dr.Jit loads a libLLVM while it is being imported, the newest that the system has. With LLVM 15, the newest of many
systems, it aborts the whole process at the first kernel that takes a minimum, so the choice cannot be left to it,
and a library cannot be tried out: its version is read from the file.
"""

from __future__ import annotations

import ctypes
import functools
import mmap
import os
import platform
import re
import struct
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Final

from loi_core.errors import LoiError

__all__ = ["LLVMChoice", "LLVMError", "choose_llvm", "library_version", "prepare"]

VARIABLE: Final = "DRJIT_LIBLLVM_PATH"
OLDEST: Final = 16
SEEN_TO_WORK: Final = (19, 22, 23)
WHEEL: Final = "karellen-llvm-core"
WHEEL_RUNTIME: Final = ("libunwind", "libc++abi", "libc++")  # in the order in which they need each other
WHEEL_MACHINE: Final = "x86_64"  # there are no wheels for others

_VERSIONED = re.compile(r"libLLVM(?:-|\.so\.)(\d+)")
_LIBRARY = re.compile(r"libLLVM(?:-\d[\w.+-]*)?\.so(?:\.\d[\w.+-]*)?")

_ELF64_LITTLE_ENDIAN: Final = b"\x7fELF\x02\x01"
_PT_LOAD, _PT_DYNAMIC = 1, 2
_DT_STRTAB, _DT_SONAME = 5, 14


class LLVMError(LoiError, ImportError):
    """There is no LLVM that Dr.Jit works with, or the one that was asked for is not."""


@dataclass(frozen=True)
class LLVMChoice:
    """The LLVM that Dr.Jit uses.

    Attributes
    ----------
    path : Path or None
        The library; None where Dr.Jit searches by itself, or had done so before it could be told.
    version : int or None
        Its major version; None if it is not known yet.
    source : str
        Where it was found.
    reason : str
        One line on why it was chosen.
    """

    path: Path | None
    version: int | None
    source: str
    reason: str


@functools.cache
def prepare() -> LLVMChoice:
    """Make Dr.Jit load a good LLVM; called when :mod:`loi_mitsuba` is imported. Later calls change nothing.

    Returns
    -------
    LLVMChoice

    Raises
    ------
    LLVMError
        As :func:`choose_llvm`, or if Dr.Jit was imported before and has loaded an LLVM that it does not work with.
    """
    if "drjit" in sys.modules:
        return _already_loaded()
    choice = choose_llvm()
    if choice.path is not None:
        if choice.path in _wheel_files("libLLVM"):  # also where a parent process has put it into the variable
            _load_wheel_runtime()
        os.environ[VARIABLE] = str(choice.path)
    return choice


def choose_llvm() -> LLVMChoice:
    """The LLVM that Dr.Jit should use; nothing is loaded or changed.

    The first of: what ``DRJIT_LIBLLVM_PATH`` names, a libLLVM of the system, that of the wheel `karellen-llvm-core`.
    Versions before 16 never are. Of several of the system one seen to work goes before one that only should, and a
    newer one before an older. On other systems than Linux, Dr.Jit's own search is left alone.

    Raises
    ------
    LLVMError
        If there is none, or ``DRJIT_LIBLLVM_PATH`` names one that is missing or too old.
    """
    if platform.system() != "Linux":
        return LLVMChoice(None, None, "Dr.Jit", f"on {platform.system()} Dr.Jit finds LLVM by itself")
    asked = os.environ.get(VARIABLE)
    if asked:
        return _asked(asked)
    too_old: list[str] = []
    found: list[tuple[bool, int, Path]] = []
    for path in _system_libraries():
        version = library_version(path)
        if version is None:
            continue
        if version < OLDEST:
            too_old.append(f"LLVM {version}")
        else:
            found.append((version in SEEN_TO_WORK, version, path))
    passed = f"; {' and '.join(sorted(set(too_old)))} of the system passed over, too old" if too_old else ""
    if found:
        seen, version, path = max(found)
        quality = "seen to work" if seen else f"{OLDEST} or later"
        return LLVMChoice(path, version, "system", f"newest of the system's that is {quality}{passed}")
    for path in _wheel_files("libLLVM"):
        version = library_version(path)
        if version is not None and version >= OLDEST:
            return LLVMChoice(path, version, WHEEL, f"the system has none of version {OLDEST} or later{passed}")
    have = f"the system has {' and '.join(sorted(set(too_old)))} only" if too_old else "none was found"
    msg = f"Mitsuba needs LLVM {OLDEST} or later, {have}; {_fix()}, or set {VARIABLE} to one"
    raise LLVMError(msg)


def library_version(path: Path) -> int | None:
    """Major version of a libLLVM, read from the file: its soname, or else its name. None if neither tells."""
    resolved = path.resolve()
    for name in (_soname(resolved), resolved.name):
        match = _VERSIONED.match(name or "")
        if match:
            return int(match.group(1))
    return None


def _asked(asked: str) -> LLVMChoice:
    path = Path(asked)
    if "/" not in asked:  # a bare name is looked up as the dynamic linker would
        path = next((folder / asked for folder in _system_folders() if (folder / asked).is_file()), path)
    if not path.is_file():
        msg = f"`{VARIABLE}` must name a libLLVM, got {asked!r}, which is no file; unset it, or fix it"
        raise LLVMError(msg)
    version = library_version(path)
    if version is None or version < OLDEST:
        what = "a file of unknown version" if version is None else f"LLVM {version}"
        msg = f"`{VARIABLE}` must name LLVM {OLDEST} or later, got {asked!r}, {what}; unset it and {_fix()}"
        raise LLVMError(msg)
    return LLVMChoice(path, version, VARIABLE, f"{VARIABLE} names it")


def _fix() -> str:
    return (
        f"pip install {WHEEL}"
        if platform.machine() == WHEEL_MACHINE
        else f"install LLVM {OLDEST} or later of your system"
    )


def _already_loaded() -> LLVMChoice:
    import drjit as dr  # the caller has imported it

    version = int(dr.detail.llvm_version()[0])
    if 0 < version < OLDEST:
        path = choose_llvm().path  # if there is no better one, its error says more than ours would
        msg = (
            f"Dr.Jit has loaded LLVM {version} already, and needs {OLDEST} or later; import loi_mitsuba before drjit "
            f"and mitsuba, or set {VARIABLE}={path}"
        )
        raise LLVMError(msg)
    known = version if version > 0 else None  # none at all: the variants on a GPU and the scalar ones do without
    return LLVMChoice(None, known, "Dr.Jit", "Dr.Jit was imported before loi_mitsuba, and chose by itself")


def _system_folders() -> list[Path]:
    machine = platform.machine()
    fixed = [f"/usr/lib/{machine}-linux-gnu", "/usr/lib64", "/usr/lib", "/usr/local/lib", "/usr/lib/wsl/lib"]
    versioned = [*Path("/usr/lib").glob("llvm-*/lib"), *Path("/usr/lib/llvm").glob("*/lib64")]
    return [*map(Path, fixed), *sorted(versioned)]


def _system_libraries() -> Iterator[Path]:
    for folder in _system_folders():
        yield from _libraries(folder.glob("libLLVM*.so*"))


def _libraries(paths: Iterable[Path]) -> Iterator[Path]:
    """Those that are LLVM itself, not one of its many parts, each once."""
    seen = set()
    for path in sorted(paths):
        resolved = path.resolve()
        if _LIBRARY.fullmatch(path.name) and resolved.is_file() and resolved not in seen:
            seen.add(resolved)
            yield path


def _wheel_files(stem: str) -> list[Path]:
    try:
        files = metadata.distribution(WHEEL).files or []
    except metadata.PackageNotFoundError:
        return []
    # Not `resolve` on a folder that may be a link: the wheel finds its other libraries beside this one.
    located = [Path(os.path.normpath(str(file.locate()))) for file in files if file.name.startswith(f"{stem}.so.")]
    return [path for path in located if path.is_file()]


def _load_wheel_runtime() -> None:
    """Load what the wheel's libLLVM needs, so that the dynamic linker finds it loaded.

    The wheel leaves the links to these files (libc++.so.1 and so on) to a start-up hook of another package, which
    has not run in the process that installed it, nor ever where site-packages cannot be written.
    """
    for stem in WHEEL_RUNTIME:
        for path in _wheel_files(stem):
            ctypes.CDLL(str(path))


def _soname(path: Path) -> str | None:
    """DT_SONAME of a 64-bit little-endian ELF file; None for anything else."""
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return _soname_in(data) if data[: len(_ELF64_LITTLE_ENDIAN)] == _ELF64_LITTLE_ENDIAN else None
    except (OSError, ValueError, OverflowError, struct.error):  # unreadable, empty, cut short, or nonsense
        return None


def _soname_in(data: mmap.mmap) -> str | None:
    (table,) = struct.unpack_from("<Q", data, 32)
    size, count = struct.unpack_from("<HH", data, 54)
    loaded: list[tuple[int, int, int]] = []  # address, size, offset
    dynamic = (0, 0)  # offset, size
    for index in range(count):
        kind, _, offset, address, _, length = struct.unpack_from("<IIQQQQ", data, table + index * size)
        if kind == _PT_LOAD:
            loaded.append((address, length, offset))
        elif kind == _PT_DYNAMIC:
            dynamic = (offset, length)
    tags = dict(struct.unpack_from("<QQ", data, at) for at in range(dynamic[0], sum(dynamic), 16))
    if _DT_STRTAB not in tags or _DT_SONAME not in tags:
        return None
    for address, length, offset in loaded:
        if address <= tags[_DT_STRTAB] < address + length:
            start = tags[_DT_STRTAB] - address + offset + tags[_DT_SONAME]
            end = data.find(b"\0", start)
            return data[start:end].decode("ascii", "replace")
    return None

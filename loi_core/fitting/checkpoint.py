"""The state of a fit in a file, so that one that was stopped can go on as if it had not been."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import struct
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, BinaryIO, Final

import numpy as np

from loi_core.errors import CheckpointError, ParameterError
from loi_core.fitting.history import FIRST_COLUMNS
from loi_core.io.files import atomic_path, open_regular
from loi_core.io.npy import read_npy_header, read_npy_values
from loi_core.support.arrays import Host
from loi_core.support.wording import described

__all__ = ["Checkpoint", "is_checkpoint", "load_checkpoint", "save_checkpoint", "seal"]

GROUPS = ("params", "memory", "best_params", "callback")
NUMBERS = ("step", "best_step", "best_value", "history")
KINDS: Final = {"memory": "fiub", "callback": "fiub"}  # of dtypes; of all other groups floats
BEGINNING: Final = b"PK\x03\x04"  # of a zip archive, then 26 bytes on, the name of its first member
FIRST: Final = f"{NUMBERS[0]}.npy".encode()
SEAL: Final = b"sha256:"
SEALED: Final = len(SEAL) + 2 * hashlib.sha256().digest_size


@dataclass(frozen=True)
class Checkpoint:
    """Everything that a fit needs to go on; arrays are on the host."""

    settings: Mapping[str, str]
    step: int
    best_step: int
    best_value: float
    params: Mapping[str, Host]
    memory: Mapping[str, Host]
    best_params: Mapping[str, Host]
    history: Host
    callback: Mapping[str, Host] = field(default_factory=dict)


def save_checkpoint(path: Path, state: Checkpoint, *, before: Path | None = None) -> None:
    """Write `state` to `path` (.npz), whole or not at all.

    What lay there is moved to `before`, if that is given, once the new one is written: there is always one that is
    whole. It is not moved if it holds the same.

    Raises
    ------
    WriteError
        If it cannot be written.
    """
    arrays: dict[str, Any] = {name: np.asarray(getattr(state, name)) for name in NUMBERS}
    arrays["settings"] = np.asarray(json.dumps(dict(state.settings)))
    for group in GROUPS:
        arrays |= {f"{group}/{name}": value for name, value in getattr(state, group).items()}
    with atomic_path(path) as temporary:
        with temporary.open("w+b") as stream:
            np.savez(stream, allow_pickle=False, **arrays)
            digest = seal(stream)
            stream.flush()
            os.fsync(stream.fileno())  # or after a loss of power the name might be there, and the content not
        if before is not None and not _has_seal(path, digest):
            with contextlib.suppress(FileNotFoundError):  # somebody has removed it
                path.replace(before)


def is_checkpoint(path: Path) -> bool:
    """Whether a file begins as checkpoints do, though it may be torn, or is empty.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    with open_regular(path) as stream:
        head = stream.read(30 + len(FIRST))
    return not head or (head.startswith(BEGINNING) and head[30:] == FIRST[: max(len(head) - 30, 0)])


def seal(stream: BinaryIO) -> bytes:
    """Put a digest of all of a zip archive, open for reading and writing, into its comment; returns that.

    The checksums of a zip archive are of its members alone, and of 32 bits.
    """
    size = stream.seek(-2, os.SEEK_END) + 2  # an archive ends with the length of its comment, which is 0
    stream.write(struct.pack("<H", SEALED))
    digest = _digest(stream, size)
    stream.seek(size)
    stream.write(digest)
    return digest


def _has_seal(path: Path, digest: bytes) -> bool:
    try:
        with path.open("rb") as stream:
            stream.seek(-SEALED, os.SEEK_END)
            return stream.read() == digest
    except OSError:
        return False


def _check_seal(stream: BinaryIO) -> None:
    """Raise ValueError unless the seal of a file is there and right."""
    size = stream.seek(0, os.SEEK_END) - SEALED
    stream.seek(max(size, 0))
    seal = stream.read()
    if not seal.startswith(SEAL):
        msg = "it does not end as checkpoints do: it is torn, or not one"
        raise ValueError(msg)
    if seal != _digest(stream, size):
        msg = "its content is not what was written: it is damaged"
        raise ValueError(msg)
    stream.seek(0)


def _digest(stream: BinaryIO, size: int) -> bytes:
    """The digest of the first bytes of a file, as a seal has it."""
    stream.seek(0)
    found = hashlib.sha256()
    while size > 0 and (part := stream.read(min(size, 2**20))):
        found.update(part)
        size -= len(part)
    return SEAL + found.hexdigest().encode()


def load_checkpoint(path: Path, settings: Mapping[str, str]) -> Checkpoint:
    """Read what :func:`save_checkpoint` wrote, for a fit with these settings.

    Raises
    ------
    CheckpointError
        If the file is not a whole checkpoint, every byte as it was written. Nothing in it is executed.
    ParameterError
        If it is one of a fit with other settings.
    """
    state = _load(path)
    for name, value in settings.items():
        if name == "steps" and state.settings.get(name, "").isdecimal() and int(value) >= state.step:
            continue  # more steps, or fewer that are still to come, go on from here
        if state.settings.get(name) != value:
            before = state.settings.get(name, "none")
            told = f"other {name}" if value.startswith("sha256 ") else f"{name} = {before:.80}, this fit has {value}"
            msg = f"`checkpoint` was made with {told}; start without resume"
            raise ParameterError(msg)
    return state


def _load(path: Path) -> Checkpoint:
    try:
        arrays = _arrays(path)
        groups = {
            group: {
                name.removeprefix(f"{group}/"): value for name, value in arrays.items() if name.startswith(f"{group}/")
            }
            for group in GROUPS
        }
        state = Checkpoint(
            settings={str(name): str(value) for name, value in json.loads(str(arrays["settings"])).items()},
            step=int(arrays["step"]),
            best_step=int(arrays["best_step"]),
            best_value=float(arrays["best_value"]),
            history=_table(np.asarray(arrays["history"], dtype=np.float64)),
            **groups,
        )
    except Exception as error:  # damage may show in any layer: the file, zip, NumPy, JSON
        raise _foreign(path, described(error)) from error
    if not 0 <= state.best_step <= state.step == len(state.history):
        raise _foreign(path, "its counts of steps disagree")
    if not np.array_equal(state.history[:, 0], np.arange(state.step)):
        raise _foreign(path, "its history is not one of steps in order")
    if not np.all(np.isfinite(state.history)) or not math.isfinite(state.best_value):
        raise _foreign(path, "its history holds what is not a number")
    for group, values in groups.items():
        for name, value in values.items():
            finite = group == "callback" or value.dtype.kind not in "fiub" or np.all(np.isfinite(value))
            if value.dtype.kind not in KINDS.get(group, "f") or not finite:
                raise _foreign(path, f"{group} of {name!r} are not numbers of a fit")
    return state


def _table(history: Host) -> Host:
    if history.ndim != 2 or history.shape[1] < FIRST_COLUMNS:
        msg = f"its history has shape {history.shape}"
        raise ValueError(msg)
    return history


def _arrays(path: Path) -> dict[str, Host]:
    """Every array of the file; they take no more memory than the file does."""
    arrays = {}
    with open_regular(path) as stream:
        _check_seal(stream)
        with zipfile.ZipFile(stream) as archive:
            size = path.stat().st_size
            for member in archive.infolist():
                if member.compress_type != zipfile.ZIP_STORED:
                    msg = "it is compressed"
                    raise ValueError(msg)
                size -= member.file_size
                if size < 0:
                    msg = "its arrays are larger than the file"
                    raise ValueError(msg)
                with archive.open(member) as values:
                    arrays[member.filename.removesuffix(".npy")] = _array(values, member.file_size)
    return arrays


def _array(stream: IO[bytes], size: int) -> Host:
    return read_npy_values(stream, read_npy_header(stream), size)


def _foreign(path: Path, why: str) -> CheckpointError:
    return CheckpointError((str(path), why))

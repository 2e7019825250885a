"""The state of a fit in a file, so that one that was stopped can go on as if it had not been."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from loi_core.errors import ParameterError
from loi_core.io.files import atomic_path, open_regular
from loi_core.io.npy import read_npy_header, read_npy_values
from loi_core.support.arrays import Host
from loi_core.support.wording import described

__all__ = ["Checkpoint", "load_checkpoint", "save_checkpoint"]

GROUPS = ("params", "memory", "best_params")
FIRST_COLUMNS = 6  # step, value, gradient norm, rate, seconds, stage; then the free parameters if they are few
NUMBERS = ("step", "best_step", "best_value", "history")


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


def save_checkpoint(path: Path, state: Checkpoint) -> None:
    """Write `state` to `path` (.npz), whole or not at all."""
    arrays: dict[str, Any] = {name: np.asarray(getattr(state, name)) for name in NUMBERS}
    arrays["settings"] = np.asarray(json.dumps(dict(state.settings)))
    for group in GROUPS:
        arrays |= {f"{group}/{name}": value for name, value in getattr(state, group).items()}
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def load_checkpoint(path: Path, settings: Mapping[str, str]) -> Checkpoint:
    """Read what :func:`save_checkpoint` wrote, for a fit with these settings.

    Raises
    ------
    ParameterError
        If the file is not a whole checkpoint, or one of a fit with other settings. Nothing in it is executed.
    """
    state = _load(path)
    for name, value in settings.items():
        if name == "steps" and state.settings.get(name, "").isdecimal() and int(value) >= state.step:
            continue  # more steps, or fewer that are still to come, go on from here
        if state.settings.get(name) != value:
            msg = f"`checkpoint` was made with {name} = {state.settings.get(name)!s:.80}, this fit has {value}"
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
            if value.dtype.kind not in ("f" if group != "memory" else "fiub") or not np.all(np.isfinite(value)):
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
    with open_regular(path) as stream, zipfile.ZipFile(stream) as archive:
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


def _foreign(path: Path, why: str) -> ParameterError:
    return ParameterError(f"`checkpoint` {path} is not a checkpoint of a fit ({why}); delete it to start anew")

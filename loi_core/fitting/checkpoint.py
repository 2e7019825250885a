"""Checkpoints: the state of a fit in one file, so that a stopped fit continues as if it had never stopped."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.errors import CheckpointError, OptionError, ParameterError
from loi_core.fitting.history import FitStep, rows_of, steps_of
from loi_core.fitting.optimiser import Optimiser, require_shapes
from loi_core.fitting.parameters import Bounds, Free
from loi_core.fitting.state import Best, State
from loi_core.fitting.views import Views, mean
from loi_core.io.files import atomic_path, open_regular, remove_temporaries, unwritable
from loi_core.io.lock import LOCK, exclusive_use
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Host, from_numpy, to_numpy
from loi_core.support.guards import wrap_errors
from loi_core.support.wording import described

__all__ = [
    "Checkpoint",
    "CheckpointFile",
    "is_due",
    "load_checkpoint",
    "recorded_seconds",
    "resume",
    "save_checkpoint",
    "settings_of",
]

INTERVAL: Final = 25  # steps
GROUPS: Final = ("params", "memory", "best_params", "callback")


@dataclass(frozen=True)
class Checkpoint:
    """The content of a checkpoint file.

    Attributes
    ----------
    settings : dict of str
        See :func:`settings_of`.
    numbers : dict
        Everything else of the state that is not an array.
    history : list of FitStep
    params, memory, best_params, callback : dict of arrays
        The parameters, the optimiser's memory, the best parameters and the memory of the callback.
    """

    settings: Mapping[str, str]
    numbers: Mapping[str, Any]
    history: list[FitStep]
    params: Mapping[str, Host]
    memory: Mapping[str, Host]
    best_params: Mapping[str, Host]
    callback: Mapping[str, Host]


def is_due(step: int) -> bool:
    """Return whether the state after `step` steps is saved: every 25 steps, every 100th of the way from step 2500 on.

    A checkpoint holds the whole history, so a fixed interval would write an amount that grows with the square of the
    steps. An interval that doubles, between one hundredth and one fiftieth of the way, writes at most 200 histories.
    """
    doublings = max(1, step // (100 * INTERVAL)).bit_length() - 1
    return step % (INTERVAL << doublings) == 0


class CheckpointFile:
    """The checkpoint file of one fit, locked against others while the fit runs.

    Parameters
    ----------
    path : Path
        The file (.npz).
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = contextlib.ExitStack()
        self._locked = False
        self._owned = False  # whether the file at the path was written or loaded by this fit

    def acquire(self, *, resume: bool) -> None:
        """Lock the path and remove unfinished files of killed fits.

        Raises
        ------
        InUseError
            If another fit uses it.
        OptionError
            If the fit would overwrite a file that is not a checkpoint.
        WriteError
            If nothing can be written there.
        """
        self._lock.enter_context(exclusive_use(self.path.with_name(f"{LOCK}-{self.path.name}"), self.path))
        self._locked = True
        remove_temporaries(self.path)
        if not resume and os.path.lexists(self.path) and not _is_checkpoint(self.path):
            msg = f"`checkpoint`: {self.path} is not a checkpoint of a fit; remove it, or give another path"
            raise OptionError(msg)

    def release(self) -> None:
        """Unlock the path."""
        self._locked = False
        self._lock.close()

    def load(self, settings: Mapping[str, str]) -> Checkpoint | None:
        """Return the checkpoint for a fit with these settings; None if there is none. Errors: `load_checkpoint`."""
        if not os.path.lexists(self.path):
            return None
        checkpoint = load_checkpoint(self.path, settings)
        self._owned = True
        return checkpoint

    def begin(self) -> None:
        """Remove the checkpoint of an earlier fit, unless this fit resumes it.

        Raises
        ------
        WriteError
            If it cannot be removed.
        """
        if not self._owned:
            try:
                self.path.unlink(missing_ok=True)
            except OSError as error:
                raise unwritable(self.path, error) from error
            self._owned = True

    def save(self, state: State, settings: Mapping[str, str], callback: Mapping[str, Host]) -> None:
        """Replace the checkpoint. If that raises a WriteError, the previous one is still there."""
        if self._locked:  # otherwise the fit is over and saved, and another may have the path
            self.begin()
            save_checkpoint(self.path, state, settings, callback)


def _is_checkpoint(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            return {"state.npy", "history.npy"} <= set(archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def save_checkpoint(path: Path, state: State, settings: Mapping[str, str], callback: Mapping[str, Host]) -> None:
    """Write a state that has a best iterate to `path`, whole or not at all.

    Raises
    ------
    WriteError
        If it cannot be written.
    """
    best = state.best
    assert best is not None  # noqa: S101 - the caller saves after the first value only
    numbers = {
        "step": state.step,
        "best": [best.value, best.step, best.stage, best.partial],
        "rates": dict(state.rates),
        "schedule": state.schedule.to_json(),
        "latest": dict(state.latest),
        "agreeing": state.agreeing,
        "recorded": {name: value.shape for name, value in state.log[0].params.items()} if state.step else {},
    }
    arrays: dict[str, Any] = {"history": rows_of(state.history)}
    for group, values in zip(GROUPS, (state.params, state.memory, best.params, callback), strict=True):
        arrays |= {f"{group}/{name}": np.asarray(to_numpy(value)) for name, value in values.items()}
    arrays["state"] = np.asarray(json.dumps({"settings": dict(settings), "numbers": numbers, "arrays": [*arrays]}))
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)
        stream.flush()
        os.fsync(stream.fileno())  # otherwise a power failure could leave the name without the content


def load_checkpoint(path: Path, settings: Mapping[str, str]) -> Checkpoint:
    """Read a checkpoint for a fit with these settings.

    Raises
    ------
    CheckpointError
        If the file is damaged or is not a checkpoint. Nothing in it is executed.
    ParameterError
        If it belongs to a fit with other settings.
    """
    try:
        checkpoint = _load(path)
    except Exception as error:  # damage may show in any layer: the file, zip, NumPy, JSON
        raise CheckpointError(str(path), described(error)) from error
    for name, value in settings.items():
        saved = checkpoint.settings.get(name, "none")
        if name == "steps" and saved != "none" and int(value) >= checkpoint.numbers["step"]:
            continue  # more steps, or fewer that are still ahead, continue from here
        if saved != value:
            change = f"other {name}" if value.startswith("sha256 ") else f"{name} = {saved:.80}, this fit has {value}"
            msg = f"`checkpoint` was made with {change}; start without resume"
            raise ParameterError(msg)
    return checkpoint


def recorded_seconds(path: Path) -> float:
    """Return the duration of the steps in a checkpoint; 0 if the file is missing, damaged or no checkpoint."""
    try:
        return sum(step.seconds for step in _load(path).history)
    except Exception:  # noqa: BLE001 - as above
        return 0.0


def _load(path: Path) -> Checkpoint:
    with open_regular(path) as stream:
        if not zipfile.is_zipfile(stream):
            msg = "it is torn, or not an .npz file"
            raise ValueError(msg)
        stream.seek(0)
        groups: dict[str, dict[str, Host]] = {group: {} for group in GROUPS}
        with np.load(stream, allow_pickle=False) as stored:  # it checks the CRC of every array that is read
            state = json.loads(str(stored["state"]))
            numbers, rows = state["numbers"], stored["history"]
            for key in state["arrays"][1:]:  # in the order of the parameters; a missing one raises a KeyError
                group, _, name = key.partition("/")
                values = groups[group]
                values[name] = value = stored[key]
                if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub":
                    msg = f"{key!r} is not an array of numbers"
                    raise ValueError(msg)
    history = steps_of(rows, {name: tuple(shape) for name, shape in numbers["recorded"].items()})
    if len(history) != numbers["step"]:
        msg = "its counts of steps disagree"
        raise ValueError(msg)
    return Checkpoint(state["settings"], numbers, history, **groups)


def settings_of(
    steps: int,
    seed: int,
    decay: str,
    rates: Mapping[str, float | str],
    free: Mapping[str, Free],
    starts: int,
    bounds: Bounds,
    views: Views,
    optimiser: str,
) -> dict[str, str]:
    """Return, by name, the settings that a resumed fit must share with the stopped one.

    `rates` are the requested ones, in a parameter's own unit or as text in pixels. The start counts only if it was
    given: the renderer's own may be where an earlier fit has left the scene.
    """
    initial = {
        name: np.asarray(to_numpy(entry.initial)).tolist() for name, entry in free.items() if entry.initial is not None
    }
    limits = {name: [to_numpy(limit[name]).tolist() for limit in (bounds.lower, bounds.upper)] for name in rates}
    return {
        "steps": str(steps),
        "seed": str(seed),
        "decay": decay,
        "learning rates": json.dumps(dict(rates)),
        "start": _digest(initial),
        "starts": str(starts),
        "bounds": _digest(limits),
        "stages": f"{views.stages}, the last of them to finish" if views.finishes else str(views.stages),
        "views": json.dumps([*views.by_name, views.at_once]),
        "optimiser": optimiser,
    }


def _digest(value: object) -> str:
    return f"sha256 {hashlib.sha256(json.dumps(value).encode()).hexdigest()[:12]}"


def resume(saved: Checkpoint, fresh: State, optimiser: Optimiser, free: Iterable[str], seed: int) -> State:
    """Return the saved state, with the views of `fresh`, and arrays of its library, dtype and device.

    Raises
    ------
    ParameterError
        If the checkpoint belongs to other parameters, or to another objective, reference or scene.
    """

    def live(stored: Mapping[str, Host]) -> Parameters:
        require_shapes(stored, fresh.params, "parameters than this fit has")
        return {name: from_numpy(value, fresh.params[name]) for name, value in stored.items()}

    params, moving, views = live(saved.params), list(free), fresh.views
    memory = optimiser.restore({name: params[name] for name in moving}, saved.memory)
    for name, value in fresh.params.items():
        if name not in moving and not np.array_equal(saved.params[name], to_numpy(value)):
            msg = f"`checkpoint` was made with another scene: {name!r}, which does not move, differs"
            raise ParameterError(msg)
    numbers = saved.numbers
    best_value, best_step, stage, partial = numbers["best"]
    best = live(saved.best_params)
    with wrap_errors("rendering the best of the checkpoint"):
        images = views.render(best, seed + best_step)
    with np.errstate(all="ignore"):  # a damaged value may overflow; it then differs from the saved one
        value = mean(views.values(images, stage))
    # With a tolerance, since libraries may change the order of summation between runs. If a step renders only some
    # views, its value includes views at other parameters.
    if views.all_at_once and not math.isclose(value, best_value, rel_tol=1e-4, abs_tol=1e-12):
        msg = (
            f"`checkpoint` was made with another objective, reference or scene: its best value is "
            f"{best_value:.6g}, here the same parameters give {value:.6g}; start without resume"
        )
        raise ParameterError(msg)
    return State(
        params,
        memory,
        views,
        numbers["step"],
        Best(best, best_value, best_step, images, stage, partial),
        saved.history,
        numbers["rates"],
        fresh.schedule.restored(numbers["schedule"]),
        numbers["latest"],
        numbers["agreeing"],
    )

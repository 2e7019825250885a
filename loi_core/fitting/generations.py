"""The checkpoint of a fit and the one before it: a damaged one is refused by name, and the other used."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from loi_core.errors import CheckpointError, OptionError
from loi_core.fitting.checkpoint import Checkpoint, is_checkpoint, load_checkpoint, save_checkpoint
from loi_core.io.files import remove_temporaries, unwritable
from loi_core.io.lock import LOCK, FileLock

__all__ = ["CheckpointWarning", "Checkpoints", "is_due", "path_before"]

EVERY: Final = 25  # steps


class CheckpointWarning(UserWarning):
    """A checkpoint is damaged or missing, and a fit goes on from the one before it."""


def path_before(path: Path) -> Path:
    """Where the checkpoint before the one at `path` is kept."""
    return path.with_name(f"{path.stem}.previous{path.suffix}")


def is_due(step: int) -> bool:
    """Whether the state after so many steps is kept: every 25, and from step 2500 on as many hundredths of the way.

    A checkpoint holds the whole history. At a fixed distance, what is written would grow with the square of the steps;
    at one that doubles with them, between a half and one hundredth of the way, it is at most 200 histories.
    """
    doublings = max(1, step // (100 * EVERY)).bit_length() - 1
    return step % (EVERY << doublings) == 0


class Checkpoints:
    """What lies at the path of a fit's checkpoint, which no other fit uses meanwhile.

    Parameters
    ----------
    path : Path
        The last one. The one before it lies beside it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.before = path_before(path)
        self._lock = FileLock(path.with_name(f"{LOCK}-{path.name}"), path)
        self._own = False  # whether what lies there is of this fit
        self._whole = False  # whether what lies at `path` is, and is known to be whole

    def acquire(self) -> None:
        """Have the path alone, and remove what killed fits have left half written.

        Raises
        ------
        InUseError
            If another fit has it.
        WriteError
            If nothing can be written there.
        """
        self._lock.acquire()
        remove_temporaries(self.path)

    def check_replaceable(self) -> None:
        """See to it that a fit which begins anew replaces checkpoints and nothing else.

        Raises
        ------
        OptionError
            If another file lies at the path, or where the checkpoint before is kept.
        WriteError
            If what lies there cannot be read.
        """
        for path in (self.path, self.before):
            try:
                known = is_checkpoint(path)
            except FileNotFoundError:
                continue
            except OSError as error:
                raise unwritable(path, error) from error
            if not known:
                msg = f"`checkpoint`: {path} is there and is no checkpoint of a fit; remove it, or give another path"
                raise OptionError(msg)

    def release(self) -> None:
        """Let others have it."""
        self._lock.release()

    def load(self, settings: Mapping[str, str]) -> Checkpoint | None:
        """The last checkpoint that is whole, for a fit with these settings; None if there is none at all.

        Raises
        ------
        CheckpointError
            If none of those that lie there is whole.
        ParameterError
            If it is of a fit with other settings.
        """
        refused: list[tuple[str, str]] = []
        for path in (self.path, self.before):
            if not os.path.lexists(path):
                continue
            try:
                state = load_checkpoint(path, settings)
            except CheckpointError as error:
                refused += error.refused
                continue
            self._own, self._whole = True, path == self.path
            if path != self.path:
                why = f"not a checkpoint of a fit ({refused[0][1]})" if refused else "missing"
                msg = f"`checkpoint` {self.path} is {why}; the fit goes on from the one before it, {path}"
                warnings.warn(msg, CheckpointWarning, stacklevel=3)
            return state
        if refused:
            raise CheckpointError(*refused)
        return None

    def begin(self) -> None:
        """Remove the checkpoints of an earlier fit, unless this one goes on from them: nothing may resume them now.

        Raises
        ------
        WriteError
            If they cannot be removed.
        """
        if not self._own:
            for path in (self.before, self.path):
                try:
                    path.unlink(missing_ok=True)
                except OSError as error:
                    raise unwritable(path, error) from error
            self._own = True

    def save(self, state: Checkpoint) -> None:
        """Write the checkpoint; what was the last before is then the one before it.

        Raises
        ------
        WriteError
            If it cannot be written. What can be resumed from is then what it was.
        """
        if not self._lock.held:  # the fit is over and saved, and this may be somebody else's by now
            return
        self.begin()
        save_checkpoint(self.path, state, before=self.before if self._whole else None)
        self._whole = True

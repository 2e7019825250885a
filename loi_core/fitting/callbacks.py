"""Callbacks of a fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from loi_core.errors import OptionError
from loi_core.fitting.history import FitStep
from loi_core.fitting.views import Images
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Host
from loi_core.support.wording import shown

__all__ = ["Callback", "RememberingCallback", "ends_the_fit"]

Callback: TypeAlias = Callable[[FitStep, Parameters, Images], bool | None]
"""Called after every step with the step, its parameters and its image; returning True ends the fit."""


def ends_the_fit(answer: object) -> bool:
    """Return whether the return value of a callback ends the fit.

    Raises
    ------
    OptionError
        If it is neither a bool nor None; an array, for one, is neither true nor false.
    """
    if answer is None or isinstance(answer, bool | np.bool_):
        return bool(answer)
    msg = f"`callback` must return True to end the fit, or False or None, got {shown(answer)}"
    raise OptionError(msg)


@runtime_checkable
class RememberingCallback(Protocol):
    """A callback whose memory is saved in checkpoints, so that a resumed fit restores it."""

    def __call__(self, step: FitStep, params: Parameters, image: Images, /) -> bool | None:
        """Handle a step, as any callback."""

    def memory(self) -> Mapping[str, Host]:
        """Return the memory to save: arrays of numbers by name. It may cover more steps than the checkpoint."""

    def restore(self, memory: Mapping[str, Host], /) -> None:
        """Restore the memory before the first step; it is empty if another callback wrote the checkpoint."""

"""A progress bar of the steps of a fit, in terminals and notebooks."""

from __future__ import annotations

import warnings
from types import TracebackType
from typing import Any

from loi_core.fitting.history import FitStep

__all__ = ["StepBar"]


class StepBar:
    """A bar with the number of steps, the stage and the objective; leaving its ``with`` block ends its line.

    Parameters
    ----------
    steps, done : int
        Number of steps of the fit, and of those that an earlier one has done.
    stages : int
    is_shown : bool
        Whether there is a bar at all.
    """

    def __init__(self, steps: int, done: int, stages: int, *, is_shown: bool) -> None:
        self._stages = stages
        self._bar: Any = None
        if is_shown:
            with warnings.catch_warnings():
                # In a notebook without ipywidgets tqdm warns, and shows a bar of text.
                warnings.simplefilter("ignore")
                from tqdm.auto import tqdm
            self._bar = tqdm(total=steps, initial=done, desc="fit")

    def show(self, step: FitStep) -> None:
        """Show a step that is done."""
        if self._bar is not None:
            stage = f"stage {step.stage + 1} of {self._stages}, " if self._stages > 1 else ""
            self._bar.set_postfix_str(f"{stage}objective {step.value:.3g}", refresh=False)
            self._bar.update()

    def __enter__(self) -> StepBar:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.close()

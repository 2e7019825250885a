"""The schedule of a fit from far to near: which of several losses the next step uses.

Narrow scales hold an object at a wrong position where the texture under it happens to match. Wide scales see past the
texture but not small displacements. The schedule advances once the loss no longer falls, judged from its values alone,
so it serves every loop, and a resumed fit repeats the same decisions.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np

from loi_core.errors import OptionError
from loi_core.support.arrays import Array, to_numpy
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["MAIN_STUCK_FRACTION", "MIN_WINDOW", "WINDOW_FRACTION", "FarToNear", "Schedule", "has_settled"]

FAR_FRACTION: Final = 0.6
"""Fraction of the steps that all stages before the main stage may take together; the rest lets the fit converge."""

MAIN_FRACTION: Final = 0.7
"""Fraction of the steps that all stages before the finish may take together."""

WINDOW_FRACTION: Final = 0.08
"""Number of values that show whether a loss has settled, as a fraction of the steps."""

MIN_WINDOW: Final = 8  # values
MAX_WINDOW: Final = 512  # values; a step of a long fit then takes as long as a step of a short fit
MIN_SIGNIFICANCE: Final = 2.0
"""Standard errors by which the slope of the values must be negative to count as a fall."""

MIN_FALL: Final = 1e-3
"""Fraction of the value by which a loss must fall over the window."""

MIN_REMAINING_FALL: Final = 0.1
"""The same over all steps that remain, where a search can follow: a slower fall would not end near the target."""

STUCK_FRACTION: Final = 0.3
"""Fraction of its highest value at which the first stage is stuck if it settles there.

A fit that starts near the target moves away from it first, by the length of its steps: its first value is no measure.
"""

MAIN_STUCK_FRACTION: Final = 0.025
"""The same for the main stage."""

UNDECAYED_STUCK_FRACTION: Final = 0.1
"""The same for a main stage before a finish: its rate has hardly decayed, so that it oscillates around a minimum."""

MAX_RESTART_PROGRESS: Final = 0.5
"""Progress of the main stage beyond which no time is left for a restart, unless a stage follows."""


def has_settled(values: Sequence[float], window: int, min_fall: float = MIN_FALL) -> bool:
    """Return whether values have stopped falling: the line through the last of them has no significant negative slope.

    Parameters
    ----------
    values : sequence of float
        One for each step.
    window : int
        Number of values to fit, 3 or more; at least twice as many are required.
    min_fall : float
        Fraction of the value by which a loss that has not settled falls over the window.
    """
    if len(values) < 2 * window:
        return False
    last = np.asarray(values[-window:], dtype=np.float64)
    steps = np.arange(window) - (window - 1) / 2.0
    variance = float(np.sum(steps**2))
    slope = float(steps @ last) / variance
    residual = last - np.mean(last) - slope * steps
    error = math.sqrt(float(np.sum(residual**2)) / (window - 2) / variance)
    return slope > -MIN_SIGNIFICANCE * error or -slope * window < min_fall * abs(float(np.mean(last)))


@dataclass(frozen=True)
class Schedule:
    """The state of a schedule after some steps; each method returns a new one.

    Attributes
    ----------
    stages : int
        Number of losses, 1 or more. The main stage is the last, or the last but one before a finish.
    steps : int
        Number of steps of the whole loop.
    restarts : int
        Number of times that a stage may still be stuck.
    noise_floor : float
        Value of the main loss at or below which the main stage is not stuck.
    finishes : bool
        Whether the last loss only finishes the result of the main stage; it is never stuck.
    stage : int
        Index of the loss that the next step uses.
    stuck : bool
        Whether the first stage or the main stage has settled, or has ended, at a high value. :meth:`restart` or
        :meth:`proceed` continues.
    step, stage_start, main_start : int
        Number of steps taken, in total, when this stage started, and when the main stage started.
    values : tuple of float
        The last values of this stage, at most two windows.
    highest_value : float
        The highest value of this stage.
    """

    stages: int
    steps: int
    restarts: int = 0
    noise_floor: float = math.inf
    finishes: bool = False
    stage: int = 0
    stuck: bool = False
    step: int = 0
    stage_start: int = 0
    main_start: int = 0
    values: tuple[float, ...] = ()
    highest_value: float = 0.0

    def after(self, value: float) -> Schedule:
        """Return the schedule after one more step; `value` is the loss of this stage in that step."""
        window = min(max(MIN_WINDOW, round(WINDOW_FRACTION * self.steps)), MAX_WINDOW)
        values = (*self.values[1 - 2 * window :], value)
        taken = replace(self, step=self.step + 1, values=values, highest_value=max(self.highest_value, value))
        is_last = self.stage == self.stages - 1
        min_fall = MIN_FALL
        if self.restarts > 0:
            min_fall = max(MIN_FALL, MIN_REMAINING_FALL * window / max(self.steps - taken.step, 1))
        settled = (not is_last or self.restarts > 0) and (value == 0.0 or has_settled(values, window, min_fall))
        ends = settled or taken._is_over
        # A main stage that runs out of steps leaves the rest of the way to the finish.
        stuck = ends and self.restarts > 0 and taken._is_high() and (settled or self.stage < self._main)
        return taken._next_stage() if ends and not is_last and not stuck else replace(taken, stuck=stuck)

    def restart(self) -> Schedule:
        """Return the schedule with the stuck stage restarted; with the next stage if this one has no steps left."""
        if self._is_over:
            return replace(self._next_stage(), restarts=self.restarts - 1)
        again = replace(self, stuck=False, restarts=self.restarts - 1, values=())
        is_main = self.stage == self._main
        return replace(again, stage_start=self.step, main_start=self.step) if is_main else again

    def in_main_stage(self) -> Schedule:
        """Return the schedule at the start of its main stage, after a race; at the next stage if no steps are left.

        The race has rendered as often as all restarts together.
        """
        started = replace(self._at_stage(self._main), restarts=0)
        return started._next_stage() if started._is_over else started

    def proceed(self) -> Schedule:
        """Return the schedule with the stuck stage left: the next stage, or the rest of the main stage."""
        if self.stage == self._main and not self._is_over:
            return replace(self, stuck=False, restarts=self.restarts - 1, values=())
        return self._next_stage()

    @property
    def level(self) -> float:
        """The minimum of the last values of this stage."""
        window = min(max(MIN_WINDOW, round(WINDOW_FRACTION * self.steps)), MAX_WINDOW)
        return min(self.values[-window:], default=math.inf)

    @property
    def passed(self) -> float:
        """The progress of the last stage, from 0 to 1; 0 before it."""
        return 0.0 if self.stage < self.stages - 1 else self._progress

    @property
    def main_passed(self) -> float:
        """The progress of the main stage and the finish together, from 0 to 1; 0 before them."""
        if self.stage < self._main:
            return 0.0
        return (self.step - self.main_start) / max(self.steps - self.main_start - 1, 1)

    def to_json(self) -> str:
        """Return the schedule without its options `stages` and `steps` as text."""
        names = [entry.name for entry in fields(self) if entry.name not in ("stages", "steps")]
        return json.dumps({name: getattr(self, name) for name in names})

    def restored(self, text: str) -> Schedule:
        """Return the schedule with these options in the state that :meth:`to_json` has written."""
        state: dict[str, Any] = json.loads(text)
        return replace(self, **(state | {"values": tuple(state["values"])}))

    @property
    def _main(self) -> int:
        return max(self.stages - 1 - self.finishes, 0)

    @property
    def _deadline(self) -> float:
        """The last step of this stage, if it does not settle earlier."""
        if self.stage < self._main:
            return FAR_FRACTION * self.steps * (self.stage + 1) / self._main
        return self.steps if self.stage == self.stages - 1 else MAIN_FRACTION * self.steps

    @property
    def _is_over(self) -> bool:
        """Whether a stage follows and this one has no steps left."""
        return self.stage < self.stages - 1 and self.step >= self._deadline

    @property
    def _progress(self) -> float:
        """The progress of this stage, from 0 to 1 if it lasts until its deadline."""
        return (self.step - self.stage_start) / max(self._deadline - self.stage_start - 1, 1)

    def _is_high(self) -> bool:
        if self.stage == self._main:
            has_time = self.finishes or self._progress < MAX_RESTART_PROGRESS
            fraction = UNDECAYED_STUCK_FRACTION if self.finishes else MAIN_STUCK_FRACTION
            return has_time and self.level > max(self.noise_floor, fraction * self.highest_value)
        return self.stage == 0 and self.level > STUCK_FRACTION * self.highest_value

    def _next_stage(self) -> Schedule:
        return self._at_stage(self.stage + 1)

    def _at_stage(self, stage: int) -> Schedule:
        main_start = self.step if stage <= self._main else self.main_start
        return replace(
            self,
            stage=stage,
            stage_start=self.step,
            main_start=main_start,
            values=(),
            stuck=False,
            highest_value=0.0,
        )


@suggest_keywords
class FarToNear:
    """Chooses one of several losses, ordered from far to near, for each step of a loop, from the values of the loss.

    Parameters
    ----------
    stages : int
        Number of losses, 1 or more.
    steps : int
        Number of steps of the whole loop.

    Raises
    ------
    OptionError
        If a number is not allowed.

    Examples
    --------
    With any framework's loop, ``losses`` being its losses with ``ScaleSpace.far_to_near(height, width)``:

    >>> schedule = FarToNear(stages=2, steps=200)
    >>> for value in [1.0] * 40:  # the value of losses[schedule.stage], which does not fall
    ...     schedule.step(value)
    >>> schedule.stage
    1
    """

    def __init__(self, stages: int, steps: int) -> None:
        for name, value in (("stages", stages), ("steps", steps)):
            if (whole_number(value) or 0) < 1:
                msg = f"`{name}` must be a whole number, 1 or more, got {shown(value)}"
                raise OptionError(msg)
        self._schedule = Schedule(int(stages), int(steps))

    @property
    def stage(self) -> int:
        """Index of the loss that the next step uses; 0 at first."""
        return self._schedule.stage

    @property
    def passed(self) -> float:
        """Progress of the last stage, from 0 to 1; 0 before it. A learning rate may decay with it."""
        return self._schedule.passed

    def step(self, value: float | Array) -> None:
        """Record the value of the loss of this stage in one step, and advance to the next stage once it has settled.

        Parameters
        ----------
        value : float, or array of one number
            From any library; the computation graph of the value is left alone.

        Raises
        ------
        OptionError
            If it is several numbers, as a loss without reduction returns.
        """
        numbers = to_numpy(value)
        if numbers.size != 1:
            msg = f"`value` must be one number, such as the mean of the losses of a batch, got shape {numbers.shape}"
            raise OptionError(msg)
        self._schedule = self._schedule.after(float(numbers.reshape(())))

"""Far to near: a fit begins with scales that reach far, and goes on to those that place the last digits.

Narrow scales hold an object where the texture under it happens to fit; wide ones see past that, but do not see small
displacements. When to go on is decided from the values alone: a stage is over once its loss has stopped to fall, as far
as its own noise lets one say. So the same decision serves every loop, and a fit that is resumed comes to it again.
"""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Sequence
from typing import Final, Literal, TypeAlias, get_args

import numpy as np

from loi_core.errors import OptionError
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import ImageObjective, LOIObjective, Objective, PixelL2
from loi_core.support.arrays import Array, to_numpy
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["FarToNear", "Finish", "Stages", "finish_of", "has_settled", "objectives_of"]

Stages: TypeAlias = Literal["auto"] | Sequence[ScaleSpace | Objective] | None
Finish: TypeAlias = Literal["pixels"] | None

FAR: Final = 0.6
"""All stages before the one that places may take this fraction of the steps together: it needs the rest to converge."""

PLACED: Final = 0.8
"""With a finish, the stages before it may take this fraction of the steps together."""

WINDOW: Final = 0.08
"""How many of the last values are looked at, as a fraction of the steps; from LEAST to MOST."""

LEAST: Final = 8
MOST: Final = 512  # so that a step of a long fit takes no longer than one of a short fit
SURE: Final = 2.0
"""Errors of the slope of the values that a fall has to exceed."""

FLAT: Final = 1e-3
"""A fall over the window of less than this fraction of the value is none."""


LOST: Final = 0.3
"""Of the first value of the first stage: a stage that settles with more has not found what it was to find."""

HALF: Final = 0.5
"""Of the stage that places: later than that there is no time to begin again."""


def has_settled(values: Sequence[float], window: int) -> bool:
    """Whether values have stopped to fall: the line through the last of them is not significantly downward.

    Parameters
    ----------
    values : sequence of float
        One a step.
    window : int
        How many of the last to look at, 3 or more; twice as many have to be there.
    """
    if len(values) < 2 * window:
        return False
    last = np.asarray(values[-window:], dtype=np.float64)
    steps = np.arange(window) - (window - 1) / 2.0
    spread = float(np.sum(steps**2))
    slope = float(steps @ last) / spread
    rest = last - np.mean(last) - slope * steps
    error = math.sqrt(float(np.sum(rest**2)) / (window - 2) / spread)
    return slope > -SURE * error or -slope * window < FLAT * abs(float(np.mean(last)))


class FarToNear:
    """Which of some losses, from far to near, a loop is to use; told the value of every step.

    Parameters
    ----------
    stages : int
        How many losses there are, 1 or more.
    steps : int
        Of the whole loop.
    searches : int
        How often a stage may be `lost`.
    enough : float
        A value of the loss that places with which it is not `lost`.
    finish : bool
        Whether the last loss only finishes what the one before it has placed: it is never `lost`.

    Attributes
    ----------
    stage : int
        The loss to use in the next step: 0 at first.
    lost : bool
        Whether the first loss, or the one that places, which is the last but for a finish, has settled with much of
        it left: then :meth:`begin_again` or :meth:`go_on`.

    Examples
    --------
    With any framework's loop, ``losses`` being its losses with ``ScaleSpace.far_to_near(height, width)``:

    >>> schedule = FarToNear(stages=2, steps=200)
    >>> for value in [1.0] * 40:  # the value of losses[schedule.stage], which does not fall
    ...     schedule.step(value)
    >>> schedule.stage
    1
    """

    def __init__(
        self, stages: int, steps: int, *, searches: int = 0, enough: float = math.inf, finish: bool = False
    ) -> None:
        for name, value in (("stages", stages), ("steps", steps)):
            if (whole_number(value) or 0) < 1:
                msg = f"`{name}` must be a whole number, 1 or more, got {shown(value)}"
                raise OptionError(msg)
        self.stage: int = 0
        self.stages = int(stages)
        self.lost = False
        self._searches = searches
        self._enough = enough
        self._last = stages - 1
        self._placing = max(self._last - finish, 0)
        self._steps = steps
        self._window = min(max(LEAST, round(WINDOW * steps)), MOST)
        self._taken = 0
        self._began = 0  # the step in which this stage did
        self._values: list[float] = []
        self._first: float | None = None

    def step(self, value: float | Array) -> None:
        """Take note of the value that the loss of this stage had in this step.

        Parameters
        ----------
        value : float, or array of one number
            Of any library, as its loss returns it; what it recorded for its gradient stays as it is.
        """
        self._taken += 1
        self._values = [*self._values[1 - 2 * self._window :], float(to_numpy(value).reshape(()))]
        if self.stage == 0 and self._first is None:
            self._first = self._values[0]
        last = self.stage == self._last
        settled = (not last or self._searches > 0) and has_settled(self._values, self._window)
        self.lost = settled and self._searches > 0 and self._is_lost()
        if not last and not self.lost and (settled or self._taken >= self._latest):
            self._next()

    def _is_lost(self) -> bool:
        if self.stage == self._placing:
            return self._share < HALF and self.level > self._enough
        return self.stage == 0 and self.level > LOST * (self._first or 0.0)

    @property
    def _latest(self) -> float:
        """The step at which the stage ends at the latest."""
        if self.stage < self._placing:
            return FAR * self._steps * (self.stage + 1) / self._placing
        return self._steps if self.stage == self._last else PLACED * self._steps

    @property
    def _share(self) -> float:
        """How much of the stage is over, from 0 to 1, if it takes as long as it may."""
        return (self._taken - self._began) / max(self._latest - self._began - 1, 1)

    def _next(self) -> None:
        self.stage, self._began, self._values = self.stage + 1, self._taken, []

    def go_on(self) -> None:
        """Go on from where it was `lost`: with the next stage, or with the one that places."""
        if self.stage == self._placing:
            self._searches -= 1
        else:
            self._next()
        self.lost, self._values = False, []

    def begin_again(self) -> None:
        """Begin the stage again, from somewhere else."""
        self.lost, self._searches, self._values = False, self._searches - 1, []
        if self.stage == self._placing:
            self._began = self._taken

    @property
    def level(self) -> float:
        """The least of the last values of a stage."""
        return min(self._values[-self._window :], default=math.inf)

    @property
    def searches(self) -> int:
        """How many searches are left."""
        return self._searches

    def copy(self) -> FarToNear:
        """One that goes on from here, and leaves this as it is."""
        return copy.copy(self)  # its list of values is never written to

    def state(self) -> str:
        """All of it but what the values of the steps tell, as text, for :meth:`restore`."""
        return json.dumps(
            [self.stage, self._taken, self._began, len(self._values), self._searches, self._first, self._enough]
        )

    def restore(self, state: str, values: Sequence[float]) -> None:
        """Go on from a state, with the values of all steps so far.

        Raises
        ------
        ValueError
            If the text is none that :meth:`state` gives.
        """
        stage, taken, began, count, searches, first, enough = json.loads(state)
        if not 0 <= stage <= self._last or not 0 <= began <= taken or not 0 <= count <= len(values):
            msg = "not the state of a schedule"
            raise ValueError(msg)
        self.stage, self._taken, self._began, self._searches, self._first = stage, taken, began, searches, first
        self._enough = enough
        self._values = list(values[len(values) - count :])

    @property
    def passed(self) -> float:
        """How much of the last stage is over, from 0 to 1; 0 before it. A rate may fall with it."""
        return 0.0 if self.stage < self._last else self._share


def objectives_of(objective: Objective, stages: object) -> tuple[Objective, ...]:
    """The objectives of a fit, from far to near, for what was asked for as `stages`.

    Parameters
    ----------
    objective : Objective
        The last one.
    stages : "auto", None, or a sequence of ScaleSpace or Objective
        "auto" puts :meth:`ScaleSpace.far_to_near` before an objective whose scales were left to the library; None
        takes the objective alone; a sequence is what comes before it.

    Raises
    ------
    OptionError
        For anything else.
    """
    if stages is None:
        return (objective,)
    if isinstance(stages, str) and stages == "auto":
        if not isinstance(objective, LOIObjective) or not objective.has_default_scales:
            return (objective,)
        height, width = objective.size
        scales = objective.scales
        before = ScaleSpace.far_to_near(
            height, width, beta=scales.beta[0], bounds=scales.bounds, boundary=scales.boundary
        )[:-1]
        return (*map(objective.with_scales, before), objective)
    if isinstance(stages, str) or not isinstance(stages, Sequence):
        msg = f"`stages` must be 'auto', None, or a sequence of ScaleSpace or objectives, got {shown(stages)}"
        raise OptionError(msg)
    found: list[Objective] = []
    for one in stages:
        if isinstance(one, ScaleSpace) and isinstance(objective, LOIObjective):
            found.append(objective.with_scales(one))
        elif isinstance(one, Objective) and not isinstance(one, ScaleSpace):
            found.append(one)
        else:
            msg = f"`stages` must hold scales (for a LOIObjective) or objectives, got {shown(one)}"
            raise OptionError(msg)
    return (*found, objective)


def finish_of(objective: Objective, finish: object) -> tuple[Objective, ...]:
    """What comes after an objective, for what was asked for as `finish`: nothing, or its pixels compared.

    Raises
    ------
    OptionError
        For anything else, and if the objective has no reference image.
    """
    if finish is None:
        return ()
    if not isinstance(finish, str) or finish not in get_args(get_args(Finish)[0]):
        msg = f"`finish` must be 'pixels' or None, got {shown(finish)}"
        raise OptionError(msg)
    if not isinstance(objective, ImageObjective):
        msg = f"`finish` needs an objective that has a reference image, got {type(objective).__name__}"
        raise OptionError(msg)
    return (
        PixelL2(
            objective.reference,
            channel_axis=objective.channel_axis,
            nan_policy=objective.nan_policy,
            tone=objective.tone,
            weights=objective.weights,
        ),
    )

"""The state of a fit between two steps, and its result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from loi_core.fitting.history import FitStep
from loi_core.fitting.notebook import result_html
from loi_core.fitting.optimiser import Memory
from loi_core.fitting.schedule import Schedule
from loi_core.fitting.verdict import Diagnosis
from loi_core.fitting.views import Images, Views, mean, ungrouped
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, to_numpy

__all__ = ["Best", "Evaluation", "FitResult", "State"]


@dataclass(frozen=True, repr=False)
class FitResult:
    """The result of a fit.

    Attributes
    ----------
    params : dict of arrays
        After the last step.
    best_params : dict of arrays
        The parameters with the least value.
    best_value : float
    best_step : int
        The step that evaluated them; the number of steps if they were evaluated after the last.
    image : array, shape (H, W, C), or dict of arrays
        Rendered from `best_params`; a dict by the names of several views.
    history : list of FitStep
        One entry for each step.
    diagnosis : Diagnosis, optional
        The verdict and advice; None for a fit that was interrupted.
    rates : dict of float
        Learning rate of each free parameter, in its own unit.
    agreeing : int, optional
        Of several starts, how many finalists ended where the best did.
    psnr : float, optional
        Of `image` against the reference, in dB for a peak of 1, over all views; None for a fit that was interrupted,
        and if an objective has no reference of the image's shape.
    exposure : LinearExposure, or dict of LinearExposure, optional
        Gain and offset of each channel, shape (C,), by which the reference differs from `image`; a dict by the names of
        several views; None as for `psnr`.
    plan : EffectPlan, or dict of EffectPlan, optional
        The last plan of a renderer that plans its effects; a dict by the names of several views; None without any.
    """

    params: Parameters
    best_params: Parameters
    best_value: float
    best_step: int
    image: Images
    history: list[FitStep]
    diagnosis: Diagnosis | None = None
    rates: Mapping[str, float] = field(default_factory=dict)
    agreeing: int | None = None
    psnr: float | None = None
    exposure: Any = None
    plan: Any = None

    def __repr__(self) -> str:
        verdict = "cut short" if self.diagnosis is None else self.diagnosis.verdict
        return f"<FitResult: {verdict}; best value {self._best}>"

    def _repr_html_(self) -> str:
        facts = {"best value": self._best}
        if self.psnr is not None:
            facts["PSNR"] = f"{self.psnr:.2f} dB"
        if self.agreeing is not None:
            facts["starts that agree"] = str(self.agreeing)
        return result_html("FitResult", facts, self.diagnosis, self.best_params, self.rates, self.history, self.image)

    @property
    def _best(self) -> str:
        return f"{self.best_value:.4g} at step {self.best_step} of {len(self.history)}"


@dataclass(frozen=True)
class Best:
    """The parameters with the least value of a stage, the step that evaluated them, and the images of their views."""

    params: Parameters
    value: float
    step: int
    images: Mapping[str, Array]
    stage: int = 0
    partial: bool = False
    """Whether the value covers only some views because not all have been rendered; any later value is better."""


@dataclass(frozen=True)
class Evaluation:
    """The value and gradient of the views of one step.

    Attributes
    ----------
    params : dict of arrays
    images, cotangents : dict of arrays, shape (H, W, C)
        Of the views that the step rendered: the image, and the gradient of the loss with respect to it.
    latest : dict of float
        The last value of each view in this stage.
    gradient : dict of arrays
        Of the mean of the rendered views, with respect to the free parameters.
    seed : int
    """

    params: Parameters
    images: dict[str, Array]
    cotangents: dict[str, Array]
    latest: dict[str, float]
    gradient: Parameters
    seed: int

    @property
    def value(self) -> float:
        """The mean of the last values of the views."""
        return mean(self.latest)

    @property
    def gradient_norm(self) -> float:
        """The Euclidean norm, computed in float64, since squares may leave the range of narrower dtypes."""
        squares = (np.square(to_numpy(slope), dtype=np.float64) for slope in self.gradient.values())
        return math.sqrt(sum(float(np.sum(square)) for square in squares))


@dataclass(frozen=True)
class State:
    """The whole state of a fit. A fit moves from one state to the next in a single assignment.

    Attributes
    ----------
    params : dict of arrays
        After `step` steps.
    memory : dict of arrays
        Of the optimiser, after `step` steps.
    views : Views
        The views, with the renderers of the previous step.
    step : int
        Number of steps taken.
    best : Best or None
        None before the first value.
    log : list of FitStep
        Its first `step` entries are the history. The states of a fit share the list, so that no step copies it.
    rates : dict of float
        Learning rate of each free parameter, in its own unit.
    schedule : Schedule
        Chooses the objective of the next step.
    latest : dict of float
        The last value of each view in this stage.
    agreeing : int, optional
        Of several starts, how many finalists ended where the best did.
    last : Evaluation, optional
        Of the previous step; None before the first step and after a resumption.
    """

    params: Parameters
    memory: Memory
    views: Views
    step: int = 0
    best: Best | None = None
    log: list[FitStep] = field(default_factory=list)
    rates: Mapping[str, float] = field(default_factory=dict)
    schedule: Schedule = field(default_factory=lambda: Schedule(1, 1))
    latest: Mapping[str, float] = field(default_factory=dict)
    agreeing: int | None = None
    last: Evaluation | None = None

    @property
    def history(self) -> list[FitStep]:
        """One entry for each step taken."""
        return self.log[: self.step]

    def evaluated(self, value: float, images: Mapping[str, Array], stage: int, *, partial: bool = False) -> State:
        """Return the state with the value and images of its parameters, which are the best if the value is less.

        Only values of one stage are compared, and no `partial` values, which cover only some of the views.
        """
        best = self.best
        if best is not None and best.stage == stage and not best.partial and (partial or not value < best.value):
            return self
        return replace(self, best=Best(self.params, value, self.step, images, stage, partial))

    def revisited(self, steps: int) -> State:
        """Return the state with the renderers of the next of `steps` steps."""
        value = self.log[self.step - 1].value if self.step else None
        params, cotangents, seed = (
            (self.params, {}, 0) if self.last is None else (self.last.params, self.last.cotangents, self.last.seed)
        )
        views = self.views.revisited(self.step, steps, value, params, cotangents, seed)
        return replace(self, views=views)

    def stepped(self, entry: FitStep, params: Parameters, memory: Memory, evaluation: Evaluation) -> State:
        """Return the state after one more step."""
        self.log[self.step :] = [entry]  # beyond the history of this state and of all earlier ones
        schedule = self.schedule.after(entry.value)
        return replace(
            self,
            params=params,
            memory=memory,
            step=self.step + 1,
            schedule=schedule,
            latest=evaluation.latest if schedule.stage == self.schedule.stage else {},
            last=evaluation,
        )

    def result(self) -> FitResult | None:
        """Return the result so far; None before the first value."""
        if self.best is None:
            return None
        best = self.best
        image, plans = ungrouped(best.images), self.views.plans()
        return FitResult(
            *(self.params, best.params, best.value, best.step, image, self.history),
            rates=self.rates,
            agreeing=self.agreeing,
            plan=ungrouped(plans) if plans else None,
        )

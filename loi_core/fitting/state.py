"""How far a fit has come: its steps, its best parameters, its state between two steps, and its result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from loi_core.fitting.history import FitStep
from loi_core.fitting.notebook import result_html
from loi_core.fitting.optimiser import Memory
from loi_core.fitting.stages import FarToNear
from loi_core.fitting.verdict import Diagnosis
from loi_core.fitting.views import Images, as_given
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array

__all__ = ["Best", "FitResult", "State"]


@dataclass(frozen=True, repr=False)
class FitResult:
    """Where a fit came to.

    Attributes
    ----------
    params : dict of arrays
        After the last step.
    best_params : dict of arrays
        Those with the least value.
    best_value : float
        That value.
    best_step : int
        The step at which they were seen; equal to the number of steps if after the last.
    image : array, shape (H, W, C), or dict of arrays
        Rendered from `best_params`; of several views, by their names.
    history : list of FitStep
        One entry for each step.
    diagnosis : Diagnosis, optional
        What came of it and what to try; None for a fit that was cut short.
    rates : dict of float
        How far a step could move each free parameter, in its own unit.
    agreeing : int, optional
        Of several starts, how many of those that were left ended where the best did.
    psnr : float, optional
        Of `image` against the reference, in dB for a peak of 1, over all views; None for a fit that was cut short, and
        where an objective has no reference of the image's shape.
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

    def __repr__(self) -> str:
        verdict = "cut short" if self.diagnosis is None else self.diagnosis.verdict
        where = f"best value {self.best_value:.4g} at step {self.best_step} of {len(self.history)}"
        return f"<FitResult: {verdict}; {where}>"

    def _repr_html_(self) -> str:
        facts = {"best value": f"{self.best_value:.4g} at step {self.best_step} of {len(self.history)}"}
        if self.psnr is not None:
            facts["PSNR"] = f"{self.psnr:.2f} dB"
        if self.agreeing is not None:
            facts["starts that agree"] = str(self.agreeing)
        return result_html("FitResult", facts, self.diagnosis, self.best_params, self.rates, self.history, self.image)


@dataclass(frozen=True)
class Best:
    """The parameters with the least value of a stage, the step at which they were seen, and the images of its views."""

    params: Parameters
    value: float
    step: int
    images: Mapping[str, Array]
    stage: int = 0
    partial: bool = False
    """Whether the value is of some views only, as not all have been rendered yet: then anything later is better."""


@dataclass(frozen=True)
class State:
    """Everything that moves in a fit. A fit goes from one state to the next in a single assignment.

    Attributes
    ----------
    params : dict of arrays
        After `step` steps.
    memory : dict of arrays
        Of the optimiser, after as many.
    step : int
        Number of steps taken.
    best : Best or None
        None before the first value.
    log : list of FitStep
        Its first `step` entries are the history. The states of a fit share the list, so that no step copies it.
    rates : dict of float
        Of each free parameter, in its own unit.
    schedule : FarToNear
        Which objective is next.
    latest : dict of float
        The value that each view had when it was last rendered in this stage.
    agreeing : int, optional
        Of several starts, how many ended where the best did.
    """

    params: Parameters
    memory: Memory
    step: int = 0
    best: Best | None = None
    log: list[FitStep] = field(default_factory=list)
    rates: Mapping[str, float] = field(default_factory=dict)
    schedule: FarToNear = field(default_factory=lambda: FarToNear(1, 1))
    latest: Mapping[str, float] = field(default_factory=dict)
    agreeing: int | None = None

    @property
    def history(self) -> list[FitStep]:
        """One entry for each step taken."""
        return self.log[: self.step]

    def seen(self, value: float, images: Mapping[str, Array], stage: int = 0, *, partial: bool = False) -> State:
        """The same state, once the value and images of its parameters are known.

        Values of one stage are compared, unless they are `partial`: of some of the views only.
        """
        best = self.best
        if best is not None and best.stage == stage and not best.partial and (partial or not value < best.value):
            return self
        return replace(self, best=Best(self.params, value, self.step, images, stage, partial))

    def stepped(
        self, entry: FitStep, params: Parameters, memory: Memory, latest: Mapping[str, float] | None = None
    ) -> State:
        """The state after one more step."""
        self.log[self.step :] = [entry]  # past the history of this state and of all before it
        ahead = self.schedule.copy()
        ahead.step(entry.value)
        latest = latest if latest and ahead.stage == self.schedule.stage else {}
        return replace(self, params=params, memory=memory, step=self.step + 1, schedule=ahead, latest=latest)

    def result(self) -> FitResult | None:
        """What has been reached; None before the first value."""
        if self.best is None:
            return None
        best = self.best
        image = as_given(best.images)
        return FitResult(
            *(self.params, best.params, best.value, best.step, image, self.history),
            rates=self.rates,
            agreeing=self.agreeing,
        )

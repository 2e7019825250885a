"""What planning effects is worth in one scene: beside Mitsuba's defaults, everything on, and settings by hand."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from examples.effects.scenes import Case
from loi_core import Free, LOIObjective, Renderer, ScaleSpace, fit
from loi_core.effects import Comparison, EffectPlan, compare
from loi_mitsuba import MitsubaRenderer, PlannedRenderer
from loi_mitsuba.effects.verify import step_draws, steps_in_turn

__all__ = ["FULL", "QUICK", "Effort", "Row", "measure"]


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes
    ----------
    width, height : int
        Of the images.
    samples : int
        Per pixel, of the image and of each part of the gradient.
    draws : int
        Gradients of each setting that are compared.
    steps : int
        Of a fit.
    defaults : int
        Steps of Mitsuba's defaults that are timed, after one that is not; 0 leaves them out, for each may take half
        a minute.
    """

    width: int = 96
    height: int = 72
    samples: int = 16
    draws: int = 24
    steps: int = 120
    defaults: int = 1


FULL: Final = Effort()
QUICK: Final = Effort(32, 24, 8, 4, 4, 0)
FIT: Final = 300  # steps of a fit, of which a pilot may cost a share


@dataclass(frozen=True)
class Row:
    """What was measured of one scene. Seconds are of a step: image, loss and gradient; NaN if not measured.

    Attributes
    ----------
    name : str
        The scene's.
    plan : EffectPlan
        After the pilot.
    gradient : Comparison
        Against everything on without guiding.
    seconds, full_seconds, default_seconds, hand_seconds : float
        Of the plan, everything on without guiding, Mitsuba's defaults, and the settings by hand.
    pilot_seconds : float
        Of a pilot whose kernels have been compiled.
    error, full_error : float
        Distance of the fitted parameters from the true ones over that of the start: planned, and everything on.
    """

    name: str
    plan: EffectPlan
    gradient: Comparison
    seconds: float
    full_seconds: float
    default_seconds: float
    hand_seconds: float
    pilot_seconds: float
    error: float
    full_error: float

    @property
    def pilot_share(self) -> float:
        """Time of the pilot over that of 300 steps."""
        return self.pilot_seconds / (FIT * self.seconds)


def measure(case: Case, effort: Effort = FULL) -> Row:
    """Measure one scene; kernels are compiled before anything is timed."""
    start, truth = dict(case.start), dict(case.truth)

    # Each renderer has a scene of its own: a mesh in a dict is one object, which stays where the last call has put it.
    def scene() -> dict[str, Any]:
        return case.scene(effort.width, effort.height)

    planned = PlannedRenderer(scene(), case.parameters, spp=effort.samples)
    rules = planned.plan
    target = MitsubaRenderer(scene(), case.parameters, integrator=rules, spp=16 * effort.samples).render(
        truth, seed=10**6
    )
    objective = LOIObjective(target, ScaleSpace.for_image(effort.height, effort.width))
    pilot_seconds = min(_pilot(planned, objective, start) for _ in range(2))
    plan = planned.plan

    def by(integrator: Any, **options: Any) -> MitsubaRenderer:
        return MitsubaRenderer(scene(), case.parameters, integrator=integrator, spp=effort.samples, **options)

    full = by(planned.everything)
    groups = planned.groups
    draws = range(effort.draws)
    others = range(effort.draws, 2 * effort.draws)
    by_hand = by(dict(case.hand), spp_grad=effort.samples)
    found, wanted, hand = step_draws((by(plan), full, by_hand), objective, start, groups, (draws, others, draws))
    default_seconds = math.nan
    if effort.defaults:
        default = by(dict(case.default), spp_grad=effort.samples)
        ((_, default_seconds),) = steps_in_turn((default,), objective, start, (range(effort.defaults),))
    return Row(
        name=case.name,
        plan=plan,
        gradient=compare(found, wanted),
        seconds=found.seconds,
        full_seconds=wanted.seconds,
        default_seconds=default_seconds,
        hand_seconds=hand.seconds,
        pilot_seconds=pilot_seconds,
        error=_fitted(case, PlannedRenderer(scene(), case.parameters, spp=effort.samples), objective, effort),
        full_error=_fitted(case, full, objective, effort),
    )


def _pilot(planned: PlannedRenderer, objective: LOIObjective, start: Mapping[str, Any]) -> float:
    cotangent = objective.value_and_grad(planned.render(start))[1]
    begin = time.perf_counter()
    planned.begin(start, cotangent, optimise=list(start))
    return time.perf_counter() - begin


def _fitted(case: Case, renderer: Renderer, objective: LOIObjective, effort: Effort) -> float:
    free = {name: Free(value) for name, value in case.start.items()}
    callback = renderer.watch if isinstance(renderer, PlannedRenderer) else None
    found = fit(
        renderer, objective, steps=effort.steps, learning_rate=case.rate, optimise=free, callback=callback
    ).best_params
    left = sum(float(np.sum((found[name] - case.truth[name]) ** 2)) for name in free)
    first = sum(float(np.sum((case.start[name] - case.truth[name]) ** 2)) for name in free)
    return math.sqrt(left / first)

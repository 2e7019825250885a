"""What planning effects is worth in one scene: beside Mitsuba's defaults, everything on, and settings by hand."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from examples.effects.scenes import Case
from loi_core import Free, LOIObjective, Renderer, ScaleSpace, fit
from loi_core.effects import Comparison, EffectPlan, Schedule, compare
from loi_core.effects.schedule import STALL_STEPS
from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer
from loi_mitsuba.effects.verify import step_draws, steps_in_turn

__all__ = ["FOUND", "FULL", "QUICK", "Effort", "Row", "looks_of_a_stall", "measure"]


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
    fits : int
        Fits of the plan and of everything on, with seeds 0, 1000, 2000 and so on.
    defaults : int
        Steps of Mitsuba's defaults that are timed, after one that is not; 0 leaves them out, for each may take half
        a minute.
    """

    width: int = 96
    height: int = 72
    samples: int = 16
    draws: int = 24
    steps: int = 120
    fits: int = 3
    defaults: int = 1


FULL: Final = Effort()
QUICK: Final = Effort(32, 24, 8, 4, 4, 1, 0)
FIT: Final = 300  # steps of a fit, of which a pilot may cost a fraction
FOUND: Final = 0.05  # of the way that may be left of a fit that has found the truth
APART: Final = 1000  # seeds of one fit and those of the next


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
    pilot_seconds, look_seconds : float
        Of a pilot and of a look at what it has turned off, whose kernels have been compiled.
    errors, full_errors : tuple of float
        Of each fit, the distance of its parameters from the true ones over that of the start: planned, and everything
        on.
    """

    name: str
    plan: EffectPlan
    gradient: Comparison
    seconds: float
    full_seconds: float
    default_seconds: float
    hand_seconds: float
    pilot_seconds: float
    look_seconds: float
    errors: tuple[float, ...]
    full_errors: tuple[float, ...]

    @property
    def pilot_fraction(self) -> float:
        """Time of the pilot over that of 300 steps."""
        return self.pilot_seconds / (FIT * self.seconds)

    @property
    def looks_fraction(self) -> float:
        """Time of the looks of a fit whose loss stalls from the first step on, over that of 300 steps."""
        return looks_of_a_stall(FIT) * self.look_seconds / (FIT * self.seconds)


def looks_of_a_stall(steps: int) -> int:
    """How often a fit of so many steps looks at what is off if its loss stalls from the first step on."""
    schedule, looks = Schedule(), 0
    for _ in range(steps):
        schedule = schedule.after_gradient()
        if schedule.is_due:
            schedule, looks = schedule.after_probe(), looks + 1
        schedule = schedule.after_step(1.0)
        if schedule.is_stalled:
            schedule, looks = schedule.after_stall().after_probe(), looks + 1
    return looks


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
    image = planned.render(start)  # by the rules, as at the start of a fit
    costs = [_planning(planned, objective, start, image) for _ in range(2)]
    plan = costs[-1][0]

    def by(integrator: Any, **options: Any) -> MitsubaRenderer:
        return MitsubaRenderer(scene(), case.parameters, integrator=integrator, spp=effort.samples, **options)

    full = by(planned.everything)
    groups = planned.groups
    draws = range(effort.draws)
    others = range(effort.draws, 2 * effort.draws)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", GradientWarning
        )  # the hand knows when a shape that moves has no outline in view
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
        pilot_seconds=min(pilot for _, pilot, _ in costs),
        look_seconds=min(look for _, _, look in costs),
        errors=_fitted(case, PlannedRenderer(scene(), case.parameters, spp=effort.samples), objective, effort),
        full_errors=_fitted(case, full, objective, effort),
    )


def _planning(
    planned: PlannedRenderer, objective: LOIObjective, start: Mapping[str, Any], image: Any
) -> tuple[EffectPlan, float, float]:
    """The plan, the time of its pilot, and that of one look at what it has turned off, because the loss stalls."""
    cotangent = objective.value_and_grad(image)[1]
    begin = time.perf_counter()
    plan = planned.begin(start, cotangent, optimise=list(start))
    begun = time.perf_counter()
    looked = begun
    for step in range(STALL_STEPS + 1):  # only the last of these looks
        looked = time.perf_counter()
        planned.at_step(step, STALL_STEPS + 1, 1.0)
    return plan, begun - begin, time.perf_counter() - looked


def _fitted(case: Case, renderer: Renderer, objective: LOIObjective, effort: Effort) -> tuple[float, ...]:
    free = {name: Free(value) for name, value in case.start.items()}
    first = sum(float(np.sum((case.start[name] - case.truth[name]) ** 2)) for name in free)
    errors = []
    for seed in range(0, effort.fits * APART, APART):
        if isinstance(renderer, PlannedRenderer):
            start = renderer.parameters() | dict(case.start)
            cotangent = objective.value_and_grad(renderer.render(start, seed=seed))[1]
            renderer.begin(start, cotangent, optimise=list(free), seed=seed)
        found = fit(
            renderer,
            objective,
            steps=effort.steps,
            learning_rate=case.rate,
            seed=seed,
            optimise=free,
        ).best_params
        left = sum(float(np.sum((found[name] - case.truth[name]) ** 2)) for name in free)
        errors.append(math.sqrt(left / first))
    return tuple(errors)

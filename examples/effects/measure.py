"""Compare a plan of effects with Mitsuba's defaults, with all effects on, and with manual settings, in one scene."""

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
from loi_core.renderers.verification import step_draws, steps_in_turn
from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer

__all__ = ["FULL", "MAX_ERROR", "QUICK", "Effort", "Row", "measure", "revisions_in_a_stall"]


@dataclass(frozen=True)
class Effort:
    """The extent of the measurements.

    Attributes
    ----------
    width, height : int
        Size of the images.
    samples : int
        Samples per pixel of the image and of each term of the gradient.
    draws : int
        Number of gradients for each setting.
    steps : int
        Steps of a fit.
    fits : int
        Fits with the plan and with all effects on, with seeds 0, 1000, 2000 ...
    defaults : int
        Timed steps with Mitsuba's defaults, after one that is not timed; 0 leaves them out, because each may take half
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
FIT_STEPS: Final = 300  # of the fit that the time of a pilot is compared with
MAX_ERROR: Final = 0.05  # relative to the initial error, of a fit that has found the true values
SEED_STRIDE: Final = 1000  # between the seeds of two fits


@dataclass(frozen=True)
class Row:
    """The measurements of one scene. Seconds are for a step, with image, loss and gradient; NaN if not measured.

    Attributes
    ----------
    name : str
        Name of the scene.
    plan : EffectPlan
        The plan after the pilot.
    gradient : Comparison
        Comparison with all effects on, without guiding.
    seconds, full_seconds, default_seconds, manual_seconds : float
        Time with the plan, with all effects on without guiding, with Mitsuba's defaults, and with manual settings.
    pilot_seconds, revision_seconds : float
        Time of a pilot and of a revision of the plan, with compiled kernels.
    errors, full_errors : tuple of float
        Distance of the fitted parameters from the true ones over the initial distance, for each fit with the plan and
        with all effects on.
    """

    name: str
    plan: EffectPlan
    gradient: Comparison
    seconds: float
    full_seconds: float
    default_seconds: float
    manual_seconds: float
    pilot_seconds: float
    revision_seconds: float
    errors: tuple[float, ...]
    full_errors: tuple[float, ...]

    @property
    def pilot_fraction(self) -> float:
        """Time of the pilot over the time of 300 steps."""
        return self.pilot_seconds / (FIT_STEPS * self.seconds)

    @property
    def revisions_fraction(self) -> float:
        """Time of the revisions in a fit whose loss stalls from the first step, over the time of 300 steps."""
        return revisions_in_a_stall(FIT_STEPS) * self.revision_seconds / (FIT_STEPS * self.seconds)


def revisions_in_a_stall(steps: int) -> int:
    """Return the number of revisions in a fit whose loss stalls from the first step."""
    schedule, revisions = Schedule(), 0
    for _ in range(steps):
        schedule = schedule.after_step(1.0).after_gradient()
        if schedule.is_stalled:
            schedule, revisions = schedule.after_stall().after_probe(), revisions + 1
        elif schedule.is_due:
            schedule, revisions = schedule.after_probe(), revisions + 1
    return revisions


def measure(case: Case, effort: Effort = FULL) -> Row:
    """Measure one scene, after its kernels have been compiled."""
    start, truth = dict(case.start), dict(case.truth)

    # Each renderer has its own scene: a mesh in a dict is an object that keeps its last position.
    def scene() -> dict[str, Any]:
        return case.scene(effort.width, effort.height)

    planned = PlannedRenderer(scene(), case.parameters, spp=effort.samples)
    rules = planned.plan
    target = MitsubaRenderer(scene(), case.parameters, integrator=rules, spp=16 * effort.samples).render(
        truth, seed=10**6
    )
    objective = LOIObjective(target, ScaleSpace.for_image(effort.height, effort.width))
    image = planned.render(start)  # with the plan by the rules, as at the start of a fit
    timings = [_time_planning(planned, objective, start, image) for _ in range(2)]
    started = timings[-1][0]
    plan = started.plan

    def render_with(integrator: Any, **options: Any) -> MitsubaRenderer:
        return MitsubaRenderer(scene(), case.parameters, integrator=integrator, spp=effort.samples, **options)

    full = render_with(started.everything)
    groups = started.groups
    draws = range(effort.draws)
    full_draws = range(effort.draws, 2 * effort.draws)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GradientWarning)  # an expert knows when a moving shape has no outline in view
        manual = render_with(dict(case.manual), spp_grad=effort.samples)
    plan_draws, reference, manual_draws = step_draws(
        (render_with(plan), full, manual), objective, start, groups, (draws, full_draws, draws)
    )
    default_seconds = math.nan
    if effort.defaults:
        default = render_with(dict(case.default), spp_grad=effort.samples)
        ((_, default_seconds),) = steps_in_turn((default,), objective, start, (range(effort.defaults),))
    return Row(
        name=case.name,
        plan=plan,
        gradient=compare(plan_draws, reference),
        seconds=plan_draws.seconds,
        full_seconds=reference.seconds,
        default_seconds=default_seconds,
        manual_seconds=manual_draws.seconds,
        pilot_seconds=min(pilot for _, pilot, _ in timings),
        revision_seconds=min(revision for _, _, revision in timings),
        errors=_fitted(case, PlannedRenderer(scene(), case.parameters, spp=effort.samples), objective, effort),
        full_errors=_fitted(case, full, objective, effort),
    )


def _time_planning(
    planned: PlannedRenderer, objective: LOIObjective, start: Mapping[str, Any], image: Any
) -> tuple[PlannedRenderer, float, float]:
    """Return the renderer after its pilot, and the times of the pilot and of a revision because the loss stalls."""
    cotangent = objective.value_and_grad(image)[1]
    begin = time.perf_counter()
    started = planned.start(start, cotangent)
    planned_at = time.perf_counter()
    stalled = started
    for step in range(STALL_STEPS):
        stalled = stalled.revisit(step, STALL_STEPS + 1, 1.0)
    revised_at = time.perf_counter()
    stalled.revisit(STALL_STEPS, STALL_STEPS + 1, 1.0, start, cotangent)
    return started, planned_at - begin, time.perf_counter() - revised_at


def _fitted(case: Case, renderer: Renderer, objective: LOIObjective, effort: Effort) -> tuple[float, ...]:
    free = {name: Free(value) for name, value in case.start.items()}
    initial = sum(float(np.sum((case.start[name] - case.truth[name]) ** 2)) for name in free)
    errors = []
    for seed in range(0, effort.fits * SEED_STRIDE, SEED_STRIDE):
        fitted = fit(
            renderer,
            objective,
            steps=effort.steps,
            learning_rate=case.rate,
            seed=seed,
            optimise=free,
        ).best_params
        remaining = sum(float(np.sum((fitted[name] - case.truth[name]) ** 2)) for name in free)
        errors.append(math.sqrt(remaining / initial))
    return tuple(errors)

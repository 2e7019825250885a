"""Time per step with the planned effects and with all effects of Mitsuba, in each scene."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from examples.paper.table2.problem import Column, Problem, numbers
from loi_core import LOIObjective
from loi_core.renderers.contract import Parameters, Renderer
from loi_core.support.markdown import markdown
from loi_mitsuba import PlannedRenderer

__all__ = ["savings"]

REPETITIONS: Final = 5


def savings(columns: Sequence[Column]) -> list[str]:
    """Return a table of seconds per step with all effects and with the planned effects, measured in turns."""
    rows = []
    for column in columns:
        problem = Problem.of(column, 0)
        built = problem.built
        objective = LOIObjective(problem.target)
        start = numbers(built.start)
        by_rules = PlannedRenderer(built.scene, built.parameters, spp=column.samples)
        planned = by_rules.start(start, objective.value_and_grad(by_rules.render(start))[1])
        step = partial(_step, objective, start)
        plan_seconds, full_seconds = _timed_in_turns(partial(step, planned), partial(step, planned.unabridged))
        effects = ", ".join(sorted(effect.value for effect in planned.plan.on)) or "nothing"
        ratio = full_seconds / plan_seconds
        rows.append([column.name, f"{full_seconds:.2f}", f"{plan_seconds:.2f}", f"{ratio:.1f}x", effects])
    return markdown(["", "everything on, s", "plan, s", "saved", "on"], rows)


def _step(objective: LOIObjective, params: Parameters, renderer: Renderer, seed: int) -> None:
    image, pullback = renderer.render_vjp(params, seed=seed)
    pullback(objective.value_and_grad(image)[1])


def _timed_in_turns(first: Callable[[int], None], second: Callable[[int], None]) -> tuple[float, float]:
    times: tuple[list[float], list[float]] = ([], [])
    for repetition in range(REPETITIONS + 1):
        for call_times, call in zip(times, (first, second), strict=True):
            started = time.perf_counter()
            call(repetition + 1)
            call_times.append(time.perf_counter() - started)
    return float(np.median(times[0][1:])), float(np.median(times[1][1:]))

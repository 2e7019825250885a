"""What the plan saves in each scene: one step of it, beside one with every effect that Mitsuba has."""

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

TURNS: Final = 5


def savings(columns: Sequence[Column]) -> list[str]:
    """Seconds of a step with everything on and by the plan, in turns, after a step of each; what the plan has on."""
    rows = []
    for column in columns:
        problem = Problem.of(column, 0)
        built = problem.built
        objective = LOIObjective(problem.target)
        start = numbers(built.start)
        planned = PlannedRenderer(built.scene, built.parameters, spp=column.samples)
        step = partial(_step, objective, start)
        step(planned, 0)  # the pilot
        plain, whole = _in_turns(partial(step, planned), partial(step, planned.unabridged))
        on = ", ".join(sorted(effect.value for effect in planned.plan.on)) or "nothing"
        rows.append([column.name, f"{whole:.2f}", f"{plain:.2f}", f"{whole / plain:.1f}x", on])
    return markdown(["", "everything on, s", "plan, s", "saved", "on"], rows)


def _step(objective: LOIObjective, params: Parameters, renderer: Renderer, seed: int) -> None:
    image, pullback = renderer.render_vjp(params, seed=seed)
    pullback(objective.value_and_grad(image)[1])


def _in_turns(first: Callable[[int], None], second: Callable[[int], None]) -> tuple[float, float]:
    times: tuple[list[float], list[float]] = ([], [])
    for turn in range(TURNS + 1):
        for one, call in zip(times, (first, second), strict=True):
            began = time.perf_counter()
            call(turn + 1)
            one.append(time.perf_counter() - began)
    return float(np.median(times[0][1:])), float(np.median(times[1][1:]))

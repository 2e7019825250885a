"""A plan beside everything on: what a step takes, and how far apart the gradients are."""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from loi_core.effects import Comparison, Draws, compare
from loi_core.errors import OptionError
from loi_core.objectives.base import Objective
from loi_core.renderers.contract import Renderer
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["Verification", "step_draws", "steps_in_turn", "verification"]

FEWEST: int = 3


@dataclass(frozen=True)
class Verification:
    """How a plan does beside everything on, without guiding.

    Attributes
    ----------
    seconds, full_seconds : float
        Median time of image, loss and gradient, of the plan and of everything on.
    gradient : Comparison
        Of the gradient of the loss.
    """

    seconds: float
    full_seconds: float
    gradient: Comparison

    def __str__(self) -> str:
        """Two lines for a person."""
        one = self.gradient
        silent = f"; lost in noise: {', '.join(one.silent)}" if one.silent else ""
        return (
            f"step {1e3 * self.seconds:.3g} ms, everything on {1e3 * self.full_seconds:.3g} ms: "
            f"{self.full_seconds / self.seconds:.3g} times as fast\n"
            f"gradient: cosine {one.cosine:.4f} +- {one.cosine_error:.4f}, norm ratio {one.ratio:.3f} +- "
            f"{one.ratio_error:.3f}, noise of a draw {one.noise:.2g} against {one.wanted_noise:.2g}{silent}"
        )


def verification(
    planned: Renderer,
    full: Renderer,
    objective: Objective,
    params: Mapping[str, Any],
    groups: Sequence[Sequence[str]],
    *,
    draws: int,
    seed: int,
) -> Verification:
    """Measure; see :meth:`loi_mitsuba.PlannedRenderer.verify`.

    Raises
    ------
    OptionError
        If `draws` is less than 3.
    """
    number = whole_number(draws)
    if number is None or number < FEWEST:
        msg = f"`draws` must be a whole number, {FEWEST} or more, got {shown(draws)}"
        raise OptionError(msg)
    seeds = range(seed, seed + number), range(seed + number, seed + 2 * number)
    found, wanted = step_draws((planned, full), objective, params, groups, seeds)
    return Verification(found.seconds, wanted.seconds, compare(found, wanted))


def step_draws(
    renderers: Sequence[Renderer],
    objective: Objective,
    params: Mapping[str, Any],
    groups: Sequence[Sequence[str]],
    seeds: Sequence[Sequence[int]],
) -> list[Draws]:
    """Gradients of the loss as the steps of a fit see them, each of its own image, and the median time of a step.

    The renderers are drawn as in :func:`steps_in_turn`, each with its own `seeds`.
    """
    names = [name for group in groups for name in group]
    return [
        Draws.of([{name: one[name] for name in names} for one in drawn], seconds).grouped(groups)
        for drawn, seconds in steps_in_turn(renderers, objective, params, seeds)
    ]


def steps_in_turn(
    renderers: Sequence[Renderer], objective: Objective, params: Mapping[str, Any], seeds: Sequence[Sequence[int]]
) -> list[tuple[list[Mapping[str, Any]], float]]:
    """For each renderer the gradients of a step at each of its seeds, as many for all, and the median time of a step.

    They take turns, so that whatever slows the machine down hits all alike. The first step, which may compile, is drawn
    twice and not timed.
    """
    drawn: list[list[Mapping[str, Any]]] = [[] for _ in renderers]
    times: list[list[float]] = [[] for _ in renderers]
    for turn in (0, *range(len(seeds[0]))):
        for index, renderer in enumerate(renderers):
            begin = time.perf_counter()
            image, pullback = renderer.render_vjp(dict(params), seed=seeds[index][turn])
            drawn[index].append(pullback(objective.value_and_grad(image)[1]))
            times[index].append(time.perf_counter() - begin)
    return [(kept[1:], statistics.median(spent[1:])) for kept, spent in zip(drawn, times, strict=True)]

"""Compare the steps of renderers: a plan of effects with all effects on, by its time and its gradient of the loss."""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from loi_core.effects import Comparison, Draws, compare
from loi_core.errors import OptionError
from loi_core.objectives.base import Objective
from loi_core.renderers.contract import Renderer
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["Verification", "step_draws", "steps_in_turn", "verification"]

MIN_DRAWS: Final = 3


@dataclass(frozen=True)
class Verification:
    """A plan compared with all effects on, without guiding.

    Attributes
    ----------
    seconds, full_seconds : float
        Median time of image, loss and gradient, for the plan and for all effects.
    gradient : Comparison
        The two gradients of the loss.
    """

    seconds: float
    full_seconds: float
    gradient: Comparison

    def __str__(self) -> str:
        """Summarise the comparison in two lines."""
        gradient = self.gradient
        silent = f"; lost in noise: {', '.join(gradient.insignificant)}" if gradient.insignificant else ""
        return (
            f"step {1e3 * self.seconds:.3g} ms, everything on {1e3 * self.full_seconds:.3g} ms: "
            f"{self.full_seconds / self.seconds:.3g} times as fast\n"
            f"gradient: cosine {gradient.cosine:.4f} +- {gradient.cosine_error:.4f}, "
            f"norm ratio {gradient.ratio:.3f} +- {gradient.ratio_error:.3f}, "
            f"noise of a draw {gradient.noise:.2g} against {gradient.reference_noise:.2g}{silent}"
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
    """Compare a plan with all effects on, by the gradients at `draws` seeds of each.

    Raises
    ------
    OptionError
        If `draws` is less than 3.
    """
    number = whole_number(draws)
    if number is None or number < MIN_DRAWS:
        msg = f"`draws` must be a whole number, {MIN_DRAWS} or more, got {shown(draws)}"
        raise OptionError(msg)
    seeds = range(seed, seed + number), range(seed + number, seed + 2 * number)
    plan_draws, full_draws = step_draws((planned, full), objective, params, groups, seeds)
    return Verification(plan_draws.seconds, full_draws.seconds, compare(plan_draws, full_draws))


def step_draws(
    renderers: Sequence[Renderer],
    objective: Objective,
    params: Mapping[str, Any],
    groups: Sequence[Sequence[str]],
    seeds: Sequence[Sequence[int]],
) -> list[Draws]:
    """Return for each renderer the gradients that the steps of a fit use, and the median time of a step.

    Arguments as for :func:`steps_in_turn`; gradients are grouped by `groups`.
    """
    names = [name for group in groups for name in group]
    return [
        Draws.of([{name: gradient[name] for name in names} for gradient in gradients], seconds).grouped(groups)
        for gradients, seconds in steps_in_turn(renderers, objective, params, seeds)
    ]


def steps_in_turn(
    renderers: Sequence[Renderer], objective: Objective, params: Mapping[str, Any], seeds: Sequence[Sequence[int]]
) -> list[tuple[list[Mapping[str, Any]], float]]:
    """Return for each renderer the gradient of a step at each of its seeds, and the median time of a step.

    The renderers take turns, so that a slow phase of the machine affects all alike. The first step, which may include
    the compilation of kernels, is repeated and not timed.

    Parameters
    ----------
    renderers : sequence of Renderer
    objective : Objective
    params : mapping of arrays
    seeds : sequence of sequence of int
        As many seeds for each renderer.
    """
    gradients: list[list[Mapping[str, Any]]] = [[] for _ in renderers]
    times: list[list[float]] = [[] for _ in renderers]
    for number in (0, *range(len(seeds[0]))):
        for index, renderer in enumerate(renderers):
            begin = time.perf_counter()
            image, pullback = renderer.render_vjp(dict(params), seed=seeds[index][number])
            gradients[index].append(pullback(objective.value_and_grad(image)[1]))
            times[index].append(time.perf_counter() - begin)
    return [(timed[1:], statistics.median(seconds[1:])) for timed, seconds in zip(gradients, times, strict=True)]

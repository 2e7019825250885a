"""The descent itself: from one state of a fit to the next, along the gradient."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from loi_core.errors import FitDivergedError, LoiError, RendererError
from loi_core.fitting.history import FitStep, small_parameters
from loi_core.fitting.keeping import keeping
from loi_core.fitting.optimiser import Optimiser
from loi_core.fitting.parameters import Bounds
from loi_core.fitting.race import search
from loi_core.fitting.rates import measured_rates
from loi_core.fitting.stages import FarToNear
from loi_core.fitting.state import State
from loi_core.fitting.views import Images, View, Views, as_given, mean
from loi_core.objectives import LOIObjective
from loi_core.pixels.nonfinite import count_non_finite
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, detached, is_array_api_obj, namespace, to_numpy

__all__ = ["SEARCHES", "Decay", "Descent"]

Decay: TypeAlias = Literal["cosine", "none"]

FINAL_RATE: Final = 1e-3  # where a cosine decay ends, as a factor of the learning rate
FINISH_RATE: Final = 2.0 / 3.0  # of the learning rate, for the finish: what is in its place has less far to go
SEARCHES: Final = 3
LOST: Final = 0.025  # of the value at the start: the stage that places is to leave less
BETTER: Final = 0.9  # of the value that a stage has settled at: somewhere else has to be below


@dataclass(frozen=True)
class Descent:
    """How a fit goes from step to step.

    Attributes
    ----------
    views : Views
        What is compared.
    bounds : Bounds
        Of the free parameters.
    asked : dict of float, str or None
        The rate of each free parameter, as :func:`loi_core.fit` takes them.
    optimiser : Optimiser
    decay : {"cosine", "none"}
    steps : int
        In all.
    seed : int
    """

    views: Views
    bounds: Bounds
    asked: Mapping[str, float | str | None]
    optimiser: Optimiser
    decay: Decay
    steps: int
    seed: int

    def step(self, state: State) -> tuple[State, FitStep, Parameters, Images]:
        """The state after one more step, with the step, its parameters and its image."""
        started = time.perf_counter()
        seen, stage = state.params, state.schedule.stage
        factor = self._rate(state.schedule, state.step)
        with keeping(state, "telling the renderer how far the fit has come"):
            self.views.at_step(state.step, self.steps, state.log[state.step - 1].value if state.step else None)
        images, values, gradient = self._evaluate(state)
        latest = {**state.latest, **values}
        value = mean(latest)
        state = state.seen(value, images, stage, partial=len(latest) < len(self.views.each))
        # In float64, since squares leave the range of narrower dtypes while the gradient is well within it.
        squares = (np.square(to_numpy(one), dtype=np.float64) for one in gradient.values())
        norm = math.sqrt(sum(float(np.sum(one)) for one in squares))
        now = {name: factor * rate for name, rate in state.rates.items()}
        with np.errstate(all="ignore"), keeping(state, "the optimiser"):  # what overflows is told at the next step
            moved, memory = self.optimiser.step(seen, gradient, state.memory, now)
            free = {name: _like("value", "optimiser", name, moved, seen[name]) for name in self.bounds.lower}
        moved = {**seen, **free}
        moved = self._legal(moved, state)
        seconds = time.perf_counter() - started
        entry = FitStep(state.step, value, norm, factor, seconds, stage, small_parameters(seen, self.bounds.lower))
        after = state.stepped(entry, moved, memory, latest)
        if after.schedule.lost:
            after = self._searched(after)
        elif stage < self.views.placing == after.schedule.stage:
            after = replace(after, rates=self._higher_rates(after, "measuring rates anew"))
        elif self.views.finish and stage == self.views.placing < after.schedule.stage:
            after = self._finishing(after)
        return after, entry, seen, as_given(images)

    def finished(self, state: State, start: Parameters) -> State:
        """The state once the last parameters are measured, and, where a step renders some views, the best as well.

        The start is the best where nothing that came after it is better by the last loss, which it never saw.
        """
        stage = state.schedule.stage
        with keeping(state, "measuring the last step"):
            try:
                images = self.views.render(state.params, self.seed + state.step)
                value = mean(self.views.values(images, stage))
                if state.best is not None and not self.views.all_at_once:
                    best = self.views.render(state.best.params, self.seed + state.best.step)
                    known = mean(self.views.values(best, state.best.stage))
                    state = replace(state, best=replace(state.best, value=known, images=best, partial=False))
            except LoiError:
                return state  # refused for what they are: the best iterate stands
            if math.isfinite(value):
                state = state.seen(value, images, stage)
            if stage > 0:
                first = self.views.render(start, self.seed)
                before = replace(state, params=start, step=0).seen(mean(self.views.values(first, stage)), first, stage)
                state = replace(state, best=before.best)
        return state

    def enough(self, state: State) -> float:
        """What the objective that places may leave of its value here without being lost: a little, and noise."""
        with keeping(state, "measuring the start"):
            images, placing = self.views.render(state.params, self.seed), self.views.placing
            value = mean(self.views.values(images, placing))
            noise = {}
            for name, image in self.views.render(state.params, self.seed + 1).items():
                objective = self.views.each[name].objectives[placing]
                if isinstance(objective, LOIObjective) and not np.array_equal(to_numpy(image), to_numpy(images[name])):
                    noise[name] = float(detached(objective.with_reference(image).value(images[name])))
                else:
                    noise[name] = 0.0
            return LOST * value + mean(noise)

    def _rate(self, schedule: FarToNear, step: int) -> float:
        if self.decay == "none" or self.steps == 1:
            return 1.0
        passed = step / (self.steps - 1) if schedule.stages == 1 else schedule.passed
        return FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + math.cos(math.pi * passed))

    def _searched(self, state: State) -> State:
        """The state somewhere else within the bounds, if the loss of the stage is less there."""
        schedule = state.schedule.copy()
        with keeping(state, "searching for a start"):
            turn, near, stage = SEARCHES - schedule.searches, schedule.stage > 0, schedule.stage
            seed = self.seed + state.step
            found = search(
                lambda place: self.views.value(place, stage, seed), state.params, self.bounds, turn, near=near
            )
        if found is None or not found[0] < BETTER * schedule.level:
            schedule.go_on()
            best = state.params if near or state.best is None else state.best.params
            return replace(state, params=best, schedule=schedule, latest={})
        schedule.begin_again()
        memory = self.optimiser.start({name: found[1][name] for name in self.bounds.lower}, state.memory)
        return replace(state, params=found[1], memory=memory, schedule=schedule, latest={})

    def _finishing(self, state: State) -> State:
        """The state as the finish begins: a descent of its own, which remembers nothing.

        Gradients of pixels have another size, which Adam would take a thousand steps to learn.
        """
        memory = self.optimiser.start({name: state.params[name] for name in self.bounds.lower})
        rates = self._higher_rates(state, "measuring rates for the finish")
        return replace(state, memory=memory, rates={name: FINISH_RATE * rate for name, rate in rates.items()})

    def _higher_rates(self, state: State, doing: str) -> dict[str, float]:
        """Rates as measured here, where they are higher than before.

        What moves the image by a pixel here may have moved it far less at the start, as a distance does, or a
        logarithm. The higher rate counts: a decay makes up for one that is too high, and nothing for one that is too
        low.
        """
        with keeping(state, doing):
            rates = measured_rates(
                self.views, state.params, self.bounds, self.asked, self.steps, self.seed + state.step
            )
        return {name: max(rate, state.rates[name]) for name, rate in rates.items()}

    def _evaluate(self, state: State) -> tuple[dict[str, Array], dict[str, float], Parameters]:
        """Images and values of the views of a step, and the gradient of their mean by the free parameters."""
        names = self.views.turn(state.step, self.seed)
        images: dict[str, Array] = {}
        values: dict[str, float] = {}
        total: Parameters = {}
        for name in names:
            view = self.views.each[name]
            where = f" of view {name!r}" if name else ""
            images[name], values[name], gradient = self._evaluate_view(view, state, where)
            for key, slope in gradient.items():
                total[key] = slope if key not in total else total[key] + slope
        if len(names) > 1:
            total = {key: slope / len(names) for key, slope in total.items()}
        for key in self.bounds.lower:
            if key not in total:  # none of these views has it
                total[key] = namespace(state.params[key]).zeros_like(state.params[key])
        return images, values, total

    def _evaluate_view(self, view: View, state: State, where: str) -> tuple[Array, float, Parameters]:
        """Image, value and gradient by the free parameters, each known to be finite and of the right shape."""
        with keeping(state, f"rendering{where}"):
            image, pullback = view.render_vjp(state.params, seed=self.seed + state.step)
        with keeping(state, f"the objective{where}"):
            objective = view.objectives[state.schedule.stage]
            value, cotangent = objective.value_and_grad(image)
            number = float(detached(value))
        if not math.isfinite(number):
            msg = f"step {state.step}: the objective is {number}; the best parameters so far are in `result`"
            raise FitDivergedError(msg, state.result())
        with keeping(state, f"the pullback{where}"):
            pulled = pullback(objective.value, cotangent)
            free = [name for name in self.bounds.lower if name in view.names]
            gradient = {name: _slope(name, pulled, state.params[name]) for name in free}
        for name, slope in gradient.items():
            bad = count_non_finite(slope)
            if bad:
                msg = f"step {state.step}: the gradient of {name!r} has {bad} non-finite values; see `result`"
                raise FitDivergedError(msg, state.result())
        return image, number, gradient

    def _legal(self, moved: Parameters, state: State) -> Parameters:
        """The free parameters within their bounds, after the renderer has made them legal; the others as they were.

        A renderer knows neither bounds nor what is free: it may, say, part two disks of which one is to stay.
        """
        moved = self.bounds.clip(moved)
        with keeping(state, "the projection"):
            legal = self.views.project(moved)
            if legal is None:
                return moved
            free = {name: _like("value", "projection", name, legal, moved[name]) for name in self.bounds.lower}
        return self.bounds.clip(moved | free)


def _slope(name: str, pulled: object, parameter: Array) -> Array:
    """The gradient by parameter `name` out of what a pullback gave, of the parameter's dtype."""
    given: Any = pulled[name] if isinstance(pulled, Mapping) and name in pulled else None
    # A cast would drop the imaginary part, and what has been rounded to integers is often 0.
    if is_array_api_obj(given) and namespace(given).isdtype(given.dtype, ("bool", "integral", "complex floating")):
        msg = f"the gradient of {name!r} must be floating-point, got {given.dtype}"
        raise RendererError(msg)
    return _like("cotangent", "pullback", name, pulled, parameter)


def _like(what: str, source: str, name: str, given: object, parameter: Array) -> Array:
    """Parameter `name` out of what a renderer gave, of the parameter's dtype."""
    if not isinstance(given, Mapping) or name not in given:
        msg = f"the {source} gave no {what} for {name!r}"
        raise RendererError(msg)
    array = given[name]
    if not is_array_api_obj(array) or tuple(array.shape) != tuple(parameter.shape):
        got = f"shape {tuple(array.shape)}" if is_array_api_obj(array) else type(array).__name__
        msg = f"the {what} of {name!r} must be an array of shape {tuple(parameter.shape)}, got {got}"
        raise RendererError(msg)
    return namespace(parameter).astype(detached(array), parameter.dtype)

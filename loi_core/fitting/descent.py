"""The descent of a fit: from one state to the next, along the gradient."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from loi_core.errors import FitDivergedError, LoiError, RendererError
from loi_core.fitting.history import FitStep, small_parameters
from loi_core.fitting.optimiser import Memory, Optimiser
from loi_core.fitting.parameters import Bounds
from loi_core.fitting.partial_result import with_partial_result
from loi_core.fitting.rates import measured_rates, racing_factors
from loi_core.fitting.schedule import MAIN_STUCK_FRACTION, Schedule
from loi_core.fitting.starts import RACE_ROUNDS, ROUND_STEPS, RaceSize, Reached, race, search
from loi_core.fitting.state import Evaluation, State
from loi_core.fitting.views import View, mean
from loi_core.objectives import LOIObjective
from loi_core.pixels.nonfinite import count_non_finite
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, detached, from_numpy, is_array_api_obj, namespace, to_numpy

__all__ = ["MAX_RESTARTS", "Decay", "Descent"]

Decay: TypeAlias = Literal["cosine", "none"]

FINAL_RATE: Final = 1e-3  # end of the cosine decay, as a fraction of the learning rate
FINISH_RATE: Final = 0.5  # fraction of the learning rate: a comparison of pixels has less far to go
SHORTENING: Final = 0.5  # of the steps of a racer after a step that has gained nothing
RACED_RATE: Final = 8.0  # highest rate after a race, as a multiple of the last rate of its winner
MAX_RESTARTS: Final = 3
MIN_IMPROVEMENT: Final = 0.9  # a restart must start below this fraction of the settled value


@dataclass(frozen=True)
class Descent:
    """The options of a fit, and its pure steps on a :class:`State`.

    Attributes
    ----------
    bounds : Bounds
        Of the free parameters.
    requested_rates : dict of float, str or None
        The rate of each free parameter, as :func:`loi_core.fit` takes them.
    optimiser : Optimiser
    decay : {"cosine", "none"}
    steps : int
        Number of steps of the whole fit.
    seed : int
    """

    bounds: Bounds
    requested_rates: Mapping[str, float | str | None]
    optimiser: Optimiser
    decay: Decay
    steps: int
    seed: int

    def step(self, state: State) -> tuple[State, Evaluation]:
        """Return the state after one more step, and the evaluation that the step started from."""
        started = time.perf_counter()
        with with_partial_result(state, "revisiting the renderer"):
            state = state.revisited(self.steps)
        stage, rate = state.schedule.stage, self._rate(state)
        evaluation = self.evaluate(state)
        partial = len(evaluation.latest) < len(state.views.by_name)
        state = state.evaluated(evaluation.value, evaluation.images, stage, partial=partial)
        params, memory = self.update(state, evaluation.gradient, rate)
        entry = FitStep(
            state.step,
            evaluation.value,
            evaluation.gradient_norm,
            rate,
            time.perf_counter() - started,
            stage,
            small_parameters(evaluation.params, self.bounds.lower),
        )
        return self.advance(state.stepped(entry, params, memory, evaluation), stage), evaluation

    def evaluate(self, state: State) -> Evaluation:
        """Return value and gradient at the parameters of a state."""
        names = state.views.names_at(state.step, self.seed)
        images: dict[str, Array] = {}
        cotangents: dict[str, Array] = {}
        values: dict[str, float] = {}
        total: Parameters = {}
        for name in names:
            where = f" of view {name!r}" if name else ""
            view = state.views.by_name[name]
            images[name], cotangents[name], values[name], gradient = self._evaluate_view(view, state, where)
            for key, slope in gradient.items():
                total[key] = slope if key not in total else total[key] + slope
        if len(names) > 1:
            total = {key: slope / len(names) for key, slope in total.items()}
        for key in self.bounds.lower:
            if key not in total:  # none of these views has the parameter
                total[key] = namespace(state.params[key]).zeros_like(state.params[key])
        latest = {**state.latest, **values}
        return Evaluation(state.params, images, cotangents, latest, total, self.seed + state.step)

    def update(self, state: State, gradient: Parameters, rate: float) -> tuple[Parameters, Memory]:
        """Return the parameters after a step of the optimiser, legal and within their bounds, and its memory."""
        rates = {name: rate * own_rate for name, own_rate in state.rates.items()}
        with np.errstate(all="ignore"), with_partial_result(state, "the optimiser"):  # the next step reports overflows
            moved, memory = self.optimiser.step(state.params, gradient, state.memory, rates)
            free = {name: _like("value", "optimiser", name, moved, state.params[name]) for name in self.bounds.lower}
        return self._legal({**state.params, **free}, state), memory

    def advance(self, state: State, stage: int) -> State:
        """Return the state after the changes of stage that a step of `stage` causes: a restart, or other rates."""
        main_stage, was_stuck = state.views.main_stage, state.schedule.stuck
        if was_stuck:
            state = self._restarted(state)
        schedule = state.schedule
        if stage < schedule.stage and not was_stuck:
            state = self._at_best(state, stage)
        if stage < main_stage == schedule.stage and not was_stuck:
            return replace(state, rates=self._higher_rates(state, "measuring rates anew"))
        if state.views.polishes and stage == main_stage < schedule.stage:
            # A descent of its own: gradients of pixels have another size, which Adam would take 1000 steps to learn.
            memory = self._memory_at(state.params)
            rates = self._higher_rates(state, "measuring rates for the last stage")
            return replace(state, memory=memory, rates={name: FINISH_RATE * rate for name, rate in rates.items()})
        return state

    def finished(self, state: State, start: Parameters) -> State:
        """Return the state once the last parameters, and the best if steps render only some views, are evaluated.

        All are compared by the last loss, which a short fit may never have used.
        """
        stage = state.views.stages - 1
        with with_partial_result(state, "measuring the last step"):
            try:
                images = state.views.render(state.params, self.seed + state.step)
                value = mean(state.views.values(images, stage))
                if state.best is not None and not (state.views.all_at_once and state.best.stage == stage):
                    best_images = state.views.render(state.best.params, self.seed + state.best.step)
                    best_value = mean(state.views.values(best_images, stage))
                    best = replace(state.best, value=best_value, images=best_images, stage=stage, partial=False)
                    state = replace(state, best=best)
            except LoiError:
                return state  # the renderer refuses the last parameters; the best iterate remains
            if math.isfinite(value):
                state = state.evaluated(value, images, stage)
            if stage > 0:
                first = state.views.render(start, self.seed)
                at_start = replace(state, params=start, step=0)
                at_start = at_start.evaluated(mean(state.views.values(first, stage)), first, stage)
                state = replace(state, best=at_start.best)
        return state

    def noise_floor(self, state: State) -> float:
        """Return the main loss at or below which the main stage is not stuck: a fraction of its value, and noise."""
        with with_partial_result(state, "measuring the start"):
            images, stage = state.views.render(state.params, self.seed), state.views.main_stage
            value = mean(state.views.values(images, stage))
            noise = {}
            for name, image in state.views.render(state.params, self.seed + 1).items():
                objective = state.views.by_name[name].objectives[stage]
                if isinstance(objective, LOIObjective) and not np.array_equal(to_numpy(image), to_numpy(images[name])):
                    noise[name] = float(detached(objective.with_reference(image).value(images[name])))
                else:
                    noise[name] = 0.0
            return MAIN_STUCK_FRACTION * value + mean(noise)

    def _rate(self, state: State) -> float:
        if self.decay == "none" or self.steps == 1:
            return 1.0
        schedule = state.schedule
        passed = schedule.passed if state.views.polishes else schedule.main_passed
        passed = state.step / (self.steps - 1) if schedule.stages == 1 else passed
        return FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + math.cos(math.pi * passed))

    def _restarted(self, state: State) -> State:
        """Return the state at the best of some other points within the bounds, if its loss is less."""
        schedule = state.schedule
        with with_partial_result(state, "searching for a start"):
            attempt, stage = MAX_RESTARTS - schedule.restarts, schedule.stage
            seed, local = self.seed + state.step, stage > 0
            draws: list[tuple[float, Parameters]] = []
            raced = self._race(state, draws) if attempt == 0 else None
            if raced is not None:
                return self._after_race(state, raced)
            if attempt == 0:
                schedule = replace(schedule, restarts=1)  # the race has rendered as often as the other restarts
            best = None if local else min(draws, key=lambda entry: entry[0], default=None)
            if best is None:
                best = search(
                    lambda point: state.views.value(point, stage, seed), state.params, self.bounds, attempt, local=local
                )
        if best is None or not best[0] < MIN_IMPROVEMENT * schedule.level:
            params = state.params if local or state.best is None else state.best.params
            return replace(state, params=params, schedule=schedule.proceed(), latest={})
        params = best[1]
        memory = self._memory_at(params, state.memory)
        return replace(state, params=params, memory=memory, schedule=schedule.restart(), latest={})

    def _after_race(self, state: State, raced: Reached) -> State:
        """Return the state at the start of the main stage from the winner of a race."""
        memory, schedule = self._memory_at(raced.params), state.schedule.in_main_stage()
        state = replace(state, params=raced.params, memory=memory, schedule=schedule, latest={})
        measured = self._rates_at(state, "measuring rates anew")
        limits = {name: RACED_RATE * rate for name, rate in raced.rates.items()}
        return replace(state, rates={name: min(rate, limits.get(name, rate)) for name, rate in measured.items()})

    def _at_best(self, state: State, stage: int) -> State:
        """Return the state at the best parameters of a stage that has ended, since steps at a full rate oscillate."""
        best = state.best
        if best is None or best.stage != stage or best.partial:
            return state
        return replace(state, params=best.params, memory=self._memory_at(best.params, state.memory))

    def _race(self, state: State, draws: list[tuple[float, Parameters]]) -> Reached | None:
        """Return parameters where some steps of the main stage from other points have led, if they are far better.

        The loss of this stage at the points, and the points, are appended to `draws`.
        """
        main, stage, seed = state.views.main_stage, state.schedule.stage, self.seed + state.step
        steps = RACE_ROUNDS * ROUND_STEPS
        short, views = replace(self, decay="none", steps=steps), state.views.at_stage(main)
        factors = racing_factors(self.requested_rates, self.steps)
        high_rates = {name: factors[name] * rate for name, rate in state.rates.items()}

        def descend(start: Parameters, *, fast: bool) -> Iterator[Reached]:
            rates = high_rates if fast else state.rates
            racer = State(start, self._memory_at(start), views, rates=rates, schedule=Schedule(1, steps))
            lowest: Evaluation | None = None
            while racer.step < steps:
                racer, evaluation = short.step(racer)
                if lowest is None or evaluation.value < lowest.value:
                    lowest = evaluation
                else:
                    racer = short.shortened(racer, lowest)
                if racer.step % ROUND_STEPS == 0:
                    yield Reached(lowest.value, lowest.params, racer.rates)

        def evaluate(point: Parameters) -> float:
            images = state.views.render(point, seed)
            value = mean(state.views.values(images, stage))
            if math.isfinite(value):
                draws.append((value, point))
            return mean(state.views.values(images, main))

        start = {name: from_numpy(value, state.params[name]) for name, value in state.log[0].params.items()}
        return race(evaluate, descend, state.params, self.bounds, RaceSize.of(self.steps), [state.params | start])

    def shortened(self, state: State, lowest: Evaluation) -> State:
        """Return the state after a step of a shorter length from the evaluation with the lowest value."""
        rates = {name: SHORTENING * rate for name, rate in state.rates.items()}
        back = replace(state, params=lowest.params, memory=self._memory_at(lowest.params), rates=rates)
        params, memory = self.update(back, lowest.gradient, 1.0)
        return replace(back, params=params, memory=memory)

    def _memory_at(self, params: Parameters, previous: Memory | None = None) -> Memory:
        """Return the optimiser's memory for a descent that begins at parameters."""
        return self.optimiser.start({name: params[name] for name in self.bounds.lower}, previous)

    def _higher_rates(self, state: State, action: str) -> dict[str, float]:
        """Return the rates measured here where they exceed the earlier ones.

        A parameter that moves the image by a pixel here may have moved it far less at the start, such as a distance or
        a logarithm. A decay makes up for a rate that is too high, and nothing for one that is too low.
        """
        return {name: max(rate, state.rates[name]) for name, rate in self._rates_at(state, action).items()}

    def _rates_at(self, state: State, action: str) -> dict[str, float]:
        with with_partial_result(state, action):
            return measured_rates(
                state.views, state.params, self.bounds, self.requested_rates, self.steps, self.seed + state.step
            )

    def _evaluate_view(self, view: View, state: State, where: str) -> tuple[Array, Array, float, Parameters]:
        """Return image, cotangent, value and gradient by the free parameters, checked for shape and finiteness."""
        with with_partial_result(state, f"rendering{where}"):
            image, pullback = view.render_vjp(state.params, seed=self.seed + state.step)
        with with_partial_result(state, f"the objective{where}"):
            objective = view.objectives[state.schedule.stage]
            value, cotangent = objective.value_and_grad(image)
            number = float(detached(value))
        if not math.isfinite(number):
            msg = f"step {state.step}: the objective is {number}; the best parameters so far are in `result`"
            raise FitDivergedError(msg, state.result())
        with with_partial_result(state, f"the pullback{where}"):
            pulled = pullback(objective.value, cotangent)
            free = [name for name in self.bounds.lower if name in view.names]
            gradient = {name: _slope(name, pulled, state.params[name]) for name in free}
        for name, slope in gradient.items():
            count = count_non_finite(slope)
            if count:
                msg = f"step {state.step}: the gradient of {name!r} has {count} non-finite values; see `result`"
                raise FitDivergedError(msg, state.result())
        return image, cotangent, number, gradient

    def _legal(self, moved: Parameters, state: State) -> Parameters:
        """Return the free parameters projected by the renderer and within their bounds; the others as they were.

        A renderer knows neither the bounds nor the free parameters: to separate two disks it may move a fixed one.
        """
        moved = self.bounds.clip(moved)
        with with_partial_result(state, "the projection"):
            legal = state.views.project(moved)
            if legal is None:
                return moved
            free = {name: _like("value", "projection", name, legal, moved[name]) for name in self.bounds.lower}
        return self.bounds.clip(moved | free)


def _slope(name: str, pulled: object, parameter: Array) -> Array:
    """Return the gradient of parameter `name` from the result of a pullback, in the parameter's dtype."""
    slope: Any = pulled[name] if isinstance(pulled, Mapping) and name in pulled else None
    # A cast would drop the imaginary part, and a gradient rounded to integers is often 0.
    if is_array_api_obj(slope) and namespace(slope).isdtype(slope.dtype, ("bool", "integral", "complex floating")):
        msg = f"the gradient of {name!r} must be floating-point, got {slope.dtype}"
        raise RendererError(msg)
    return _like("cotangent", "pullback", name, pulled, parameter)


def _like(noun: str, source: str, name: str, values: object, parameter: Array) -> Array:
    """Return parameter `name` from the dict that a renderer or optimiser returned, in the parameter's dtype."""
    if not isinstance(values, Mapping) or name not in values:
        msg = f"the {source} gave no {noun} for {name!r}"
        raise RendererError(msg)
    array = values[name]
    if not is_array_api_obj(array) or tuple(array.shape) != tuple(parameter.shape):
        got = f"shape {tuple(array.shape)}" if is_array_api_obj(array) else type(array).__name__
        msg = f"the {noun} of {name!r} must be an array of shape {tuple(parameter.shape)}, got {got}"
        raise RendererError(msg)
    return namespace(parameter).astype(detached(array), parameter.dtype)

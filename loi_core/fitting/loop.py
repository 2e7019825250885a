"""Fitting the parameters of any renderer to an image, with nothing but the renderer contract."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, TypeAlias, get_args

import numpy as np

from loi_core.errors import (
    FitDivergedError,
    FitError,
    LoiError,
    NonFiniteImageError,
    OptionError,
    RendererError,
)
from loi_core.fitting.adam import Moments, adam_step
from loi_core.fitting.checkpoint import load_checkpoint, save_checkpoint
from loi_core.fitting.diagnosis import Findings, diagnose
from loi_core.fitting.parameters import (
    Bounds,
    Free,
    bounds_of,
    check_rate,
    free_parameters,
    own_parameters,
    pixels_of,
    starting_parameters,
)
from loi_core.fitting.race import can_search, race, search
from loi_core.fitting.resuming import few_numbers, resumed, settings_of, snapshot
from loi_core.fitting.stages import FarToNear, Stages, objectives_of
from loi_core.fitting.state import FitResult, FitStep, State
from loi_core.fitting.units import measure_units
from loi_core.fitting.verdict import Diagnosis
from loi_core.io.files import check_writable, remove_temporaries
from loi_core.objectives import ImageObjective, LOIObjective, Objective
from loi_core.pixels.nonfinite import count_non_finite
from loi_core.renderers.contract import AbridgedRenderer, Parameters, ProjectingRenderer, Renderer
from loi_core.support.arrays import Array, detached, from_numpy, is_array_api_obj, namespace, to_numpy
from loi_core.support.guards import is_ctrl_c
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import described, shown

__all__ = [
    "Callback",
    "Decay",
    "FitInterruptedError",
    "FitResult",
    "FitStep",
    "Free",
    "check_fit_options",
    "fit",
    "starting_parameters",
]

Decay = Literal["cosine", "none"]

FINAL_RATE: Final = 1e-3  # where a cosine decay ends, as a factor of the learning rate
CHECKPOINT_STEPS: Final = 25
MOST_STEPS: Final = 2**31 - 1
MOST_STARTS: Final = 4096
SEARCHES: Final = 3
BETTER: Final = 0.9  # of the value that a stage has settled at: somewhere else has to be below
RENDERS: Final = 8  # whose mean tells what is left from what is noise
CROSSINGS: Final = 2.0  # of the longer side by all steps, if none decayed: once with the decay
LEAST_PIXELS: Final = 0.25  # a step
MOST_PIXELS: Final = 1.0 / 16.0  # of the longer side, a step
MOST_SEED: Final = 2**63 - 1  # of 64 bits with a sign, which is what TOML, JSON and a checkpoint hold anywhere


Callback: TypeAlias = Callable[[FitStep, Parameters, Array], bool | None]
"""Called after every step with the step, its parameters and its image; returning True ends the fit."""


class FitInterruptedError(KeyboardInterrupt):
    """Ctrl-C during a fit; ``result`` holds what it had reached.

    Its message says so if the checkpoint could not be written. Derived from ``KeyboardInterrupt`` alone, so that
    nothing which catches ordinary errors swallows it.
    """

    def __init__(self, result: FitResult | None, lost: str = "") -> None:
        super().__init__(f"interrupted; {lost}" if lost else "interrupted")
        self.result = result


def fit(
    renderer: Renderer,
    objective: Objective,
    *,
    steps: int = 200,
    learning_rate: float | str | None = None,
    seed: int = 0,
    optimise: Mapping[str, Free] | Iterable[str] | None = None,
    decay: Decay = "cosine",
    stages: Stages = "auto",
    starts: int = 1,
    checkpoint: Path | str | None = None,
    resume: bool = False,
    callback: Callback | None = None,
) -> FitResult:
    """Fit the parameters of a renderer so that its image minimises an objective.

    Adam with a decaying rate, from scales that reach far to those that place the last digits; bounds are kept by
    clipping, the best iterate is remembered, and the result says what came of it.

    Parameters
    ----------
    renderer : Renderer
        Anything that keeps the contract. If it has ``project``, that is called after every step, for
        the parameters that may move; their bounds hold all the same.
    objective : Objective
        Anything with ``value`` and ``value_and_grad``.
    steps : int
        Number of steps, 1 or more.
    learning_rate : float or str, optional
        About how far a step moves. A number is in each parameter's own unit; a text such as "1.5 px" is in pixels that
        the image moves, for which every parameter's unit is measured from the renderer first. By default as many
        pixels as cross the image once, over all steps. A rate of `Free` comes before it.
    seed : int
        Step k renders with seed ``seed + k``.
    optimise : dict of Free, or names, optional
        What moves, and how; every parameter by default.
    decay : {"cosine", "none"}
        "cosine" takes the rate down to a thousandth of `learning_rate` over the steps of the last stage.
    stages : "auto", None, or a sequence of ScaleSpace or Objective
        What comes before `objective`, from far to near; each until its loss no longer falls. "auto" puts
        :meth:`ScaleSpace.far_to_near` there if the objective is a :class:`LOIObjective` with default scales, and
        nothing otherwise; if the first stage ends with most of its loss left, and the parameters are few and bounded,
        it also looks for a better start within the bounds, up to three times.
    starts : int
        From how many places to start: the parameters' own, and others within their bounds, which then all have to be
        finite. They race by successive halving; a race takes some `starts` thirds of the time of a fit.
    checkpoint : path, optional
        File (.npz) in which the state is kept every 25 steps and at the end, written whole or not at all.
    resume : bool
        Whether to go on from `checkpoint` if it exists. The fit then ends as if it had never stopped; a
        checkpoint of other settings, or of another objective or scene, is refused.
    callback : callable, optional
        ``callback(step, params, image)`` after every step; returning True ends the fit.

    Returns
    -------
    FitResult

    Raises
    ------
    OptionError, ParameterError
        If an argument is not allowed.
    FitError
        If the loss or gradient stops being finite, or the renderer fails or the checkpoint cannot be written after
        the first step; its ``result`` holds the best parameters so far.
    RendererError
        If the renderer breaks the contract on the first step.
    FitInterruptedError
        On Ctrl-C; likewise.
    """
    check_fit_options(steps, learning_rate, seed, decay, starts)
    # NumPy's own numbers would wrap around in a sum, or widen the dtype of what they are multiplied with.
    steps, seed = int(steps), int(seed)
    path = _checkpoint_path(checkpoint)
    if path is not None:
        remove_temporaries(path)
    free = free_parameters(optimise, own_parameters(renderer))
    params = starting_parameters(renderer, free)
    bounds = bounds_of(params, free)
    objectives = objectives_of(objective, stages)
    asked = {name: learning_rate if one.learning_rate is None else one.learning_rate for name, one in free.items()}
    named = {name: rate if isinstance(rate, str) else real_number(rate) for name, rate in _named(asked).items()}
    settings = settings_of(steps, seed, decay, named, bounds, len(objectives))
    # The state is only ever replaced whole, so that Ctrl-C falls before a step or after it, never within.
    moments, rates = Moments.zeros({name: params[name] for name in free}), dict.fromkeys(free, 1.0)
    state = State(params, moments, rates=rates, schedule=FarToNear(len(objectives), steps))
    agreeing: int | None = None
    try:
        saved = load_checkpoint(path, settings) if path is not None and resume and path.exists() else None
        if saved is not None:
            state = resumed(saved, state, renderer, objectives, seed)
        else:
            if starts > 1:
                winner, agreeing = race(renderer, objectives, params, bounds, asked, starts, steps, seed, fit)
                state = replace(state, params=winner)
            state = replace(state, rates=_rates(renderer, state.params, bounds, asked, steps, seed))
            if stages == "auto" and len(objectives) > 1 and can_search(bounds):
                first = _first_value(renderer, objective, state, seed)
                schedule = FarToNear(len(objectives), steps, searches=SEARCHES, start=first)
                state = replace(state, schedule=schedule)
        while state.step < steps:
            started = time.perf_counter()
            seen, stage = state.params, state.schedule.stage
            factor = _rate(decay, state.schedule, state.step, steps)
            image, value, gradient = _evaluate(renderer, objectives[stage], state, free, seed + state.step)
            state = state.seen(value, image, stage)
            # In float64, since squares leave the range of narrower dtypes while the gradient is well within it.
            squares = (np.square(to_numpy(one), dtype=np.float64) for one in gradient.values())
            norm = math.sqrt(sum(float(np.sum(one)) for one in squares))
            with np.errstate(all="ignore"):  # what overflows is not finite, and is told as that at the next step
                now = {name: factor * rate for name, rate in state.rates.items()}
                moved, moments = adam_step(seen, gradient, state.moments, now)
            moved = _legal(renderer, bounds, moved, state)
            seconds = time.perf_counter() - started
            entry = FitStep(state.step, value, norm, factor, seconds, stage, few_numbers(seen, free))
            after = state.stepped(entry, moved, moments)
            state = _searched(renderer, objectives, after, bounds, seed) if after.schedule.lost else after
            if state.step % CHECKPOINT_STEPS == 0:
                _save(path, state, settings)
            if callback is not None and callback(entry, seen, image):
                break
        state = _last_seen(renderer, objectives[state.schedule.stage], state, seed)
        _save(path, state, settings)
        result = state.result()
        if result is None:  # pragma: no cover - steps >= 1 has seen at least one value
            msg = "the fit saw no value"
            raise FitError(msg)
        return replace(
            result, diagnosis=_diagnosis(renderer, objective, params, bounds, result, seed), agreeing=agreeing
        )
    except KeyboardInterrupt:
        lost = ""
        try:
            _save(path, state, settings)
        except FitError as error:
            lost = str(error)
        raise FitInterruptedError(state.result(), lost) from None


def _named(asked: Mapping[str, object]) -> dict[str, object]:
    """Rates as they were asked for; those that are left to the library by name."""
    return {name: "auto" if rate is None else rate for name, rate in asked.items()}


def _rates(
    renderer: Renderer, params: Parameters, bounds: Bounds, asked: Mapping[str, object], steps: int, seed: int
) -> dict[str, float]:
    """How far a step moves each parameter, in its own unit."""
    in_pixels = [name for name, rate in asked.items() if rate is None or isinstance(rate, str)]
    units: dict[str, float] = {}
    if in_pixels:
        units, side = measure_units(renderer, params, bounds, in_pixels, seed=seed)
        least, most = LEAST_PIXELS, side * MOST_PIXELS
        usual = min(max(CROSSINGS * side / steps, least), max(most, least))
    rates = {}
    for name, rate in asked.items():
        if name in units:
            pixels = usual if rate is None else pixels_of(rate)
            # What leaves no trace has no unit, and no gradient either: any rate will do.
            rates[name] = pixels * units[name] if math.isfinite(units[name]) else 1.0
        else:
            rates[name] = real_number(rate)
    return rates


def _diagnosis(
    renderer: Renderer, objective: Objective, start: Parameters, bounds: Bounds, result: FitResult, seed: int
) -> Diagnosis | None:
    """What came of a fit; None if the renderer or the objective refuses to say."""
    try:
        if isinstance(renderer, AbridgedRenderer):
            renderer = renderer.unabridged
        image = detached(renderer.render(start, seed=seed))
        first = float(detached(objective.value(image)))
        shown, noise = detached(renderer.render(result.best_params, seed=seed + result.best_step)), 0.0
        again = [detached(renderer.render(result.best_params, seed=seed + result.best_step + 1))]
        if not np.array_equal(to_numpy(again[0]), to_numpy(shown)):
            more = range(2, RENDERS + 1)
            again += [detached(renderer.render(result.best_params, seed=seed + result.best_step + k)) for k in more]
            mean = np.mean([np.asarray(to_numpy(one), dtype=np.float64) for one in again], axis=0)
            if isinstance(objective, LOIObjective):
                noise = float(detached(objective.with_reference(mean).value(to_numpy(shown))))
            shown = from_numpy(mean, shown)
        end = float(detached(objective.value(shown)))
        visible: dict[str, bool] = {}
        if all(one.gradient_norm == 0.0 for one in result.history):
            units, _ = measure_units(renderer, start, bounds, bounds.lower, seed=seed)
            visible = {name: math.isfinite(unit) for name, unit in units.items()}
    except Exception:  # noqa: BLE001 - the fit is done, whatever a renderer does beyond it
        return None
    reference = objective.reference if isinstance(objective, ImageObjective) else None
    return diagnose(
        Findings(
            first,
            end,
            noise,
            result.history,
            result.best_params,
            bounds,
            visible,
            to_numpy(image),
            None if reference is None else to_numpy(reference),
        )
    )


def _save(path: Path | None, state: State, settings: Mapping[str, str]) -> None:
    if path is not None and state.best is not None:
        with _keeping(state, "writing the checkpoint"):
            save_checkpoint(path, snapshot(state, state.best, settings))


def _first_value(renderer: Renderer, objective: Objective, state: State, seed: int) -> float:
    with _keeping(state, "measuring the start"):
        return float(detached(objective.value(detached(renderer.render(state.params, seed=seed)))))


def _searched(renderer: Renderer, objectives: Sequence[Objective], state: State, bounds: Bounds, seed: int) -> State:
    """The state somewhere else within the bounds, if the loss of the stage is less there."""
    schedule = state.schedule.copy()
    with _keeping(state, "searching for a start"):
        turn, near = SEARCHES - schedule.searches, schedule.stage > 0
        objective = objectives[schedule.stage]
        found = search(renderer, objective, state.params, bounds, turn, seed + state.step, near=near)
    if found is None or not found[0] < BETTER * schedule.level:
        schedule.go_on()
        best = state.params if near or state.best is None else state.best.params
        return replace(state, params=best, schedule=schedule)
    schedule.begin_again()
    still = {name: namespace(value).zeros_like(value) for name, value in state.moments.first.items()}
    return replace(state, params=found[1], moments=replace(state.moments, first=still), schedule=schedule)


def _evaluate(
    renderer: Renderer, objective: Objective, state: State, free: Iterable[str], seed: int
) -> tuple[Array, float, Parameters]:
    """Image, value and gradient by the free parameters, each known to be finite and of the right shape."""
    with _keeping(state, "rendering"):
        image, pullback = renderer.render_vjp(state.params, seed=seed)
    image = detached(image)
    with _keeping(state, "the objective"):
        value, cotangent = objective.value_and_grad(image)
        number = float(detached(value))
    if not math.isfinite(number):
        msg = f"step {state.step}: the objective is {number}; the best parameters so far are in `result`"
        raise FitDivergedError(msg, state.result())
    with _keeping(state, "the pullback"):
        pulled = pullback(cotangent)
        gradient = {name: _like("cotangent", "pullback", name, pulled, state.params[name]) for name in free}
    for name, slope in gradient.items():
        bad = count_non_finite(slope)
        if bad:
            msg = f"step {state.step}: the gradient of {name!r} has {bad} non-finite values; see `result`"
            raise FitDivergedError(msg, state.result())
    return image, number, gradient


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


def _legal(renderer: Renderer, bounds: Bounds, moved: Parameters, state: State) -> Parameters:
    """The free parameters within their bounds, after the renderer has made them legal; the others as they were.

    A renderer knows neither bounds nor what is free: it may, say, part two disks of which one is to stay.
    """
    moved = bounds.clip(moved)
    if not isinstance(renderer, ProjectingRenderer):
        return moved
    with _keeping(state, "the projection"):
        legal = renderer.project(moved)
        free = {name: _like("value", "projection", name, legal, moved[name]) for name in bounds.lower}
    return bounds.clip(moved | free)


@dataclass(frozen=True)
class _keeping:  # noqa: N801 - it reads as what it does: with _keeping(state, "rendering")
    """Whatever breaks after the first step must not take the best parameters with it.

    A class, since a generator that Ctrl-C cuts off could not tell its own end from an error.
    """

    state: State
    what: str

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is None or is_ctrl_c(error):
            return
        result = self.state.result()
        if result is None and isinstance(error, LoiError) and not isinstance(error, NonFiniteImageError):
            return  # nothing is lost yet, and the error says what is wrong with the call
        if isinstance(error, NonFiniteImageError):
            msg = f"step {self.state.step}: the render is not finite: {described(error)}"
            raise FitDivergedError(msg, result) from error
        msg = f"step {self.state.step}: {self.what} failed: {described(error)}"
        raise FitError(msg, result) from error


def _last_seen(renderer: Renderer, objective: Objective, state: State, seed: int) -> State:
    """The last step has moved the parameters; they count only if their value is known."""
    with _keeping(state, "measuring the last step"):
        try:
            image = detached(renderer.render(state.params, seed=seed + state.step))
            value = float(detached(objective.value(image)))
        except LoiError:
            return state  # refused for what they are: the best iterate stands
    return state.seen(value, image, state.schedule.stage) if math.isfinite(value) else state


def _rate(decay: Decay, schedule: FarToNear, step: int, steps: int) -> float:
    if decay == "none" or steps == 1:
        return 1.0
    passed = step / (steps - 1) if schedule.stages == 1 else schedule.passed
    return FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + math.cos(math.pi * passed))


def check_fit_options(steps: object, learning_rate: object, seed: object, decay: object, starts: object = 1) -> None:
    """Raise :class:`OptionError` unless :func:`fit` takes these values."""
    for name, value, least, most in (
        ("steps", steps, 1, MOST_STEPS),
        ("seed", seed, 0, MOST_SEED),
        ("starts", starts, 1, MOST_STARTS),
    ):
        number = whole_number(value)
        if number is None or not least <= number <= most:
            wanted = f"{least} or more" if number is None or number < least else f"at most {most}"
            msg = f"`{name}` must be a whole number, {wanted}, got {shown(value)}"
            raise OptionError(msg)
    if learning_rate is not None:
        check_rate("learning_rate", learning_rate)
    if not isinstance(decay, str) or decay not in get_args(Decay):
        msg = f"`decay` must be one of {', '.join(map(repr, get_args(Decay)))}, got {shown(decay)}"
        raise OptionError(msg)


def _checkpoint_path(checkpoint: object) -> Path | None:
    if checkpoint is None:
        return None
    if not isinstance(checkpoint, str | os.PathLike) or Path(checkpoint).is_dir():
        msg = f"`checkpoint` must be the path of a file, got {shown(checkpoint)}"
        raise OptionError(msg)
    check_writable("checkpoint", Path(checkpoint).parent)
    return Path(checkpoint)

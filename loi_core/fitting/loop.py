"""Fitting the parameters of any renderer to an image, with nothing but the renderer contract."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TypeAlias, get_args

import numpy as np

from loi_core.errors import FitDivergedError, FitError, LoiError, NonFiniteImageError, OptionError, RendererError
from loi_core.fitting.adam import Moments, adam_step
from loi_core.fitting.checkpoint import load_checkpoint, save_checkpoint
from loi_core.fitting.parameters import (
    Bounds,
    Free,
    bounds_of,
    check_rate,
    free_parameters,
    own_parameters,
    starting_parameters,
)
from loi_core.fitting.resuming import resumed, settings_of, snapshot
from loi_core.fitting.state import FitResult, FitStep, State
from loi_core.io.files import check_writable, remove_temporaries
from loi_core.objectives.base import Objective
from loi_core.pixels.nonfinite import count_non_finite
from loi_core.renderers.contract import Parameters, ProjectingRenderer, Renderer
from loi_core.support.arrays import Array, detached, is_array_api_obj, namespace, to_numpy
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
    steps: int,
    learning_rate: float,
    seed: int = 0,
    optimise: Mapping[str, Free] | Iterable[str] | None = None,
    decay: Decay = "cosine",
    checkpoint: Path | str | None = None,
    resume: bool = False,
    callback: Callback | None = None,
) -> FitResult:
    """Fit the parameters of a renderer so that its image minimises an objective.

    Adam with a decaying rate; bounds are kept by clipping and the best iterate is remembered.

    Parameters
    ----------
    renderer : Renderer
        Anything that keeps the contract. If it has ``project``, that is called after every step, for
        the parameters that may move; their bounds hold all the same.
    objective : Objective
        Anything with ``value`` and ``value_and_grad``.
    steps : int
        Number of steps, 1 or more.
    learning_rate : float
        About how far a parameter moves in a step, in its own unit.
    seed : int
        Step k renders with seed ``seed + k``.
    optimise : dict of Free, or names, optional
        What moves, and how; every parameter by default.
    decay : {"cosine", "none"}
        "cosine" takes the rate down to a thousandth of `learning_rate` over the steps.
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
    check_fit_options(steps, learning_rate, seed, decay)
    # NumPy's own numbers would wrap around in a sum, or widen the dtype of what they are multiplied with.
    steps, seed = int(steps), int(seed)
    path = _checkpoint_path(checkpoint)
    if path is not None:
        remove_temporaries(path)
    free = free_parameters(optimise, own_parameters(renderer))
    params = starting_parameters(renderer, free)
    bounds = bounds_of(params, free)
    rates = {
        name: real_number(learning_rate if one.learning_rate is None else one.learning_rate)
        for name, one in free.items()
    }
    settings = settings_of(steps, seed, decay, rates, bounds)
    # The state is only ever replaced whole, so that Ctrl-C falls before a step or after it, never within.
    state = State(params, Moments.zeros({name: params[name] for name in free}))
    try:
        if path is not None and resume and path.exists():
            state = resumed(load_checkpoint(path, settings), state, renderer, objective, seed)
        while state.step < steps:
            started = time.perf_counter()
            seen, factor = state.params, _rate(decay, state.step, steps)
            image, value, gradient = _evaluate(renderer, objective, state, rates, seed + state.step)
            state = state.seen(value, image)
            # In float64, since squares leave the range of narrower dtypes while the gradient is well within it.
            squares = (np.square(to_numpy(one), dtype=np.float64) for one in gradient.values())
            norm = math.sqrt(sum(float(np.sum(one)) for one in squares))
            with np.errstate(all="ignore"):  # what overflows is not finite, and is told as that at the next step
                now = {name: factor * rate for name, rate in rates.items()}
                moved, moments = adam_step(seen, gradient, state.moments, now)
            moved = _legal(renderer, bounds, moved, state)
            entry = FitStep(state.step, value, norm, factor, time.perf_counter() - started)
            state = state.stepped(entry, moved, moments)
            if state.step % CHECKPOINT_STEPS == 0:
                _save(path, state, settings)
            if callback is not None and callback(entry, seen, image):
                break
        state = _last_seen(renderer, objective, state, seed)
        _save(path, state, settings)
        result = state.result()
        if result is None:  # pragma: no cover - steps >= 1 has seen at least one value
            msg = "the fit saw no value"
            raise FitError(msg)
        return result
    except KeyboardInterrupt:
        lost = ""
        try:
            _save(path, state, settings)
        except FitError as error:
            lost = str(error)
        raise FitInterruptedError(state.result(), lost) from None


def _save(path: Path | None, state: State, settings: Mapping[str, str]) -> None:
    if path is not None and state.best is not None:
        with _keeping(state, "writing the checkpoint"):
            save_checkpoint(path, snapshot(state, state.best, settings))


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
    return state.seen(value, image) if math.isfinite(value) else state


def _rate(decay: Decay, step: int, steps: int) -> float:
    if decay == "none" or steps == 1:
        return 1.0
    return FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + math.cos(math.pi * step / (steps - 1)))


def check_fit_options(steps: object, learning_rate: object, seed: object, decay: object) -> None:
    """Raise :class:`OptionError` unless :func:`fit` takes these values."""
    for name, value, least, most in (("steps", steps, 1, MOST_STEPS), ("seed", seed, 0, MOST_SEED)):
        number = whole_number(value)
        if number is None or not least <= number <= most:
            wanted = f"{least} or more" if number is None or number < least else f"at most {most}"
            msg = f"`{name}` must be a whole number, {wanted}, got {shown(value)}"
            raise OptionError(msg)
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

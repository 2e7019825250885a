"""Fitting the parameters of any renderer to an image, with nothing but the renderer contract."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np

from loi_core.arrays import Array, detached, from_numpy, is_array_api_obj, namespace, to_numpy
from loi_core.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from loi_core.errors import FitError, LoiError, NonFiniteImageError, OptionError, ParameterError, RendererError
from loi_core.files import check_writable
from loi_core.free import Bounds, Free, bounds_of, check_rate, free_parameters, own_parameters, starting_parameters
from loi_core.nonfinite import count_non_finite
from loi_core.objectives.base import Objective
from loi_core.optimiser import Moments, adam_step
from loi_core.renderer import Parameters, ProjectingRenderer, Renderer
from loi_core.values import whole_number

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

FINAL_RATE: Final = 1e-3  # where a cosine decay ends, as a share of the learning rate
CHECKPOINT_STEPS: Final = 25


@dataclass(frozen=True)
class FitStep:
    """What one step found, before the parameters moved.

    Attributes
    ----------
    step : int
        Counted from 0.
    value : float
        The objective.
    gradient_norm : float
        Euclidean norm of the gradient by the free parameters.
    rate : float
        Share of the learning rate that the step took.
    seconds : float
        Time the step took.
    """

    step: int
    value: float
    gradient_norm: float
    rate: float
    seconds: float


@dataclass(frozen=True)
class FitResult:
    """Where a fit came to.

    Attributes
    ----------
    params : dict of arrays
        After the last step.
    best_params : dict of arrays
        Those with the least value.
    best_value : float
        That value.
    best_step : int
        The step at which they were seen; equal to the number of steps if after the last.
    image : array, shape (H, W, C)
        Rendered from `best_params`.
    history : tuple of FitStep
        One entry a step.
    """

    params: Parameters
    best_params: Parameters
    best_value: float
    best_step: int
    image: Array
    history: tuple[FitStep, ...]


Callback: TypeAlias = Callable[[FitStep, Parameters, Array], bool | None]
"""Called after every step with the step, its parameters and its image; returning True ends the fit."""


class FitInterruptedError(KeyboardInterrupt):
    """Ctrl-C during a fit; ``result`` holds what it had reached.

    Derived from ``KeyboardInterrupt`` alone, so that nothing which catches ordinary errors swallows it.
    """

    def __init__(self, result: FitResult | None) -> None:
        super().__init__("the fit was interrupted")
        self.result = result


@dataclass
class _Run:
    """The moving state of a fit."""

    params: Parameters
    moments: Moments
    step: int = 0
    history: list[FitStep] = field(default_factory=list)
    best_params: Parameters | None = None
    best_value: float = math.inf
    best_step: int = 0
    best_image: Array = None

    def see(self, step: int, value: float, image: Array) -> None:
        """Keep these parameters if they are the best so far."""
        if self.best_params is None or value < self.best_value:
            self.best_params, self.best_value, self.best_step, self.best_image = self.params, value, step, image

    def result(self) -> FitResult | None:
        """What has been reached; None before the first value."""
        if self.best_params is None:
            return None
        return FitResult(
            self.params, self.best_params, self.best_value, self.best_step, self.best_image, tuple(self.history)
        )


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
        Anything that keeps the contract. If it has ``project``, that is called after every step.
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
        If the loss or gradient stops being finite, or the renderer fails after the first step; its ``result``
        holds the best parameters so far.
    RendererError
        If the renderer breaks the contract on the first step.
    FitInterruptedError
        On Ctrl-C; likewise.
    """
    check_fit_options(steps, learning_rate, seed, decay)
    path = _checkpoint_path(checkpoint)
    free = free_parameters(optimise, own_parameters(renderer))
    params = starting_parameters(renderer, free)
    bounds = bounds_of(params, free)
    rates = {name: learning_rate if one.learning_rate is None else one.learning_rate for name, one in free.items()}
    settings = _settings(steps, seed, decay, rates, bounds)
    run = _Run(params, Moments.zeros({name: params[name] for name in free}))
    if path is not None and resume and path.exists():
        run = _resumed(load_checkpoint(path, settings), run, renderer, objective, seed)
    try:
        while run.step < steps:
            started = time.perf_counter()
            step, seen = run.step, run.params
            share = _rate(decay, step, steps)
            image, value, gradient = _evaluate(renderer, objective, run, rates, seed + step)
            run.see(step, value, image)
            norm = math.sqrt(sum(float(np.sum(np.square(to_numpy(one)))) for one in gradient.values()))
            moved, moments = adam_step(seen, gradient, run.moments, {name: share * rates[name] for name in rates})
            moved = _projected(renderer, bounds.clip(moved), run)
            entry = FitStep(step, value, norm, share, time.perf_counter() - started)
            # All at once, so that Ctrl-C falls before a step or after it, never within.
            run.moments, run.params, run.step, run.history = moments, moved, step + 1, [*run.history, entry]
            if path is not None and run.step % CHECKPOINT_STEPS == 0:
                save_checkpoint(path, _snapshot(run, settings))
            if callback is not None and callback(entry, seen, image):
                break
        _see_last(renderer, objective, run, seed)
    except KeyboardInterrupt:
        if path is not None and run.best_params is not None:
            save_checkpoint(path, _snapshot(run, settings))
        raise FitInterruptedError(run.result()) from None
    if path is not None:
        save_checkpoint(path, _snapshot(run, settings))
    result = run.result()
    if result is None:  # pragma: no cover - steps >= 1 has seen at least one value
        msg = "the fit saw no value"
        raise FitError(msg)
    return result


def _evaluate(
    renderer: Renderer, objective: Objective, run: _Run, free: Iterable[str], seed: int
) -> tuple[Array, float, Parameters]:
    """Image, value and gradient by the free parameters, each known to be finite and of the right shape."""
    with _keeping(run, "rendering"):
        image, pullback = renderer.render_vjp(run.params, seed=seed)
    image = detached(image)
    with _keeping(run, "the objective"):
        value, cotangent = objective.value_and_grad(image)
    number = float(detached(value))
    if not math.isfinite(number):
        msg = f"step {run.step}: the objective is {number}; the best parameters so far are in `result`"
        raise FitError(msg, run.result())
    with _keeping(run, "the pullback"):
        pulled = pullback(cotangent)
        gradient = {name: _cotangent_of(name, pulled, run.params[name]) for name in free}
    for name, slope in gradient.items():
        bad = count_non_finite(slope)
        if bad:
            msg = f"step {run.step}: the gradient of {name!r} has {bad} non-finite values; see `result`"
            raise FitError(msg, run.result())
    return image, number, gradient


def _cotangent_of(name: str, pulled: object, parameter: Array) -> Array:
    if not isinstance(pulled, Mapping) or name not in pulled:
        msg = f"the pullback gave no cotangent for {name!r}"
        raise RendererError(msg)
    slope = pulled[name]
    if not is_array_api_obj(slope) or tuple(slope.shape) != tuple(parameter.shape):
        got = f"shape {tuple(slope.shape)}" if is_array_api_obj(slope) else type(slope).__name__
        msg = f"the cotangent of {name!r} must be an array of shape {tuple(parameter.shape)}, got {got}"
        raise RendererError(msg)
    return namespace(parameter).astype(detached(slope), parameter.dtype)


def _projected(renderer: Renderer, params: Parameters, run: _Run) -> Parameters:
    if not isinstance(renderer, ProjectingRenderer):
        return params
    with _keeping(run, "the projection"):
        return renderer.project(params)


@contextlib.contextmanager
def _keeping(run: _Run, what: str) -> Iterator[None]:
    """Whatever breaks after the first step must not take the best parameters with it."""
    try:
        yield
    except Exception as error:
        result = run.result()
        if result is None and isinstance(error, LoiError) and not isinstance(error, NonFiniteImageError):
            raise  # nothing is lost yet, and the error says what is wrong with the call
        finding = f"{what} failed: {type(error).__name__}"
        if isinstance(error, NonFiniteImageError):
            finding = "the render is not finite"
        msg = f"step {run.step}: {finding}: {error}"
        raise FitError(msg, result) from error


def _see_last(renderer: Renderer, objective: Objective, run: _Run, seed: int) -> None:
    """The last step has moved the parameters; they count only if their value is known."""
    try:
        image = detached(renderer.render(run.params, seed=seed + run.step))
        value = float(detached(objective.value(image)))
    except LoiError:
        return  # the best iterate stands
    if math.isfinite(value):
        run.see(run.step, value, image)


def _rate(decay: Decay, step: int, steps: int) -> float:
    if decay == "none" or steps == 1:
        return 1.0
    return FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + math.cos(math.pi * step / (steps - 1)))


def check_fit_options(steps: object, learning_rate: object, seed: object, decay: object) -> None:
    """Raise :class:`OptionError` unless :func:`fit` takes these values."""
    for name, value, least in (("steps", steps, 1), ("seed", seed, 0)):
        number = whole_number(value)
        if number is None or number < least:
            msg = f"`{name}` must be a whole number, {least} or more, got {value!r:.60}"
            raise OptionError(msg)
    check_rate("learning_rate", learning_rate)
    if not isinstance(decay, str) or decay not in get_args(Decay):
        msg = f"`decay` must be one of {', '.join(map(repr, get_args(Decay)))}, got {decay!r:.60}"
        raise OptionError(msg)


def _checkpoint_path(checkpoint: object) -> Path | None:
    if checkpoint is None:
        return None
    if not isinstance(checkpoint, str | os.PathLike) or Path(checkpoint).is_dir():
        msg = f"`checkpoint` must be the path of a file, got {checkpoint!r:.60}"
        raise OptionError(msg)
    check_writable("checkpoint", Path(checkpoint).parent)
    return Path(checkpoint)


def _settings(steps: int, seed: int, decay: str, rates: Mapping[str, float], bounds: Bounds) -> dict[str, str]:
    """What must be the same for a fit to go on as if it had not stopped, by name."""
    limits = {name: [to_numpy(side[name]).tolist() for side in (bounds.lower, bounds.upper)] for name in rates}
    return {
        "steps": str(int(steps)),
        "seed": str(int(seed)),
        "decay": decay,
        "learning rates": json.dumps({name: float(rate) for name, rate in rates.items()}),
        "bounds": hashlib.sha256(json.dumps(limits).encode()).hexdigest()[:12],
    }


def _snapshot(run: _Run, settings: Mapping[str, str]) -> Checkpoint:
    def host(params: Parameters | None) -> dict[str, np.ndarray[Any, Any]]:
        return {name: np.asarray(to_numpy(value)) for name, value in (params or {}).items()}

    rows = [(one.step, one.value, one.gradient_norm, one.rate, one.seconds) for one in run.history]
    return Checkpoint(
        settings=settings,
        step=run.step,
        count=run.moments.count,
        best_step=run.best_step,
        best_value=run.best_value,
        params=host(run.params),
        first=host(run.moments.first),
        second=host(run.moments.second),
        best_params=host(run.best_params),
        history=np.asarray(rows, dtype=np.float64).reshape(-1, 5),
    )


def _resumed(saved: Checkpoint, fresh: _Run, renderer: Renderer, objective: Objective, seed: int) -> _Run:
    def live(stored: Mapping[str, Any], like: Parameters, what: str) -> Parameters:
        if {name: value.shape for name, value in stored.items()} != {
            name: tuple(value.shape) for name, value in like.items()
        }:
            msg = f"`checkpoint` holds other {what} than this fit has; start without resume"
            raise ParameterError(msg)
        return {name: from_numpy(value, like[name]) for name, value in stored.items()}

    moments = fresh.moments
    run = _Run(
        live(saved.params, fresh.params, "parameters"),
        Moments(
            live(saved.first, moments.first, "free parameters"),
            live(saved.second, moments.second, "free parameters"),
            saved.count,
        ),
        saved.step,
        [FitStep(int(row[0]), *map(float, row[1:])) for row in saved.history],
    )
    for name, value in fresh.params.items():
        if name not in moments.first and not np.array_equal(saved.params[name], to_numpy(value)):
            msg = f"`checkpoint` was made with another scene: {name!r}, which does not move, differs"
            raise ParameterError(msg)
    run.best_params = live(saved.best_params, fresh.params, "parameters")
    run.best_value, run.best_step = saved.best_value, saved.best_step
    run.best_image = detached(renderer.render(run.best_params, seed=seed + run.best_step))
    value = float(detached(objective.value(run.best_image)))
    # Loosely, since libraries may sum in another order from one run to the next.
    if not math.isclose(value, saved.best_value, rel_tol=1e-4, abs_tol=1e-12):
        msg = (
            f"`checkpoint` was made with another objective, reference or scene: its best value is "
            f"{saved.best_value:.6g}, here the same parameters give {value:.6g}; start without resume"
        )
        raise ParameterError(msg)
    return run

"""Fitting the parameters of any renderer to an image, with nothing but the renderer contract."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np

from loi_core.arrays import Array, from_numpy, namespace, to_numpy
from loi_core.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from loi_core.errors import FitError, NonFiniteImageError, OptionError, ParameterError
from loi_core.nonfinite import count_non_finite
from loi_core.objectives.base import Objective
from loi_core.optimiser import Moments, adam_step
from loi_core.renderer import Parameters, ProjectingRenderer, Renderer

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
class Free:
    """How one parameter may move in a fit.

    Attributes
    ----------
    initial : array, optional
        Where it starts; where the renderer has it by default. Shape of the parameter, or a number for all of it.
    lower, upper : array, optional
        Bounds, inclusive, of the same kinds of shape; unbounded by default.
    learning_rate : float, optional
        In the parameter's own unit; that of the fit by default.
    """

    initial: Any = None
    lower: Any = None
    upper: Any = None
    learning_rate: float | None = None


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
        Whether to go on from `checkpoint` if it exists. The fit then ends as if it had never stopped.
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
        If the loss or gradient stops being finite; its ``result`` holds the best parameters so far.
    FitInterruptedError
        On Ctrl-C; likewise.
    """
    check_fit_options(steps, learning_rate, seed, decay)
    free = _free_parameters(optimise, renderer.parameters())
    params = starting_parameters(renderer, free)
    lower = {name: _limit(name, "lower", params[name], entry.lower) for name, entry in free.items()}
    upper = {name: _limit(name, "upper", params[name], entry.upper) for name, entry in free.items()}
    _check_bounds(params, lower, upper)
    rates = {name: learning_rate if one.learning_rate is None else one.learning_rate for name, one in free.items()}
    run = _Run(params, Moments.zeros({name: params[name] for name in free}))
    path = None if checkpoint is None else Path(checkpoint)
    if path is not None and resume and path.exists():
        run = _resumed(load_checkpoint(path), run, steps, renderer, seed)
    try:
        while run.step < steps:
            started = time.perf_counter()
            step = run.step
            share = _rate(decay, step, steps)
            image, value, gradient = _evaluate(renderer, objective, run, free, seed + step)
            run.see(step, value, image)
            norm = math.sqrt(sum(float(np.sum(np.square(to_numpy(gradient[name])))) for name in free))
            moved, run.moments = adam_step(
                run.params, gradient, run.moments, {name: share * rate for name, rate in rates.items()}
            )
            moved = _clipped(moved, lower, upper)
            if isinstance(renderer, ProjectingRenderer):
                moved = renderer.project(moved)
            seen, run.params, run.step = run.params, moved, step + 1
            run.history.append(FitStep(step, value, norm, share, time.perf_counter() - started))
            if path is not None and run.step % CHECKPOINT_STEPS == 0:
                save_checkpoint(path, _snapshot(run))
            if callback is not None and callback(run.history[-1], seen, image):
                break
        _see_last(renderer, objective, run, seed)
    except KeyboardInterrupt:
        if path is not None and run.best_params is not None:
            save_checkpoint(path, _snapshot(run))
        raise FitInterruptedError(run.result()) from None
    if path is not None:
        save_checkpoint(path, _snapshot(run))
    result = run.result()
    if result is None:  # pragma: no cover - steps >= 1 has seen at least one value
        msg = "the fit saw no value"
        raise FitError(msg)
    return result


def _evaluate(
    renderer: Renderer, objective: Objective, run: _Run, free: Mapping[str, Free], seed: int
) -> tuple[Array, float, Parameters]:
    image, pullback = renderer.render_vjp(run.params, seed=seed)
    try:
        value, cotangent = objective.value_and_grad(image)
    except NonFiniteImageError as error:
        msg = f"step {run.step}: the render is not finite: {error}"
        raise FitError(msg, run.result()) from error
    number = float(value)
    if not math.isfinite(number):
        msg = f"step {run.step}: the objective is {number}; the best parameters so far are in `result`"
        raise FitError(msg, run.result())
    gradient = pullback(cotangent)
    for name in free:
        bad = count_non_finite(gradient[name])
        if bad:
            msg = f"step {run.step}: the gradient of {name!r} has {bad} non-finite values; see `result`"
            raise FitError(msg, run.result())
    return image, number, gradient


def _see_last(renderer: Renderer, objective: Objective, run: _Run, seed: int) -> None:
    """The last step has moved the parameters; they count only if their value is known."""
    image = renderer.render(run.params, seed=seed + run.step)
    try:
        value = float(objective.value(image))
    except NonFiniteImageError:
        return  # the best iterate stands
    if math.isfinite(value):
        run.see(run.step, value, image)


def _rate(decay: Decay, step: int, steps: int) -> float:
    if decay == "none" or steps == 1:
        return 1.0
    return FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + math.cos(math.pi * step / (steps - 1)))


def _clipped(params: Parameters, lower: Mapping[str, Array], upper: Mapping[str, Array]) -> Parameters:
    result = dict(params)
    for name, limit in lower.items():
        xp = namespace(result[name])
        result[name] = xp.minimum(xp.maximum(result[name], limit), upper[name])
    return result


def check_fit_options(steps: object, learning_rate: object, seed: object, decay: object) -> None:
    """Raise :class:`OptionError` unless :func:`fit` takes these values."""
    if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or steps < 1:
        msg = f"`steps` must be a whole number, 1 or more, got {steps!r}"
        raise OptionError(msg)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        msg = f"`seed` must be a whole number, 0 or more, got {seed!r}"
        raise OptionError(msg)
    _check_rate("learning_rate", learning_rate)
    if decay not in get_args(Decay):
        msg = f"`decay` must be one of {', '.join(map(repr, get_args(Decay)))}, got {decay!r}"
        raise OptionError(msg)


def _check_rate(name: str, rate: object) -> None:
    number = isinstance(rate, Real) and not isinstance(rate, bool | np.bool_)
    if not number or not math.isfinite(float(rate)) or float(rate) <= 0:  # type: ignore[arg-type]  # a Real here
        msg = f"`{name}` must be a finite number, more than 0, got {rate!r}"
        raise OptionError(msg)


def _free_parameters(optimise: object, params: Parameters) -> dict[str, Free]:
    if optimise is None:
        optimise = list(params)
    if isinstance(optimise, str) or not isinstance(optimise, Mapping | Iterable):
        msg = f"`optimise` must be names of parameters, or a dict of Free, got {optimise!r}"
        raise OptionError(msg)
    free = dict(optimise) if isinstance(optimise, Mapping) else {name: Free() for name in optimise}
    if not free:
        msg = "`optimise` must name at least one parameter, got none"
        raise OptionError(msg)
    for name, entry in free.items():
        if name not in params:
            msg = f"`optimise` names {name!r}, which the renderer does not have; it has {', '.join(sorted(params))}"
            raise ParameterError(msg)
        if not isinstance(entry, Free):
            msg = f"`optimise[{name!r}]` must be a Free, got {type(entry).__name__}"
            raise OptionError(msg)
        if entry.learning_rate is not None:
            _check_rate(f"learning_rate of {name!r}", entry.learning_rate)
    return free


def starting_parameters(renderer: Renderer, free: Mapping[str, Free]) -> Parameters:
    """The renderer's parameters, with the initial values of the free ones put in.

    Raises
    ------
    ParameterError
        If an initial value has a wrong shape or is not finite.
    """
    params = renderer.parameters()
    for name, entry in free.items():
        if entry.initial is not None:
            params[name] = _like(name, "initial", params[name], entry.initial)
            if count_non_finite(params[name]):
                msg = f"`initial` of {name!r} must be finite, got {entry.initial!r:.60}"
                raise ParameterError(msg)
    return params


def _limit(name: str, side: str, parameter: Array, limit: object) -> Array:
    return _like(name, side, parameter, (-math.inf if side == "lower" else math.inf) if limit is None else limit)


def _like(name: str, what: str, parameter: Array, value: object) -> Array:
    """`value` as an array like `parameter`, a single number standing for all of it."""
    shape = tuple(parameter.shape)
    try:
        array = np.asarray(to_numpy(value), dtype=np.float64)
    except (TypeError, ValueError):
        msg = f"`{what}` of {name!r} must be numbers, got {value!r:.60}"
        raise ParameterError(msg) from None
    if array.shape not in ((), shape):
        msg = f"`{what}` of {name!r} must be a number or have shape {shape}, got shape {array.shape}"
        raise ParameterError(msg)
    return from_numpy(np.broadcast_to(array, shape).copy(), parameter)


def _check_bounds(params: Parameters, lower: Mapping[str, Array], upper: Mapping[str, Array]) -> None:
    for name, low in lower.items():
        floor, ceiling, start = to_numpy(low), to_numpy(upper[name]), to_numpy(params[name])
        if not np.all(floor <= ceiling):
            msg = f"`lower` of {name!r} must not exceed `upper`, got {floor.tolist()} and {ceiling.tolist()}"
            raise ParameterError(msg)
        if not np.all((floor <= start) & (start <= ceiling)):
            msg = f"`initial` of {name!r} must lie within its bounds, got {start.tolist()!r:.80}"
            raise ParameterError(msg)


def _snapshot(run: _Run) -> Checkpoint:
    def host(params: Parameters | None) -> dict[str, np.ndarray[Any, Any]]:
        return {name: np.asarray(to_numpy(value)) for name, value in (params or {}).items()}

    rows = [(one.step, one.value, one.gradient_norm, one.rate, one.seconds) for one in run.history]
    return Checkpoint(
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


def _resumed(saved: Checkpoint, fresh: _Run, steps: int, renderer: Renderer, seed: int) -> _Run:
    def live(stored: Mapping[str, Any], like: Parameters, what: str) -> Parameters:
        if {name: value.shape for name, value in stored.items()} != {
            name: tuple(value.shape) for name, value in like.items()
        }:
            msg = f"`checkpoint` holds other {what} than this fit has; start without resume"
            raise ParameterError(msg)
        return {name: from_numpy(value, like[name]) for name, value in stored.items()}

    if saved.step > steps:
        msg = f"`steps` is {steps}, but the checkpoint is already at step {saved.step}"
        raise OptionError(msg)
    moments = fresh.moments
    run = replace(
        fresh,
        params=live(saved.params, fresh.params, "parameters"),
        moments=Moments(
            live(saved.first, moments.first, "free parameters"),
            live(saved.second, moments.second, "free parameters"),
            saved.count,
        ),
        step=saved.step,
        history=[FitStep(int(row[0]), *map(float, row[1:])) for row in saved.history],
    )
    run.best_params = live(saved.best_params, fresh.params, "parameters")
    run.best_value, run.best_step = saved.best_value, saved.best_step
    run.best_image = renderer.render(run.best_params, seed=seed + run.best_step)
    return run

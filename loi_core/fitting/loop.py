"""Fit the parameters of any renderer to an image, using only the renderer contract."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final, get_args

from loi_core.errors import FitError, OptionError
from loi_core.fitting.adam import Adam
from loi_core.fitting.callbacks import Callback, RememberingCallback, ends_the_fit
from loi_core.fitting.checkpoint import CheckpointFile, is_due, settings_of
from loi_core.fitting.checkpoint import resume as resume_state
from loi_core.fitting.descent import MAX_RESTARTS, Decay, Descent
from loi_core.fitting.diagnosis import diagnose_fit, exposures_of, psnr_of
from loi_core.fitting.exposure import exposure_is_free, require_visible
from loi_core.fitting.history import FitStep
from loi_core.fitting.live_figure import LiveFigure
from loi_core.fitting.optimiser import Optimiser
from loi_core.fitting.parameters import (
    Free,
    bounds_of,
    check_rate,
    free_parameters,
    own_parameters,
    starting_parameters,
)
from loi_core.fitting.partial_result import with_partial_result
from loi_core.fitting.progress import StepBar
from loi_core.fitting.rates import measured_rates, named_rates
from loi_core.fitting.schedule import Schedule
from loi_core.fitting.stages import Polish, Stages
from loi_core.fitting.starts import RunRound, can_search, successive_halving
from loi_core.fitting.state import FitResult, State
from loi_core.fitting.views import Images, Views, ungrouped
from loi_core.io.files import check_writable
from loi_core.objectives import Objective
from loi_core.renderers.contract import Parameters, Renderer
from loi_core.support.arrays import copied
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = [
    "Callback",
    "Decay",
    "FitInterruptedError",
    "FitResult",
    "FitStep",
    "Free",
    "RememberingCallback",
    "check_fit_options",
    "fit",
    "starting_parameters",
]

MAX_STEPS: Final = 2**31 - 1
MAX_STARTS: Final = 4096
MAX_SEED: Final = 2**63 - 1  # a signed 64-bit integer, which TOML, JSON and a checkpoint can hold


class FitInterruptedError(KeyboardInterrupt):
    """Ctrl-C during a fit; ``result`` is the result so far, None before the first value.

    The message mentions a checkpoint that could not be written. The class derives from ``KeyboardInterrupt`` alone, so
    that no handler of ordinary errors swallows it.
    """

    def __init__(self, result: FitResult | None, checkpoint_error: str = "") -> None:
        super().__init__(f"interrupted; {checkpoint_error}" if checkpoint_error else "interrupted")
        self.result = result


@suggest_keywords
def fit(
    renderer: Renderer | Mapping[str, Renderer],
    objective: Objective | Mapping[str, Objective],
    *,
    steps: int = 200,
    learning_rate: float | str | None = None,
    seed: int = 0,
    optimise: Mapping[str, Free] | Iterable[str] | None = None,
    decay: Decay = "cosine",
    stages: Stages = "auto",
    polish: Polish = None,
    starts: int = 1,
    optimiser: Optimiser | None = None,
    views_per_step: int | None = None,
    checkpoint: Path | str | None = None,
    resume: bool = False,
    callback: Callback | None = None,
    progress: bool = False,
) -> FitResult:
    """Fit the parameters of a renderer so that its image minimises an objective.

    Adam with a decaying rate, on scales from far to near. Bounds are kept by clipping, the best iterate is remembered,
    and the result has a diagnosis.

    Parameters
    ----------
    renderer : Renderer, or dict of Renderer
        Anything that keeps the contract; its :class:`RendererCapabilities` are used. Several views are a dict by name:
        free parameters of the same name are shared, and a view need not have all of them.
    objective : Objective, or dict of Objective
        Anything with ``value`` and ``value_and_grad``; for several views one each, by the same names. Their mean is
        minimised.
    steps : int
        Number of steps, 1 or more.
    learning_rate : float or str, optional
        Approximate length of a step: a number in each parameter's own unit, or text such as "1.5 px" in pixels that the
        image moves, for which every parameter's unit is measured from the renderer first. By default as many pixels as
        cross the image once over all steps. The rate of a `Free` has precedence.
    seed : int
        Step k renders with seed ``seed + k``.
    optimise : dict of Free, or names, optional
        The free parameters; all parameters by default.
    decay : {"cosine", "none"}
        "cosine" lowers the rate to a thousandth of `learning_rate` over the steps of the main stage and the last; over
        those of the last alone if it compares pixels.
    stages : "auto", None, or a sequence of ScaleSpace or Objective
        The stages before `objective`, from far to near; each lasts until its loss no longer falls. "auto" uses
        :meth:`ScaleSpace.far_to_near` if the objective is a :class:`LOIObjective` with default scales, and nothing
        otherwise. All but the last match the exposure and are centred, and the last detects an exposure that differs,
        unless a free parameter is a brightness; ``exposure="matched"`` of the objective regresses it in the last stage.
        A stage that is stuck at a high loss, or runs out of steps there, restarts from a better point within the
        bounds, up to three times, if the free parameters are few and bounded. The first time, shorter steps are tried,
        and several such points then race for a few steps each, with at most 210 renders.
    polish : "pixels", optional
        "pixels" compares pixels once the loss of `objective` no longer falls, at the latest for the last two fifths of
        the steps, for the last digits of a target that the renderer can reproduce exactly. `best_value` then compares
        pixels. The default, None, suits photographs.
    starts : int
        Number of starts: the parameters' own, and points within their bounds, which must be finite. Successive halving
        chooses among them, which takes about the time of `starts` thirds of a fit.
    optimiser : Optimiser, optional
        Adam by default; :class:`loi_torch.TorchOptimiser` and :class:`loi_jax.OptaxOptimiser` wrap others. Rates in
        pixels suit those that, like Adam, move by about the rate for any size of the gradient.
    views_per_step : int, optional
        Number of views that a step renders, in a random order in which all come about equally often; all by default.
    checkpoint : path, optional
        File (.npz) to which the state is written every 25 steps, or every hundredth of the way if that is longer, and
        at the end, whole or not at all. No other fit may use it meanwhile.
    resume : bool
        Whether to continue from `checkpoint`, which has to be given, if it exists. The fit then ends as if it had
        never stopped. A checkpoint that is damaged, or belongs to other settings, another objective or another scene,
        is refused. Without `resume`, it is removed after the first step; a file that is not a checkpoint is refused.
    callback : callable, optional
        ``callback(step, params, image)`` after every step; returning True ends the fit, False or None continues it. For
        several views, `image` is a dict of the rendered ones. The arrays are copies. A checkpoint holds the steps whose
        callback has returned, and the memory of a ``loi_core.fitting.callbacks.RememberingCallback``.
    progress : bool
        Whether to show a progress bar and, in a notebook, the image of the latest step and the values so far.

    Returns
    -------
    FitResult

    Raises
    ------
    OptionError, ParameterError
        If an argument is not allowed.
    FitError
        If the loss or gradient is not finite, the callback returns something else, or the renderer fails or the
        checkpoint cannot be written after the first step; its ``result`` is the result so far.
    RendererError
        If the renderer breaks the contract on the first step.
    CheckpointError
        If the checkpoint is damaged.
    InUseError
        If another fit uses the checkpoint, in this process or in another.
    FitInterruptedError
        On Ctrl-C; its ``result`` is the result so far.
    """
    check_fit_options(steps, learning_rate, seed, decay, starts)
    if optimiser is None:
        optimiser = Adam()
    if not isinstance(optimiser, Optimiser) or isinstance(optimiser, type):
        msg = f"`optimiser` must be an Optimiser, such as loi_torch.TorchOptimiser, got {shown(optimiser)}"
        raise OptionError(msg)
    # NumPy's own integers would wrap around in a sum, or widen the dtype of a product.
    steps, seed = int(steps), int(seed)
    file = _checkpoint_file(checkpoint, resume=resume)
    views = Views.of(renderer, objective, stages, views_per_step, polish)
    free = free_parameters(optimise, own_parameters(views))
    views = views.with_free(free)
    params = starting_parameters(views, free)
    bounds = bounds_of(params, free)
    require_visible(views, params, bounds, seed)
    if stages == "auto" and views.finishes and exposure_is_free(views, params, bounds, seed):
        views = Views.of(renderer, objective, stages, views_per_step, polish, exposure_is_free=True).with_free(free)
    requested = {
        name: learning_rate if entry.learning_rate is None else entry.learning_rate for name, entry in free.items()
    }
    identity = optimiser.identity({name: params[name] for name in free})
    settings = settings_of(steps, seed, decay, named_rates(requested), free, starts, bounds, views, identity)
    descent = Descent(bounds, requested, optimiser, decay, steps, seed)
    # The state is only ever replaced as a whole, so that Ctrl-C falls before a step or after it, never within.
    state = called = _initial_state(descent, views, params, dict.fromkeys(free, 1.0))
    try:
        if file is not None:
            file.acquire(resume=resume)
        saved = file.load(settings) if file is not None and resume else None
        with with_partial_result(state, "starting the renderer"):
            views = views.started(params, free, seed)
        state = called = replace(state, views=views)
        if saved is not None:
            state = called = resume_state(saved, state, optimiser, free, seed)
            if isinstance(callback, RememberingCallback):
                callback.restore(saved.callback)
        else:
            if starts > 1:
                best_start, agreeing = successive_halving(
                    params, bounds, starts, views.main_stage + 1, steps, _round_of(descent, views)
                )
                state = replace(state, params=best_start, agreeing=agreeing)
            state = replace(state, rates=measured_rates(views, state.params, bounds, requested, steps, seed))
            if stages == "auto" and views.main_stage > 0 and can_search(bounds):
                noise_floor = descent.noise_floor(state)
                schedule = Schedule(views.stages, steps, MAX_RESTARTS, noise_floor, finishes=views.finishes)
                state = replace(state, schedule=schedule)
        with (
            StepBar(steps, state.step, views.stages, is_shown=progress) as bar,
            LiveFigure(is_shown=progress) as figure,
        ):
            while state.step < steps:
                state, evaluation = descent.step(state)
                _begin(file, state)
                entry = state.log[state.step - 1]
                bar.show(entry)
                figure.show(state.log, evaluation.images)
                answer = None if callback is None else callback(entry, *_copies(evaluation.params, evaluation.images))
                called = state  # only now may a checkpoint hold the step: a callback that was interrupted sees it again
                with with_partial_result(state, "the callback"):
                    stop = ends_the_fit(answer)
                if is_due(state.step):
                    _save(file, state, settings, callback)
                if stop:
                    break
        state = called = descent.finished(state, params)
        _save(file, state, settings, callback)
        result = state.result()
        if result is None:  # pragma: no cover - steps >= 1 has evaluated at least one value
            msg = "the fit has no value"
            raise FitError(msg)
        views = state.views
        exposures = exposures_of(views, result.image)
        exposure = ungrouped(exposures) if len(exposures) == len(views.by_name) else None
        result = replace(result, psnr=psnr_of(views, result.image), exposure=exposure)
        result = replace(result, diagnosis=diagnose_fit(views, params, bounds, result, seed))
        _release(file)  # here, since Ctrl-C in a `finally` would lose the result
        return result
    except KeyboardInterrupt:
        checkpoint_error = ""
        try:
            _save(file, state if callback is None else called, settings, callback)
        except FitError as error:
            checkpoint_error = str(error)
        finally:
            _release(file)
        raise FitInterruptedError(state.result(), checkpoint_error) from None
    except BaseException:
        _release(file)
        raise


def _copies(params: Parameters, images: Mapping[str, Images]) -> tuple[Parameters, Images]:
    """Return parameters and images that a callback may write to."""
    copies = {name: copied(image) for name, image in images.items()}
    return {name: copied(value) for name, value in params.items()}, ungrouped(copies)


def _initial_state(descent: Descent, views: Views, params: Parameters, rates: Mapping[str, float]) -> State:
    memory = descent.optimiser.start({name: params[name] for name in descent.bounds.lower})
    schedule = Schedule(views.stages, descent.steps, finishes=views.finishes)
    return State(params, memory, views, rates=rates, schedule=schedule)


def _round_of(descent: Descent, views: Views) -> RunRound:
    """Return the function that fits one candidate of successive halving for some steps of one stage."""

    def run(start: Parameters, stage: int, steps: int) -> tuple[float, Parameters]:
        short, at_stage = replace(descent, decay="none"), views.at_stage(stage)  # early in the fit, not a whole fit
        rates = measured_rates(at_stage, start, descent.bounds, descent.requested_rates, steps, descent.seed)
        state = _initial_state(short, at_stage, start, rates)
        while state.step < steps:
            state, _ = short.step(state)
        best = short.finished(state, start).best
        if best is None:  # pragma: no cover - a step has evaluated at least one value
            return math.inf, start
        return views.value(best.params, views.main_stage, descent.seed + best.step), best.params

    return run


def _release(file: CheckpointFile | None) -> None:
    if file is not None:
        file.release()


def _begin(file: CheckpointFile | None, state: State) -> None:
    if file is not None:
        with with_partial_result(state, "removing the checkpoint of an earlier fit"):
            file.begin()


def _save(file: CheckpointFile | None, state: State, settings: Mapping[str, str], callback: Callback | None) -> None:
    if file is not None and state.best is not None:
        with with_partial_result(state, "writing the checkpoint"):
            memory = callback.memory() if isinstance(callback, RememberingCallback) else {}
            file.save(state, settings, memory)


def check_fit_options(steps: object, learning_rate: object, seed: object, decay: object, starts: object = 1) -> None:
    """Raise :class:`OptionError` unless :func:`fit` takes these values."""
    for name, value, lowest, highest in (
        ("steps", steps, 1, MAX_STEPS),
        ("seed", seed, 0, MAX_SEED),
        ("starts", starts, 1, MAX_STARTS),
    ):
        number = whole_number(value)
        if number is None or not lowest <= number <= highest:
            allowed = f"{lowest} or more" if number is None or number < lowest else f"at most {highest}"
            msg = f"`{name}` must be a whole number, {allowed}, got {shown(value)}"
            raise OptionError(msg)
    if learning_rate is not None:
        check_rate("learning_rate", learning_rate)
    if not isinstance(decay, str) or decay not in get_args(Decay):
        msg = f"`decay` must be one of {', '.join(map(repr, get_args(Decay)))}, got {shown(decay)}"
        raise OptionError(msg)


def _checkpoint_file(checkpoint: object, *, resume: object) -> CheckpointFile | None:
    if checkpoint is None:
        if resume:
            msg = f"`resume` must be False without a `checkpoint` to continue from, got {shown(resume)}"
            raise OptionError(msg)
        return None
    if not isinstance(checkpoint, str | os.PathLike) or Path(checkpoint).is_dir():
        msg = f"`checkpoint` must be the path of a file, got {shown(checkpoint)}"
        raise OptionError(msg)
    check_writable("checkpoint", Path(checkpoint).parent)
    return CheckpointFile(Path(checkpoint))

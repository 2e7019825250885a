"""Fitting the parameters of any renderer to an image, with nothing but the renderer contract."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final, get_args

from loi_core.errors import FitError, OptionError
from loi_core.fitting.adam import Adam
from loi_core.fitting.callbacks import Callback, RememberingCallback, ends_the_fit
from loi_core.fitting.checkpoint import CheckpointFile, is_due, settings_of
from loi_core.fitting.checkpoint import resume as resumed
from loi_core.fitting.descent import SEARCHES, Decay, Descent
from loi_core.fitting.diagnosis import judged, nearness
from loi_core.fitting.history import FitStep
from loi_core.fitting.keeping import keeping
from loi_core.fitting.optimiser import Optimiser
from loi_core.fitting.parameters import (
    Free,
    bounds_of,
    check_rate,
    free_parameters,
    own_parameters,
    starting_parameters,
)
from loi_core.fitting.race import can_search, race
from loi_core.fitting.rates import measured_rates, named_rates
from loi_core.fitting.stages import FarToNear, Finish, Stages
from loi_core.fitting.state import FitResult, State
from loi_core.fitting.views import Images, Views, as_given, by_view
from loi_core.io.files import check_writable
from loi_core.objectives import Objective
from loi_core.renderers.contract import Parameters, Renderer
from loi_core.support.arrays import copied
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

MOST_STEPS: Final = 2**31 - 1
MOST_STARTS: Final = 4096
MOST_SEED: Final = 2**63 - 1  # of 64 bits with a sign, which is what TOML, JSON and a checkpoint hold anywhere


class FitInterruptedError(KeyboardInterrupt):
    """Ctrl-C during a fit; ``result`` holds what it had reached.

    Its message says so if the checkpoint could not be written. Derived from ``KeyboardInterrupt`` alone, so that
    nothing which catches ordinary errors swallows it.
    """

    def __init__(self, result: FitResult | None, lost: str = "") -> None:
        super().__init__(f"interrupted; {lost}" if lost else "interrupted")
        self.result = result


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
    finish: Finish = None,
    starts: int = 1,
    optimiser: Optimiser | None = None,
    views_per_step: int | None = None,
    checkpoint: Path | str | None = None,
    resume: bool = False,
    callback: Callback | None = None,
) -> FitResult:
    """Fit the parameters of a renderer so that its image minimises an objective.

    Adam with a decaying rate, from scales that reach far to those that place the last digits; bounds are kept by
    clipping, the best iterate is remembered, and the result says what came of it.

    Parameters
    ----------
    renderer : Renderer, or dict of Renderer
        Anything that keeps the contract. If it has ``project``, that is called after every step, for
        the parameters that may move; their bounds hold all the same. If it has ``at_step``, it is told before every
        step how far the fit has come. Several views are a dict by their names:
        parameters of the same name are one if they move, and not every view has to have all of them.
    objective : Objective, or dict of Objective
        Anything with ``value`` and ``value_and_grad``; of several views one each, by the same names. Their mean is
        minimised.
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
        "cosine" takes the rate down to a thousandth of `learning_rate` over the steps of the last stage, which is the
        finish if there is one.
    stages : "auto", None, or a sequence of ScaleSpace or Objective
        What comes before `objective`, from far to near; each until its loss no longer falls. "auto" puts
        :meth:`ScaleSpace.far_to_near` there if the objective is a :class:`LOIObjective` with default scales, and
        nothing otherwise; if the first stage ends with most of its loss left, and the parameters are few and bounded,
        it also looks for a better start within the bounds, up to three times.
    finish : "pixels", optional
        What comes after `objective`: "pixels" compares pixels once its loss no longer falls, or for the last two fifths
        of the steps, for the last digits of what the renderer can make exactly. `best_value` is of the pixels then.
        None, as by default, is right for photographs, which no renderer makes to the last digit.
    starts : int
        From how many places to start: the parameters' own, and others within their bounds, which then all have to be
        finite. They race by successive halving; a race takes some `starts` thirds of the time of a fit.
    optimiser : Optimiser, optional
        Adam by default; :class:`loi_torch.TorchOptimiser` and :class:`loi_jax.OptaxOptimiser` bring others. Rates in
        pixels suit those that, like Adam, move by about the rate whatever the size of the gradient.
    views_per_step : int, optional
        How many of several views a step renders, in a random order in which all come about equally often; all by
        default.
    checkpoint : path, optional
        File (.npz) to which the state is written every 25 steps, or every hundredth of the way if that is longer, and
        at the end, whole or not at all. No other fit may use it meanwhile.
    resume : bool
        Whether to continue from `checkpoint`, which has to be given, if it exists. The fit then ends as if it had
        never stopped. A checkpoint that is damaged, or belongs to other settings, another objective or another scene,
        is refused. Without `resume`, it is removed after the first step; a file that is not a checkpoint is refused.
    callback : callable, optional
        ``callback(step, params, image)`` after every step; returning True ends the fit, False or None does not. Of
        several views, `image` is a dict of those that the step has rendered. The arrays are its own, to write to.
        A checkpoint holds the steps whose callback has returned; what a
        ``loi_core.fitting.callbacks.RememberingCallback`` knows is in it as well.

    Returns
    -------
    FitResult

    Raises
    ------
    OptionError, ParameterError
        If an argument is not allowed.
    FitError
        If the loss or gradient stops being finite, the callback returns something else, or the renderer fails or the
        checkpoint cannot be written after the first step; its ``result`` holds the best parameters so far.
    RendererError
        If the renderer breaks the contract on the first step.
    CheckpointError
        If the checkpoint is damaged.
    InUseError
        If another fit has the checkpoint, in this process or in another.
    FitInterruptedError
        On Ctrl-C; likewise.
    """
    check_fit_options(steps, learning_rate, seed, decay, starts)
    if optimiser is None:
        optimiser = Adam()
    if not isinstance(optimiser, Optimiser) or isinstance(optimiser, type):
        msg = f"`optimiser` must be an Optimiser, such as loi_torch.TorchOptimiser, got {shown(optimiser)}"
        raise OptionError(msg)
    # NumPy's own numbers would wrap around in a sum, or widen the dtype of what they are multiplied with.
    steps, seed = int(steps), int(seed)
    kept = _checkpoints(checkpoint, resume=resume)
    views = Views.of(renderer, objective, stages, views_per_step, finish)
    free = free_parameters(optimise, own_parameters(views))
    views = views.moving(free)
    params = starting_parameters(views, free)
    bounds = bounds_of(params, free)
    asked = {name: learning_rate if one.learning_rate is None else one.learning_rate for name, one in free.items()}
    named = named_rates(asked)
    identity = optimiser.identity({name: params[name] for name in free})
    settings = settings_of(steps, seed, decay, named, free, starts, bounds, views, identity)
    descent = Descent(views, bounds, asked, optimiser, decay, steps, seed)
    # The state is only ever replaced whole, so that Ctrl-C falls before a step or after it, never within.
    state = called = _beginning(descent, params, dict.fromkeys(free, 1.0))
    try:
        if kept is not None:
            kept.acquire(resume=resume)
        saved = kept.load(settings) if kept is not None and resume else None
        if saved is not None:
            state = called = resumed(saved, state, views, optimiser, free, seed)
            if isinstance(callback, RememberingCallback):
                callback.restore(saved.callback)
        else:
            if starts > 1:
                winner, agreeing = race(params, bounds, starts, views.placing + 1, steps, _lap(descent))
                state = replace(state, params=winner, agreeing=agreeing)
            state = replace(state, rates=measured_rates(views, state.params, bounds, asked, steps, seed))
            if stages == "auto" and views.placing > 0 and can_search(bounds):
                enough = descent.enough(state)
                schedule = FarToNear(views.stages, steps, searches=SEARCHES, enough=enough, finish=views.finish)
                state = replace(state, schedule=schedule)
        while state.step < steps:
            state, entry, seen, image = descent.step(state)
            _begin(kept, state)
            answer = None if callback is None else callback(entry, *_own(seen, image))
            called = state  # only now may a checkpoint hold the step: a callback that was cut off sees it again
            with keeping(state, "the callback"):
                stop = ends_the_fit(answer)
            if is_due(state.step):
                _save(kept, state, settings, callback)
            if stop:
                break
        state = called = descent.finished(state, params)
        _save(kept, state, settings, callback)
        result = state.result()
        if result is None:  # pragma: no cover - steps >= 1 has seen at least one value
            msg = "the fit saw no value"
            raise FitError(msg)
        result = replace(
            result, diagnosis=judged(views, params, bounds, result, seed), psnr=nearness(views, result.image)
        )
        _release(kept)  # here, since Ctrl-C in a `finally` would take the result with it
        return result
    except KeyboardInterrupt:
        lost = ""
        try:
            _save(kept, state if callback is None else called, settings, callback)
        except FitError as error:
            lost = str(error)
        finally:
            _release(kept)
        raise FitInterruptedError(state.result(), lost) from None
    except BaseException:
        _release(kept)
        raise


def _own(params: Parameters, images: Images) -> tuple[Parameters, Images]:
    """What a callback may write to: the fit goes on from its own."""
    each = {name: copied(image) for name, image in by_view(images).items()}
    return {name: copied(value) for name, value in params.items()}, as_given(each)


def _beginning(descent: Descent, params: Parameters, rates: Mapping[str, float]) -> State:
    """The state before the first step."""
    memory = descent.optimiser.start({name: params[name] for name in descent.bounds.lower})
    return State(params, memory, rates=rates, schedule=FarToNear(descent.views.stages, descent.steps))


def _lap(descent: Descent) -> Callable[[Parameters, int, int], tuple[float, Parameters]]:
    """What runs a lap of a race: from a start, some steps of one stage, to where they lead."""

    def run(start: Parameters, stage: int, steps: int) -> tuple[float, Parameters]:
        short = replace(descent, views=descent.views.at(stage), decay="none")  # early in the fit, not a fit of its own
        rates = measured_rates(short.views, start, descent.bounds, descent.asked, steps, descent.seed)
        state = _beginning(short, start, rates)
        while state.step < steps:
            state, *_ = short.step(state)
        best = short.finished(state, start).best
        if best is None:  # pragma: no cover - a step has seen at least one value
            return math.inf, start
        return descent.views.value(best.params, descent.views.placing, descent.seed + best.step), best.params

    return run


def _release(kept: CheckpointFile | None) -> None:
    if kept is not None:
        kept.release()


def _begin(kept: CheckpointFile | None, state: State) -> None:
    if kept is not None:
        with keeping(state, "removing the checkpoint of an earlier fit"):
            kept.begin()


def _save(kept: CheckpointFile | None, state: State, settings: Mapping[str, str], callback: Callback | None) -> None:
    if kept is not None and state.best is not None:
        with keeping(state, "writing the checkpoint"):
            memory = callback.memory() if isinstance(callback, RememberingCallback) else {}
            kept.save(state, settings, memory)


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


def _checkpoints(checkpoint: object, *, resume: object) -> CheckpointFile | None:
    if checkpoint is None:
        if resume:
            msg = f"`resume` must be False without a `checkpoint` to go on from, got {shown(resume)}"
            raise OptionError(msg)
        return None
    if not isinstance(checkpoint, str | os.PathLike) or Path(checkpoint).is_dir():
        msg = f"`checkpoint` must be the path of a file, got {shown(checkpoint)}"
        raise OptionError(msg)
    check_writable("checkpoint", Path(checkpoint).parent)
    return CheckpointFile(Path(checkpoint))

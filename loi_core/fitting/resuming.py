"""From the state of a fit to a checkpoint and back."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from loi_core.errors import ParameterError
from loi_core.fitting.callbacks import RememberingCallback
from loi_core.fitting.checkpoint import Checkpoint
from loi_core.fitting.history import FIRST_COLUMNS, StepLog
from loi_core.fitting.optimiser import Optimiser, require_shapes
from loi_core.fitting.parameters import Bounds, Free
from loi_core.fitting.stages import FarToNear
from loi_core.fitting.state import Best, State
from loi_core.fitting.views import Views, mean
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import from_numpy, to_numpy
from loi_core.support.guards import foreign
from loi_core.support.values import whole_number
from loi_core.support.wording import described

__all__ = ["few_numbers", "resumed", "settings_of", "snapshot"]

RATES: Final = "measured rates"
SCHEDULE: Final = "schedule"
LATEST: Final = "latest values"
BEST: Final = "stage of the best, and whether it is partial"
AGREEING: Final = "starts that agree"


FEW: Final = 64  # numbers: so many free parameters are kept for every step


def settings_of(
    steps: int,
    seed: int,
    decay: str,
    rates: Mapping[str, float | str],
    free: Mapping[str, Free],
    starts: int,
    bounds: Bounds,
    views: Views,
    optimiser: str,
) -> dict[str, str]:
    """What must be the same for a fit to go on as if it had not stopped, by name.

    `rates` are those that were asked for, in a parameter's own unit or as text in pixels. A start counts if it was
    given: the renderer's own may be where an earlier fit has left a scene.
    """
    given = {name: np.asarray(to_numpy(one.initial)).tolist() for name, one in free.items() if one.initial is not None}
    limits = {name: [to_numpy(side[name]).tolist() for side in (bounds.lower, bounds.upper)] for name in rates}
    return {
        "steps": str(steps),
        "seed": str(seed),
        "decay": decay,
        "learning rates": json.dumps(dict(rates)),
        "start": _digest(given),
        "starts": str(starts),
        "bounds": _digest(limits),
        "stages": f"{views.stages}, the last of them to finish" if views.finish else str(views.stages),
        "views": json.dumps([*views.each, views.at_once]),
        "optimiser": optimiser,
    }


def _digest(value: object) -> str:
    return f"sha256 {hashlib.sha256(json.dumps(value).encode()).hexdigest()[:12]}"


def few_numbers(params: Parameters, names: Iterable[str]) -> dict[str, np.ndarray[Any, Any]]:
    """The free parameters as NumPy, in float64; none if they are more than 64 numbers together."""
    free = {name: params[name] for name in names}
    if sum(math.prod(one.shape) for one in free.values()) > FEW:
        return {}
    return {name: np.array(to_numpy(one), dtype=np.float64) for name, one in free.items()}


def snapshot(state: State, best: Best, settings: Mapping[str, str], callback: object = None) -> Checkpoint:
    """A state, the best that it has seen, and what the callback remembers, for a file."""

    def host(params: Parameters) -> dict[str, np.ndarray[Any, Any]]:
        return {name: np.asarray(to_numpy(value)) for name, value in params.items()}

    return Checkpoint(
        settings={
            **settings,
            RATES: json.dumps(dict(state.rates)),
            SCHEDULE: state.schedule.state(),
            LATEST: json.dumps(dict(state.latest)),
            BEST: json.dumps([best.stage, best.partial]),
            AGREEING: json.dumps(state.agreeing),
        },
        step=state.step,
        best_step=best.step,
        best_value=best.value,
        params=host(state.params),
        memory=host(dict(state.memory)),
        best_params=host(best.params),
        history=state.history.rows,
        callback=callback.memory() if isinstance(callback, RememberingCallback) else {},
    )


def resumed(
    saved: Checkpoint, fresh: State, views: Views, optimiser: Optimiser, free: Iterable[str], seed: int
) -> State:
    """The state that was saved, with arrays like those of a fit that has not begun.

    Raises
    ------
    ParameterError
        If it was saved by a fit with other parameters, or of another objective, reference or scene.
    """

    def live(stored: Mapping[str, Any], like: Parameters, what: str) -> Parameters:
        require_shapes(stored, like, f"{what} than this fit has")
        return {name: from_numpy(value, like[name]) for name, value in stored.items()}

    params, moving = live(saved.params, fresh.params, "parameters"), list(free)
    memory = optimiser.restore({name: params[name] for name in moving}, saved.memory)
    for name, value in fresh.params.items():
        if name not in moving and not np.array_equal(saved.params[name], to_numpy(value)):
            msg = f"`checkpoint` was made with another scene: {name!r}, which does not move, differs"
            raise ParameterError(msg)
    best = live(saved.best_params, fresh.params, "parameters")
    with foreign("rendering the best of the checkpoint"):
        images = views.render(best, seed + saved.best_step)
    log = _log(saved, few_numbers(fresh.params, moving))
    stage, partial = _best(saved, views)
    with np.errstate(all="ignore"):  # a file may say anything: what overflows is not the value that was saved
        values = views.values(images, stage)
    value = mean(values)
    # Loosely, since libraries may sum in another order from one run to the next. Where a step renders some views, its
    # value is of other parameters too.
    if views.all_at_once and not math.isclose(value, saved.best_value, rel_tol=1e-4, abs_tol=1e-12):
        msg = (
            f"`checkpoint` was made with another objective, reference or scene: its best value is "
            f"{saved.best_value:.6g}, here the same parameters give {value:.6g}; start without resume"
        )
        raise ParameterError(msg)
    return State(
        params,
        memory,
        saved.step,
        Best(best, saved.best_value, saved.best_step, images, stage, partial),
        log,
        _rates(saved, fresh.rates),
        _schedule(saved, fresh.schedule),
        _latest(saved, views),
        _agreeing(saved),
    )


def _best(saved: Checkpoint, views: Views) -> tuple[int, bool]:
    """The stage that the best parameters are of, and whether their value is partial."""
    try:
        stage, partial = json.loads(saved.settings[BEST])
        if not 0 <= stage < views.stages:
            raise IndexError(stage)
        return int(stage), bool(partial)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        msg = f"`checkpoint` does not say what its best parameters are of ({described(error)}); delete it to start anew"
        raise ParameterError(msg) from error


def _latest(saved: Checkpoint, views: Views) -> dict[str, float]:
    try:
        latest = {str(name): float(value) for name, value in json.loads(saved.settings[LATEST]).items()}
    except (KeyError, ValueError, TypeError, AttributeError):
        return {}
    return {name: value for name, value in latest.items() if name in views.each and math.isfinite(value)}


def _agreeing(saved: Checkpoint) -> int | None:
    try:
        return whole_number(json.loads(saved.settings[AGREEING]))
    except (KeyError, ValueError, RecursionError):
        return None


def _schedule(saved: Checkpoint, fresh: FarToNear) -> FarToNear:
    schedule = fresh.copy()
    try:
        schedule.restore(saved.settings[SCHEDULE], saved.history[:, 1].tolist())
    except (KeyError, ValueError, TypeError) as error:
        msg = f"`checkpoint` does not say which stage it was in ({described(error)}); delete it to start anew"
        raise ParameterError(msg) from error
    return schedule


def _log(saved: Checkpoint, like: Mapping[str, np.ndarray[Any, Any]]) -> StepLog:
    """The history, with the free parameters of every step where they are few."""
    shapes = {name: one.shape for name, one in like.items()}
    if saved.history.shape[1] != FIRST_COLUMNS + sum(one.size for one in like.values()):
        shapes = {}
    log = StepLog(shapes)
    for index, row in enumerate(saved.history):
        log.put_row(index, row if shapes else row[:FIRST_COLUMNS])
    return log


def _rates(saved: Checkpoint, fresh: Mapping[str, float]) -> dict[str, float]:
    """The rates that were measured when the fit began: a renderer's noise may give others now."""
    try:
        rates = {str(name): float(rate) for name, rate in json.loads(saved.settings[RATES]).items()}
    except (KeyError, ValueError, TypeError, AttributeError):
        return dict(fresh)
    usable = rates.keys() == fresh.keys() and all(0.0 < rate < math.inf for rate in rates.values())
    return rates if usable else dict(fresh)

"""From the state of a fit to a checkpoint and back."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from loi_core.errors import ParameterError
from loi_core.fitting.adam import Moments
from loi_core.fitting.checkpoint import Checkpoint
from loi_core.fitting.parameters import Bounds
from loi_core.fitting.state import Best, FitStep, State
from loi_core.objectives.base import Objective
from loi_core.renderers.contract import Parameters, Renderer
from loi_core.support.arrays import detached, from_numpy, to_numpy

__all__ = ["resumed", "settings_of", "snapshot"]


def settings_of(steps: int, seed: int, decay: str, rates: Mapping[str, float], bounds: Bounds) -> dict[str, str]:
    """What must be the same for a fit to go on as if it had not stopped, by name."""
    limits = {name: [to_numpy(side[name]).tolist() for side in (bounds.lower, bounds.upper)] for name in rates}
    return {
        "steps": str(steps),
        "seed": str(seed),
        "decay": decay,
        "learning rates": json.dumps(dict(rates)),
        "bounds": hashlib.sha256(json.dumps(limits).encode()).hexdigest()[:12],
    }


def snapshot(state: State, best: Best, settings: Mapping[str, str]) -> Checkpoint:
    """A state, and the best that it has seen, for a file."""

    def host(params: Parameters) -> dict[str, np.ndarray[Any, Any]]:
        return {name: np.asarray(to_numpy(value)) for name, value in params.items()}

    rows = [(one.step, one.value, one.gradient_norm, one.rate, one.seconds) for one in state.history]
    return Checkpoint(
        settings=settings,
        step=state.step,
        count=state.moments.count,
        best_step=best.step,
        best_value=best.value,
        params=host(state.params),
        first=host(state.moments.first),
        second=host(state.moments.second),
        best_params=host(best.params),
        history=np.asarray(rows, dtype=np.float64).reshape(-1, 5),
    )


def resumed(saved: Checkpoint, fresh: State, renderer: Renderer, objective: Objective, seed: int) -> State:
    """The state that was saved, with arrays like those of a fit that has not begun.

    Raises
    ------
    ParameterError
        If it was saved by a fit with other parameters, or of another objective, reference or scene.
    """

    def live(stored: Mapping[str, Any], like: Parameters, what: str) -> Parameters:
        if {name: value.shape for name, value in stored.items()} != {
            name: tuple(value.shape) for name, value in like.items()
        }:
            msg = f"`checkpoint` holds other {what} than this fit has; start without resume"
            raise ParameterError(msg)
        return {name: from_numpy(value, like[name]) for name, value in stored.items()}

    params = live(saved.params, fresh.params, "parameters")
    first = live(saved.first, fresh.moments.first, "free parameters")
    second = live(saved.second, fresh.moments.second, "free parameters")
    for name, value in fresh.params.items():
        if name not in first and not np.array_equal(saved.params[name], to_numpy(value)):
            msg = f"`checkpoint` was made with another scene: {name!r}, which does not move, differs"
            raise ParameterError(msg)
    best = live(saved.best_params, fresh.params, "parameters")
    image = detached(renderer.render(best, seed=seed + saved.best_step))
    value = float(detached(objective.value(image)))
    # Loosely, since libraries may sum in another order from one run to the next.
    if not math.isclose(value, saved.best_value, rel_tol=1e-4, abs_tol=1e-12):
        msg = (
            f"`checkpoint` was made with another objective, reference or scene: its best value is "
            f"{saved.best_value:.6g}, here the same parameters give {value:.6g}; start without resume"
        )
        raise ParameterError(msg)
    return State(
        params,
        Moments(first, second, saved.count),
        saved.step,
        Best(best, saved.best_value, saved.best_step, image),
        [FitStep(int(row[0]), *map(float, row[1:])) for row in saved.history],
    )

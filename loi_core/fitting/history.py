"""The steps of a fit, and their table of numbers in a checkpoint."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Host, to_numpy

__all__ = ["FitStep", "rows_of", "small_parameters", "steps_of"]

COLUMNS: Final = 6  # step, value, gradient norm, rate, seconds, stage; then the free parameters, if they are recorded
MAX_NUMBERS: Final = 64  # free parameters of at most this size in total are recorded at every step


@dataclass(frozen=True, slots=True)
class FitStep:
    """One step of a fit, evaluated before the parameters moved.

    Attributes
    ----------
    step : int
        Counted from 0.
    value : float
        The objective.
    gradient_norm : float
        Euclidean norm of the gradient with respect to the free parameters.
    rate : float
        Fraction of the learning rate that the step used.
    seconds : float
        Duration of the step.
    stage : int
        Index of the objective, from far to near; 0 if there is only one.
    params : dict of arrays
        The free parameters, as NumPy arrays; empty if they have more than 64 numbers in total.
    """

    step: int
    value: float
    gradient_norm: float
    rate: float
    seconds: float
    stage: int = 0
    params: Mapping[str, Host] = field(default_factory=dict)


def small_parameters(params: Parameters, names: Iterable[str]) -> dict[str, np.ndarray[Any, Any]]:
    """Return the named parameters as float64 NumPy arrays; none if they have more than 64 numbers in total."""
    free = {name: params[name] for name in names}
    if sum(math.prod(value.shape) for value in free.values()) > MAX_NUMBERS:
        return {}
    return {name: np.array(to_numpy(value), dtype=np.float64) for name, value in free.items()}


def rows_of(history: Sequence[FitStep]) -> Host:
    """Return the history as float64 rows, shape (steps, 6 + numbers of the recorded parameters)."""
    rows = [
        [step.step, step.value, step.gradient_norm, step.rate, step.seconds, step.stage]
        + [number for value in step.params.values() for number in value.ravel().tolist()]
        for step in history
    ]
    return np.array(rows, dtype=np.float64) if rows else np.zeros((0, COLUMNS))


def steps_of(rows: Host, shapes: Mapping[str, tuple[int, ...]]) -> list[FitStep]:
    """Return the history that :func:`rows_of` has written, with recorded parameters of these shapes.

    Raises
    ------
    ValueError
        If the rows have another number of columns.
    """
    sizes = [math.prod(shape) for shape in shapes.values()]
    if rows.ndim != 2 or rows.shape[1] != COLUMNS + sum(sizes):
        msg = f"its history has shape {rows.shape}"
        raise ValueError(msg)
    history = []
    for row in rows:
        flat = np.split(row[COLUMNS:], np.cumsum(sizes, dtype=int)[:-1])
        params = {name: value.reshape(shape) for (name, shape), value in zip(shapes.items(), flat, strict=False)}
        value, norm, rate, seconds = map(float, row[1:5])
        history.append(FitStep(int(row[0]), value, norm, rate, seconds, int(row[5]), params))
    return history

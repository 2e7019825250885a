"""The stability table: every hard case on every backend, beside the plain sum in float64."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from loi_core.plugins.measurement_backends import MeasurementBackend
from loi_core.stability.case import HardCase
from loi_core.stability.rules import STABILITY_CHECKS, distance
from loi_core.stability.trial import Answer, Trial, dtypes_of, try_case
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import described

__all__ = ["Progress", "StabilityRow", "stability_rows"]

LOOSE_FRACTION: Final = 0.1
"""Fraction of the gradient from which on a bound says little about the gradient, and the row is "loose"."""

Verdict: TypeAlias = Literal["ok", "loose", "refused", "unsupported", "FAILED"]

Progress: TypeAlias = Callable[[int, str], None]
"""Called as ``progress(total, name)`` before each of `total` trials."""


@dataclass(frozen=True)
class StabilityRow:
    """One line of the stability table.

    Attributes
    ----------
    case, backend, dtype : str
    verdict : {"ok", "loose", "refused", "unsupported", "FAILED"}
        "loose": all rules are kept, but the bound on the gradient is not small beside the gradient; "refused": the
        error that the case must raise; "unsupported": the backend has no such arrays.
    loss : float
        NaN, like all numbers, if there is none.
    loss_error, loss_bound : float
        Difference from the plain sum in float64, and its bound.
    gradient_size, gradient_error, gradient_bound : float
        1-norms, over all pixels.
    detail : str
        The broken rules, or a remark, in one line.
    """

    case: str
    backend: str
    dtype: str
    verdict: Verdict
    loss: float = math.nan
    loss_error: float = math.nan
    loss_bound: float = math.nan
    gradient_size: float = math.nan
    gradient_error: float = math.nan
    gradient_bound: float = math.nan
    detail: str = ""

    @classmethod
    def of(cls, trial: Trial) -> StabilityRow:
        """Return the row of a trial."""
        name, backend, dtype = trial.case.name, trial.backend, trial.dtype
        answer, expected = trial.answer, trial.expected
        if trial.unsupported:
            return cls(name, backend, dtype, "unsupported", detail=trial.unsupported)
        findings = {check.name: check.finding(trial) for check in STABILITY_CHECKS}
        broken = "; ".join(f"{check}: {finding}" for check, finding in findings.items() if finding)
        if expected is None or not isinstance(answer, Answer):
            detail = broken or (described(answer) if isinstance(answer, Exception) else "")
            return cls(name, backend, dtype, "FAILED" if broken else "refused", detail=detail)
        size, bound = float(np.abs(expected.gradient).sum()), float(expected.gradient_bound.sum())
        is_loose = bound > LOOSE_FRACTION * (size or 1.0)
        remark = "rounding may decide many signs: differences lie near the tie threshold" if is_loose else ""
        return cls(
            name,
            backend,
            dtype,
            "FAILED" if broken else "loose" if is_loose else "ok",
            answer.value,
            abs(answer.value - expected.value),
            expected.loss_bound,
            size,
            distance(answer.gradient, expected.gradient),
            bound,
            broken or remark,
        )


@suggest_keywords
def stability_rows(
    cases: Sequence[HardCase], backends: Mapping[str, MeasurementBackend], progress: Progress | None = None
) -> Iterator[StabilityRow]:
    """Yield the stability table row by row: every case on every backend in every dtype.

    Parameters
    ----------
    cases : sequence of HardCase
        Such as :func:`loi_core.stability.hard_cases`.
    backends : mapping of str to MeasurementBackend
    progress : callable, optional
        Called before each row.
    """
    trials = [
        (case, name, backend, dtype)
        for case in cases
        for name, backend in backends.items()
        for dtype in dtypes_of(case, backend)
    ]
    for case, name, backend, dtype in trials:
        if progress is not None:
            progress(len(trials), f"{case}, {name} {dtype}")
        yield StabilityRow.of(try_case(case, name, backend, dtype))

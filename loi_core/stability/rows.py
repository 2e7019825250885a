"""Runs hard cases on backends and holds what comes back against the plain sum in float64."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

import numpy as np

from loi_core.errors import NonFiniteImageError
from loi_core.plugins.backends import Backend
from loi_core.stability.case import HardCase
from loi_core.stability.trial import Answer, Expected, Trial, epsilon_of, one_line, trials_of, try_case
from loi_core.support.arrays import Host

__all__ = [
    "PROPERTIES",
    "Progress",
    "StabilityProperty",
    "StabilityRow",
    "stability_rows",
]

LOOSE: Final = 0.1
"""From this share of the gradient on, a bound says little about it, and the row says so."""
REORDERED: Final = 16.0
"""Units in the last place of the largest slope by which slopes may differ when images are handled with other ones.

Operations on whole arrays go over the part of all images in which any of them differs from its reference, and products
of matrices add in an order that depends on their size.
"""

Verdict: TypeAlias = Literal["ok", "loose", "refused", "not held", "FAILED"]

Progress: TypeAlias = Callable[[int, str], None]
"""Called as ``progress(total, what)`` before each of `total` trials."""


@dataclass(frozen=True)
class StabilityProperty:
    """Something that holds for every case.

    Attributes
    ----------
    name : str
    rule : str
        What must hold, in a sentence.
    test : callable
        From a trial to one line on how the rule was broken; empty if it was kept, or does not apply.
    """

    name: str
    rule: str
    test: Callable[[Trial], str]

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class StabilityRow:
    """One line of the stability table.

    Attributes
    ----------
    case, backend, dtype : str
    verdict : {"ok", "loose", "refused", "not held", "FAILED"}
        "loose": all rules were kept, but the bound on the gradient is not small beside the gradient; "refused": the
        error that the case asks for; "not held": the backend has no such arrays.
    loss : float
        NaN, like all numbers, if there is none.
    loss_error, loss_bound : float
        Beside the plain sum in float64.
    gradient_size, gradient_error, gradient_bound : float
        1-norms, over all pixels.
    detail : str
        One line: which rules were broken and how, or what there is to know.
    """

    case: str
    backend: str
    dtype: str
    verdict: Verdict
    loss: float = field(default=math.nan)
    loss_error: float = field(default=math.nan)
    loss_bound: float = field(default=math.nan)
    gradient_size: float = field(default=math.nan)
    gradient_error: float = field(default=math.nan)
    gradient_bound: float = field(default=math.nan)
    detail: str = ""

    @classmethod
    def of(cls, trial: Trial) -> StabilityRow:
        """The line that says what a trial has shown."""
        name, backend, dtype = trial.case.name, trial.backend, trial.dtype
        if trial.not_held:
            return cls(name, backend, dtype, "not held", detail=trial.not_held)
        broken = [f"{one.name}: {finding}" for one in PROPERTIES if (finding := one.test(trial))]
        if trial.expected is None:
            detail = "; ".join(broken) or one_line(trial.answer)
            return cls(name, backend, dtype, "FAILED" if broken else "refused", detail=detail)
        wanted = trial.expected
        size, bound = float(np.abs(wanted.gradient).sum()), float(wanted.gradient_bound.sum())
        loose = bound > LOOSE * (size or 1.0)
        detail = "rounding may decide many signs: differences lie near the tie threshold" if loose else ""
        verdict: Verdict = "FAILED" if broken else "loose" if loose else "ok"
        if isinstance(trial.answer, Exception):
            return cls(name, backend, dtype, verdict, detail="; ".join(broken))
        return cls(
            name,
            backend,
            dtype,
            verdict,
            trial.answer.value,
            abs(trial.answer.value - wanted.value),
            wanted.loss_bound,
            size,
            _distance(trial.answer.gradient, wanted.gradient),
            bound,
            "; ".join(broken) or detail,
        )


def stability_rows(
    cases: Sequence[HardCase], backends: Mapping[str, Backend], progress: Progress | None = None
) -> Iterator[StabilityRow]:
    """The stability table, line by line: every case on every backend in every dtype.

    Parameters
    ----------
    cases : sequence of HardCase
        Such as :func:`loi_core.stability.hard_cases`.
    backends : mapping of str to Backend
    progress : callable, optional
        Called before each line.
    """
    plan = [
        (case, name, backend, dtype)
        for case in cases
        for name, backend in backends.items()
        for dtype in trials_of(case, backend)
    ]
    for case, name, backend, dtype in plan:
        if progress is not None:
            progress(len(plan), f"{case}, {name} {dtype}")
        yield StabilityRow.of(try_case(case, name, backend, dtype))


def _distance(first: Host, second: Host) -> float:
    with np.errstate(invalid="ignore"):
        return float(np.abs(first.astype(np.float64) - second).sum())


def _refused(trial: Trial) -> str:
    error = trial.case.error
    if isinstance(trial.answer, Exception):
        if error is None:
            return f"expected an answer, got {one_line(trial.answer)}"
        return "" if isinstance(trial.answer, error) else f"expected {error.__name__}, got {one_line(trial.answer)}"
    if error is None:
        return ""
    silent = math.isnan(trial.answer.value) and bool(np.all(np.isnan(trial.answer.gradient)))
    if error is NonFiniteImageError and trial.compiled and silent:
        return ""
    return f"expected {error.__name__}, got the value {trial.answer.value:.6g}"


def _answered(test: Callable[[Trial, Expected, Answer], str]) -> Callable[[Trial], str]:
    """A test of answers only: that there is none where there should be is the finding of another."""

    def applied(trial: Trial) -> str:
        if trial.expected is None or isinstance(trial.answer, Exception):
            return ""
        return test(trial, trial.expected, trial.answer)

    return applied


def _finite(_: Trial, __: Expected, answer: Answer) -> str:
    bad = int(np.count_nonzero(~np.isfinite(answer.gradient)))
    if math.isfinite(answer.value) and not bad:
        return ""
    return f"the loss is {answer.value:.6g}, and {bad} entries of the gradient are not finite"


def _non_negative(_: Trial, __: Expected, answer: Answer) -> str:
    return f"the loss is {answer.value:.6g}" if answer.value < 0.0 else ""


def _zero_at_reference(trial: Trial, _: Expected, __: Answer) -> str:
    there = trial.at_reference
    if there is None:
        return ""
    if isinstance(there, Exception):
        return one_line(there)
    slopes = int(np.count_nonzero(there.gradient))
    return "" if there.value == 0.0 and not slopes else f"the loss is {there.value:.3g}, with {slopes} slopes"


def _within_loss_bound(_: Trial, wanted: Expected, answer: Answer) -> str:
    error = abs(answer.value - wanted.value)
    return "" if error <= wanted.loss_bound else f"off by {error:.3g}, allowed {wanted.loss_bound:.3g}"


def _within_gradient_bound(_: Trial, wanted: Expected, answer: Answer) -> str:
    if answer.gradient.shape != wanted.gradient.shape:
        return f"expected the shape {wanted.gradient.shape}, got {answer.gradient.shape}"
    error, bound = _distance(answer.gradient, wanted.gradient), float(wanted.gradient_bound.sum())
    return "" if error <= bound else f"off by {error:.3g} in the 1-norm, allowed {bound:.3g}"


def _still(_: Trial, wanted: Expected, answer: Answer) -> str:
    reference = np.broadcast_to(wanted.reference, wanted.image.shape)
    fixed = ~np.isfinite(wanted.image) | ~np.isfinite(reference)
    fixed |= (wanted.gradient == 0.0) & (wanted.gradient_bound == 0.0)
    moved = int(np.count_nonzero(answer.gradient[fixed]))
    return f"{moved} of {int(fixed.sum())} pixels that nothing asks to change have a gradient" if moved else ""


def _inwards(trial: Trial, wanted: Expected, answer: Answer) -> str:
    low, high = trial.case.scales.bounds
    outwards = ((wanted.image < low) & (answer.gradient > 0.0)) | ((wanted.image > high) & (answer.gradient < 0.0))
    count = int(np.count_nonzero(outwards))
    return f"{count} pixels beyond the bounds are driven further out" if count else ""


def _apart(trial: Trial, wanted: Expected, answer: Answer) -> str:
    found = [one for one in (*trial.members, *trial.replaced) if isinstance(one, Exception)]
    if found:
        return one_line(found[0])
    for index, other in enumerate(trial.replaced):
        if isinstance(other, Answer):
            before, after = answer.gradient[index], other.gradient[index]
            allowed = REORDERED * epsilon_of(trial.dtype) * float(np.abs(before).max())
            if not float(np.abs(after - before).max()) <= allowed:  # NaN is no small change
                return f"the gradient of image {index} changed when the others were replaced"
    alone = [one.value for one in trial.members if isinstance(one, Answer)]
    if alone and abs(sum(alone) / len(alone) - answer.value) > 2.0 * wanted.loss_bound:
        return f"the loss is {answer.value:.9g}, the mean of those of its images {sum(alone) / len(alone):.9g}"
    return ""


PROPERTIES: Final = (
    StabilityProperty("answered", "there is an answer, or the error that the case asks for", _refused),
    StabilityProperty("finite", "the loss and its gradient are finite", _answered(_finite)),
    StabilityProperty("not negative", "the loss is 0 or more", _answered(_non_negative)),
    StabilityProperty("zero", "equal images have a loss and a gradient of exactly 0", _answered(_zero_at_reference)),
    StabilityProperty("loss", "the loss is the plain sum's, within the bound", _answered(_within_loss_bound)),
    StabilityProperty(
        "gradient", "the gradient is the plain sum's, within the bound", _answered(_within_gradient_bound)
    ),
    StabilityProperty("still", "what nothing can change has a gradient of exactly 0", _answered(_still)),
    StabilityProperty("inwards", "a pixel beyond the bounds is never driven further out", _answered(_inwards)),
    StabilityProperty("apart", "images of a batch do not feel each other", _answered(_apart)),
    StabilityProperty("untouched", "the caller's image is not written to", lambda t: "it was" if t.written else ""),
)
"""What is asked of every hard case, each a `StabilityProperty`."""
"""What :class:`StabilityRow` checks of every trial."""

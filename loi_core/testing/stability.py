"""Runs hard cases on backends and holds what comes back against the plain sum in float64."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

import numpy as np

from loi_core.arrays import to_numpy
from loi_core.backends import BFLOAT16_PRODUCTS, Backend
from loi_core.errors import NonFiniteImageError
from loi_core.objectives import LOIObjective
from loi_core.testing.bounds import allowed
from loi_core.testing.cases import HardCase
from loi_core.testing.checks import Host, same
from loi_core.testing.direct import direct

__all__ = [
    "PROPERTIES",
    "Expected",
    "Progress",
    "StabilityProperty",
    "StabilityRow",
    "Trial",
    "expected",
    "stability_rows",
    "trials_of",
    "try_case",
]

LOOSE: Final = 0.1
"""From this share of the gradient on, a bound says little about it, and the row says so."""

HALVES: Final = {"float16": (2.0**-10, 2.0**-24), "bfloat16": (2.0**-7, 2.0**-133)}
"""Machine epsilon and smallest step of the dtypes of 16 bits."""

Verdict: TypeAlias = Literal["ok", "loose", "refused", "not held", "FAILED"]

Progress: TypeAlias = Callable[[int, str], None]
"""Called as ``progress(total, what)`` before each of `total` trials."""


@dataclass(frozen=True)
class Expected:
    """What a case must give in one dtype.

    Attributes
    ----------
    image, reference : array
        As the backend sees them.
    value : float
        The loss, by the plain sum with the tie rule of that dtype.
    gradient : array
        Its gradient by the image, likewise.
    loss_bound : float
        By how much the loss may be off.
    gradient_bound : array
        By how much the gradient may be off, by pixel.
    """

    image: Host
    reference: Host
    value: float
    gradient: Host
    loss_bound: float
    gradient_bound: Host


@dataclass(frozen=True)
class Answer:
    """A loss and its gradient."""

    value: float
    gradient: Host


@dataclass(frozen=True)
class Trial:
    """A case on a backend in one dtype, and what came of it.

    Attributes
    ----------
    case : HardCase
    backend : str
    dtype : str
        Of the image.
    expected : Expected or None
        None if the case must be refused.
    answer : Answer or Exception
        At the case's image.
    at_reference : Answer, Exception or None
        At the reference itself; None if that was not tried.
    members : tuple of Answer or Exception
        For batches: at each image of the batch alone.
    replaced : tuple of Answer or Exception
        For batches: with all images but the one of that index replaced.
    written : bool
        Whether the caller's image was changed.
    compiled : bool
        Whether the backend cannot raise for bad pixels, and gives NaN instead.
    not_held : str
        Why the backend has no such array; empty if it has.
    """

    case: HardCase
    backend: str
    dtype: str
    expected: Expected | None
    answer: Answer | Exception
    at_reference: Answer | Exception | None = None
    members: tuple[Answer | Exception, ...] = ()
    replaced: tuple[Answer | Exception, ...] = ()
    written: bool = False
    compiled: bool = False
    not_held: str = ""


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
            detail = "; ".join(broken) or _one_line(trial.answer)
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


@functools.lru_cache(maxsize=256)
def expected(case: HardCase, dtype: str) -> Expected:
    """What `case` must give in `dtype`, whichever backend computes it; kept for the next backend."""
    image, reference = _given(case, dtype)
    eps = float(np.finfo("float32" if dtype in HALVES else dtype).eps)
    value, gradient = direct(image, reference, case.scales, eps=eps)
    bounds = allowed(image, reference, case.scales, eps)
    loss, slopes = bounds.loss, bounds.gradient
    if dtype in HALVES:
        rounding, step = HALVES[dtype]
        loss += 0.5 * (rounding * (abs(value) + loss) + step)
        slopes = slopes + 0.5 * (rounding * (np.abs(gradient) + slopes) + step)
    return Expected(image, reference, value, gradient, loss, slopes)


def trials_of(case: HardCase, backend: Backend) -> tuple[str, ...]:
    """The dtypes in which `case` is tried on `backend`."""
    if case.layout is not None:
        return backend.dtypes[:1]
    dtypes = (dtype for dtype in backend.dtypes if dtype != BFLOAT16_PRODUCTS)  # those are as coarse as they say
    return (*dtypes, *(backend.half_dtypes if case.half else ()))


def try_case(case: HardCase, name: str, backend: Backend, dtype: str) -> Trial:
    """Run `case` on the backend called `name`."""
    if case.layout is not None:
        return _try_layout(case, name, backend, dtype)
    image, reference = _given(case, dtype)
    answer = _answer(case, backend, dtype, image, reference)
    if case.error is not None:
        return Trial(case, name, dtype, None, answer, compiled=backend.compiled)
    members: list[Answer | Exception] = []
    replaced: list[Answer | Exception] = []
    if image.ndim == 4:
        for index in range(len(image)):
            own = reference[index] if reference.ndim == 4 else reference
            members.append(_answer(case, backend, dtype, image[index], own))
            others = np.full_like(image, np.nan) if case.nan_policy == "mask" else 0.5 * image
            others[index] = image[index]
            replaced.append(_answer(case, backend, dtype, others, reference))
    first = dtype == backend.dtypes[0]  # once is enough: what compiles for each case takes seconds
    there = _answer(case, backend, dtype, np.broadcast_to(reference, image.shape), reference) if first else None
    return Trial(
        case,
        name,
        dtype,
        expected(case, dtype),
        answer,
        there,
        tuple(members),
        tuple(replaced),
    )


def stability_rows(
    cases: Sequence[HardCase], backends: Mapping[str, Backend], progress: Progress | None = None
) -> Iterator[StabilityRow]:
    """The stability table, line by line: every case on every backend in every dtype.

    Parameters
    ----------
    cases : sequence of HardCase
        Such as :func:`loi_core.testing.hard_cases`.
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


def _given(case: HardCase, dtype: str) -> tuple[Host, Host]:
    """Image and reference as a backend sees them: in `dtype`, or what it holds in float32."""
    with np.errstate(under="ignore"):  # what is too small for a dtype is 0 in it
        image, reference = (_rounded(each, dtype) for each in case.make())
    return (image if case.layout is None else case.layout(image)), reference


def _rounded(image: Host, dtype: str) -> Host:
    if dtype != "bfloat16":
        return image.astype(dtype).astype("float32" if dtype in HALVES else dtype)
    # NumPy has no bfloat16, which is the upper half of a float32: add half of what is cut off, ties to even.
    bits = image.astype(np.float32).view(np.uint32)
    rounded = (bits + (0x7FFF + ((bits >> 16) & 1)).astype(np.uint32)) & np.uint32(0xFFFF0000)
    return np.where(np.isfinite(image), rounded.view(np.float32), image).astype(np.float32)


def _answer(case: HardCase, backend: Backend, dtype: str, image: Host, reference: Host) -> Answer | Exception:
    try:
        evaluate = backend.prepare(image, reference, case.scales, "exact", dtype, case.nan_policy)
        return Answer(*evaluate())
    except Exception as error:  # noqa: BLE001 - a backend may raise anything; the row says what
        return error


def _try_layout(case: HardCase, name: str, backend: Backend, dtype: str) -> Trial:
    """The core itself on an array of the backend's library, since what matters is how the array is held."""
    image, reference = _given(case, dtype)
    wanted = None if case.error is not None else expected(case, dtype)
    kept = image.copy()
    try:
        held = backend.asarray(image)
    except (TypeError, ValueError) as error:
        return Trial(case, name, str(image.dtype), wanted, error, not_held=_one_line(error))
    if isinstance(image, np.ma.MaskedArray) and not isinstance(held, np.ma.MaskedArray):
        lost = TypeError("its arrays have no mask, so it is gone before the loss sees them")
        return Trial(case, name, str(image.dtype), wanted, lost, not_held=str(lost))
    answer: Answer | Exception
    try:
        value, gradient = LOIObjective(reference, case.scales).value_and_grad(held)
        answer = Answer(float(value), to_numpy(gradient))
    except Exception as error:  # noqa: BLE001 - as above
        answer = error
    written = not np.array_equal(kept, image)
    return Trial(case, name, str(image.dtype), wanted, answer, written=written)


def _one_line(error: object) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split()) if isinstance(error, Exception) else ""


def _distance(first: Host, second: Host) -> float:
    with np.errstate(invalid="ignore"):
        return float(np.abs(first.astype(np.float64) - second).sum())


def _refused(trial: Trial) -> str:
    error = trial.case.error
    if isinstance(trial.answer, Exception):
        if error is None:
            return f"expected an answer, got {_one_line(trial.answer)}"
        return "" if isinstance(trial.answer, error) else f"expected {error.__name__}, got {_one_line(trial.answer)}"
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
        return _one_line(there)
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
        return _one_line(found[0])
    for index, other in enumerate(trial.replaced):
        if isinstance(other, Answer) and not same(other.gradient[index], answer.gradient[index]):
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
"""What :class:`StabilityRow` checks of every trial."""

"""One hard case on one backend: what it must give, and what it gave."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.method.reference import loss_and_gradient
from loi_core.objectives import LOIObjective
from loi_core.plugins.backends import BFLOAT16_PRODUCTS, Backend, Request
from loi_core.stability.bounds import allowed
from loi_core.stability.case import HardCase
from loi_core.support.arrays import Host, to_numpy

__all__ = ["Answer", "Expected", "Trial", "epsilon_of", "expected", "one_line", "trials_of", "try_case"]

HALVES: Final = {"float16": (2.0**-10, 2.0**-24), "bfloat16": (2.0**-7, 2.0**-133)}
"""Machine epsilon and smallest step of the dtypes of 16 bits."""


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


@functools.lru_cache(maxsize=256)
def expected(case: HardCase, dtype: str) -> Expected:
    """What `case` must give in `dtype`, whichever backend computes it; kept for the next backend."""
    image, reference = _given(case, dtype)
    eps = float(np.finfo("float32" if dtype in HALVES else dtype).eps)
    value, gradient = loss_and_gradient(image, reference, case.scales, eps=eps)
    bounds = allowed(image, reference, case.scales, eps)
    loss, slopes = bounds.loss, bounds.gradient
    if dtype in HALVES:
        rounding, step = HALVES[dtype]
        loss += 0.5 * (rounding * (abs(value) + loss) + step)
        slopes = slopes + 0.5 * (rounding * (np.abs(gradient) + slopes) + step)
    return Expected(image, reference, value, gradient, loss, slopes)


def epsilon_of(dtype: str) -> float:
    """Machine epsilon of a dtype, those of 16 bits included."""
    return HALVES[dtype][0] if dtype in HALVES else float(np.finfo(dtype).eps)


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
        evaluate = backend.prepare(Request(image, reference, case.scales, "exact", dtype, case.nan_policy))
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
        return Trial(case, name, str(image.dtype), wanted, error, not_held=one_line(error))
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


def one_line(error: object) -> str:
    """An exception as one line; nothing for anything else."""
    return " ".join(f"{type(error).__name__}: {error}".split()) if isinstance(error, Exception) else ""

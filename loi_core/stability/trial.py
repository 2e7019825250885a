"""A trial: one hard case on one backend in one dtype, with the expected result."""

from __future__ import annotations

import functools
import warnings
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from loi_core.method.reference import loss_and_gradient
from loi_core.objectives import LOIObjective, RangeWarning
from loi_core.plugins.measurement_backends import BFLOAT16_PRODUCTS, MeasurementBackend, Request
from loi_core.stability.bounds import allowed
from loi_core.stability.case import HardCase
from loi_core.support.arrays import Host, to_numpy
from loi_core.support.wording import described

__all__ = ["Answer", "Expected", "Trial", "dtypes_of", "epsilon_of", "try_case"]

HALF_PRECISION: Final = {"float16": (2.0**-10, 2.0**-24), "bfloat16": (2.0**-7, 2.0**-133)}
"""Machine epsilon and smallest positive number of the dtypes of 16 bits."""


@dataclass(frozen=True)
class Answer:
    """A loss and its gradient."""

    value: float
    gradient: Host


Outcome: TypeAlias = Answer | Exception


@dataclass(frozen=True)
class Expected(Answer):
    """The result of the plain sum in float64, with the tie rule of one dtype.

    Attributes
    ----------
    image, reference : array
        As the backend sees them.
    loss_bound : float
        Largest error of the loss.
    gradient_bound : array
        Largest error of the gradient, for each pixel.
    """

    image: Host
    reference: Host
    loss_bound: float
    gradient_bound: Host


@dataclass(frozen=True)
class Trial:
    """A hard case on a backend in one dtype, and the results.

    Attributes
    ----------
    case : HardCase
    backend, dtype : str
        The dtype is the image's.
    expected : Expected, optional
        None if the case must raise an error.
    answer : Answer or Exception
        At the case's image.
    at_reference : Answer or Exception, optional
        At the reference itself; None if that was not tried.
    members : tuple of Answer or Exception
        For batches: at each image of the batch alone.
    replaced : tuple of Answer or Exception
        For batches: with all images replaced except the image of that index.
    modified : bool
        Whether the caller's image was written to.
    compiled : bool
        Whether the backend returns NaN for bad pixels because it cannot raise an error.
    unsupported : str
        The reason why the backend has no such array; empty if it has.
    """

    case: HardCase
    backend: str
    dtype: str
    expected: Expected | None
    answer: Outcome
    at_reference: Outcome | None = None
    members: tuple[Outcome, ...] = ()
    replaced: tuple[Outcome, ...] = ()
    modified: bool = False
    compiled: bool = False
    unsupported: str = ""


def epsilon_of(dtype: str) -> float:
    """Return the machine epsilon of a dtype, which may have 16 bits."""
    return HALF_PRECISION[dtype][0] if dtype in HALF_PRECISION else float(np.finfo(dtype).eps)


def dtypes_of(case: HardCase, backend: MeasurementBackend) -> tuple[str, ...]:
    """Return the dtypes of the trials of `case` on `backend`."""
    if case.layout is not None:
        return backend.dtypes[:1]
    dtypes = (dtype for dtype in backend.dtypes if dtype != BFLOAT16_PRODUCTS)  # less precise than their dtype
    return (*dtypes, *(backend.half_dtypes if case.half else ()))


def try_case(case: HardCase, name: str, backend: MeasurementBackend, dtype: str) -> Trial:
    """Evaluate `case` on the backend called `name`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RangeWarning)  # wide scales are among the cases
        return _try_case(case, name, backend, dtype)


def _try_case(case: HardCase, name: str, backend: MeasurementBackend, dtype: str) -> Trial:
    if case.layout is not None:
        return _try_layout(case, name, backend, dtype)
    image, reference = _rounded_pair(case, dtype)
    evaluate = functools.partial(_evaluate, case, backend, dtype)
    answer = evaluate(image, reference)
    if case.error is not None:
        return Trial(case, name, dtype, None, answer, compiled=backend.compiled)
    members: list[Outcome] = []
    replaced: list[Outcome] = []
    for index in range(len(image) if image.ndim == 4 else 0):
        members.append(evaluate(image[index], reference[index] if reference.ndim == 4 else reference))
        replacement = np.full_like(image, np.nan) if case.nan_policy == "mask" else 0.5 * image
        replacement[index] = image[index]
        replaced.append(evaluate(replacement, reference))
    at_reference = None
    if dtype == backend.dtypes[0]:  # one dtype is enough: backends that compile each case take seconds
        at_reference = evaluate(np.broadcast_to(reference, image.shape), reference)
    return Trial(case, name, dtype, _expected(case, dtype), answer, at_reference, tuple(members), tuple(replaced))


def _try_layout(case: HardCase, name: str, backend: MeasurementBackend, dtype: str) -> Trial:
    """Evaluate the core itself on an array of the backend's library, whose memory layout is the subject of the case."""
    image, reference = _rounded_pair(case, dtype)
    expected = None if case.error is not None else _expected(case, dtype)
    original = image.copy()
    unsupported = ""
    try:
        converted = backend.asarray(image)
    except (TypeError, ValueError) as error:
        unsupported = described(error)
    else:
        if isinstance(image, np.ma.MaskedArray) and not isinstance(converted, np.ma.MaskedArray):
            unsupported = "its arrays have no mask, so the mask is lost before the loss sees them"
    if unsupported:
        return Trial(case, name, str(image.dtype), expected, TypeError(unsupported), unsupported=unsupported)
    answer: Outcome
    try:
        value, gradient = LOIObjective(reference, case.scales).value_and_grad(converted)
        answer = Answer(float(value), to_numpy(gradient))
    except Exception as error:  # noqa: BLE001 - the row reports it
        answer = error
    return Trial(case, name, str(image.dtype), expected, answer, modified=not np.array_equal(original, image))


def _evaluate(case: HardCase, backend: MeasurementBackend, dtype: str, image: Host, reference: Host) -> Outcome:
    try:
        return Answer(*backend.prepare(Request(image, reference, case.scales, "exact", dtype, case.nan_policy))())
    except Exception as error:  # noqa: BLE001 - a backend may raise anything; the row reports it
        return error


@functools.lru_cache(maxsize=256)
def _expected(case: HardCase, dtype: str) -> Expected:
    """Return the expected result in `dtype`; cached for the next backend."""
    image, reference = _rounded_pair(case, dtype)
    eps = float(np.finfo("float32" if dtype in HALF_PRECISION else dtype).eps)
    value, gradient = loss_and_gradient(image, reference, case.scales, eps=eps)
    bounds = allowed(image, reference, case.scales, eps)
    loss, slopes = bounds.loss, bounds.gradient
    if dtype in HALF_PRECISION:
        rounding, step = HALF_PRECISION[dtype]
        loss += 0.5 * (rounding * (abs(value) + loss) + step)
        slopes = slopes + 0.5 * (rounding * (np.abs(gradient) + slopes) + step)
    return Expected(value, gradient, image, reference, loss, slopes)


def _rounded_pair(case: HardCase, dtype: str) -> tuple[Host, Host]:
    """Return image and reference as a backend sees them: in `dtype`, or in float32 for dtypes of 16 bits."""
    with np.errstate(under="ignore"):  # values too small for a dtype become 0
        image, reference = (_rounded(array, dtype) for array in case.make())
    return (image if case.layout is None else case.layout(image)), reference


def _rounded(image: Host, dtype: str) -> Host:
    if dtype != "bfloat16":
        return image.astype(dtype).astype("float32" if dtype in HALF_PRECISION else dtype)
    # NumPy has no bfloat16, which is the upper half of a float32: add half of the lower part, ties to even.
    bits = image.astype(np.float32).view(np.uint32)
    rounded = (bits + (0x7FFF + ((bits >> 16) & 1)).astype(np.uint32)) & np.uint32(0xFFFF0000)
    return np.where(np.isfinite(image), rounded.view(np.float32), image).astype(np.float32)

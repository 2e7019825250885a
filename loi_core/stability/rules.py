"""The rules that every hard case must keep, as checks of the conformance kit."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np

from loi_core.errors import NonFiniteImageError
from loi_core.stability.trial import Answer, Expected, Trial, epsilon_of
from loi_core.support.arrays import Host
from loi_core.support.wording import described
from loi_core.testing.checks import Check

__all__ = ["STABILITY_CHECKS", "distance"]

BATCH_ULPS: Final = 16.0
"""Largest change of slopes when other images of the batch change, in units in the last place of the largest slope.

Operations on whole arrays cover the window in which any image differs from its reference, and matrix products add in an
order that depends on their size.
"""

_Check: TypeAlias = Check[Trial]


def distance(first: Host, second: Host) -> float:
    """Return the 1-norm of the difference, in float64; NaN if an entry of either is not finite."""
    with np.errstate(invalid="ignore"):
        return float(np.abs(first.astype(np.float64) - second).sum())


def _check_answer(check: _Check, trial: Trial) -> None:
    error, answer = trial.case.error, trial.answer
    if error is None:
        if isinstance(answer, Exception):
            check.fail(f"expected a result, got {described(answer)}")
    elif isinstance(answer, Exception):
        if not isinstance(answer, error):
            check.fail(f"expected {error.__name__}, got {described(answer)}")
    else:
        is_nan = math.isnan(answer.value) and bool(np.all(np.isnan(answer.gradient)))
        if not (error is NonFiniteImageError and trial.compiled and is_nan):
            check.fail(f"expected {error.__name__}, got the value {answer.value:.6g}")


def _if_answered(test: Callable[[_Check, Trial, Expected, Answer], None]) -> Callable[[_Check, Trial], None]:
    """Return the test of trials that should have a result and have one; another check reports missing results."""

    def applied(check: _Check, trial: Trial) -> None:
        if trial.expected is not None and not isinstance(trial.answer, Exception):
            test(check, trial, trial.expected, trial.answer)

    return applied


def _check_finite(check: _Check, _: Trial, __: Expected, answer: Answer) -> None:
    bad = int(np.count_nonzero(~np.isfinite(answer.gradient)))
    if bad or not math.isfinite(answer.value):
        check.fail(f"the loss is {answer.value:.6g}, and {bad} entries of the gradient are not finite")


def _check_sign(check: _Check, _: Trial, __: Expected, answer: Answer) -> None:
    if answer.value < 0.0:
        check.fail(f"the loss is {answer.value:.6g}")


def _check_reference(check: _Check, trial: Trial, _: Expected, __: Answer) -> None:
    answer = trial.at_reference
    if isinstance(answer, Exception):
        check.fail(described(answer))
    if answer is not None and (answer.value != 0.0 or np.any(answer.gradient)):
        check.fail(f"the loss is {answer.value:.3g}, with {np.count_nonzero(answer.gradient)} slopes")


def _check_loss(check: _Check, _: Trial, expected: Expected, answer: Answer) -> None:
    error = abs(answer.value - expected.value)
    if not error <= expected.loss_bound:
        check.fail(f"off by {error:.3g}, allowed {expected.loss_bound:.3g}")


def _check_gradient(check: _Check, _: Trial, expected: Expected, answer: Answer) -> None:
    if answer.gradient.shape != expected.gradient.shape:
        check.fail(f"expected the shape {expected.gradient.shape}, got {answer.gradient.shape}")
    error, bound = distance(answer.gradient, expected.gradient), float(expected.gradient_bound.sum())
    if not error <= bound:
        check.fail(f"off by {error:.3g} in the 1-norm, allowed {bound:.3g}")


def _check_fixed_pixels(check: _Check, _: Trial, expected: Expected, answer: Answer) -> None:
    reference = np.broadcast_to(expected.reference, expected.image.shape)
    fixed = ~np.isfinite(expected.image) | ~np.isfinite(reference)
    fixed |= (expected.gradient == 0.0) & (expected.gradient_bound == 0.0)
    moving = int(np.count_nonzero(answer.gradient[fixed]))
    if moving:
        check.fail(f"{moving} of {int(fixed.sum())} pixels that cannot change the loss have a gradient")


def _check_batch(check: _Check, trial: Trial, expected: Expected, answer: Answer) -> None:
    for outcome in (*trial.members, *trial.replaced):
        if isinstance(outcome, Exception):
            check.fail(described(outcome))
    for index, outcome in enumerate(trial.replaced):
        if isinstance(outcome, Answer):
            expected_slopes, slopes = answer.gradient[index], outcome.gradient[index]
            allowed = BATCH_ULPS * epsilon_of(trial.dtype) * float(np.abs(expected_slopes).max())
            if not float(np.abs(slopes - expected_slopes).max()) <= allowed:  # NaN is not a small change
                check.fail(f"the gradient of image {index} changed when the others were replaced")
    values = [outcome.value for outcome in trial.members if isinstance(outcome, Answer)]
    if values and abs(sum(values) / len(values) - answer.value) > 2.0 * expected.loss_bound:
        check.fail(f"the loss is {answer.value:.9g}, the mean over its images {sum(values) / len(values):.9g}")


def _check_unmodified(check: _Check, trial: Trial) -> None:
    if trial.modified:
        check.fail("the image was written to")


STABILITY_CHECKS: Final[tuple[_Check, ...]] = (
    Check("answered", "there is a result, or the error that the case must raise", _check_answer),
    Check("finite", "the loss and its gradient are finite", _if_answered(_check_finite)),
    Check("not negative", "the loss is 0 or more", _if_answered(_check_sign)),
    Check("zero", "equal images have a loss and a gradient of exactly 0", _if_answered(_check_reference)),
    Check("loss", "the loss equals the plain sum within the bound", _if_answered(_check_loss)),
    Check("gradient", "the gradient equals the plain sum's within the bound", _if_answered(_check_gradient)),
    Check(
        "still", "pixels that cannot change the loss have a gradient of exactly 0", _if_answered(_check_fixed_pixels)
    ),
    Check("apart", "images of a batch do not affect each other", _if_answered(_check_batch)),
    Check("untouched", "the caller's image is not written to", _check_unmodified),
)
"""The checks of every hard case, in order, each with a `name` and a `rule`."""

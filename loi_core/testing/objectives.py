"""Checks of the objective interface, :class:`loi_core.Objective`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.errors import ImageTypeError
from loi_core.objectives.base import ImageObjective, Objective
from loi_core.support.arrays import Array, Host, as_floating, epsilon, library_name, same, to_numpy
from loi_core.testing.checks import Check, measure_slopes, run_checks, slope_tolerance

__all__ = ["OBJECTIVE_CHECKS", "ObjectiveSubject", "check_objective"]


@dataclass(frozen=True)
class ObjectiveSubject:
    """A way of making objectives, under test.

    Attributes
    ----------
    make : callable
        ``make(reference)`` gives an objective.
    asarray : callable
        From a NumPy array to one of the library that the objective is to be tested with.
    shape : tuple of int
        Of the images, (H, W, C).
    dtype : str
        Of the images.
    seed : int
        For the random images.
    rtol : float, optional
        Largest relative error of slopes against central differences; by default 5e-4 in float64, 5e-3 in float32.
    """

    make: Callable[[Any], Objective]
    asarray: Callable[[Host], Array] = np.asarray
    shape: tuple[int, ...] = (16, 12, 3)
    dtype: str = "float64"
    seed: int = 0
    rtol: float | None = None

    def images(self) -> tuple[Host, Host]:
        """Two random images, strictly inside [0, 1]."""
        first, second = np.random.default_rng(self.seed).uniform(0.05, 0.95, (2, *self.shape)).astype(self.dtype)
        return first, second


_Check: TypeAlias = Check[ObjectiveSubject]


def check_objective(
    make: Callable[[Any], Objective],
    *,
    asarray: Callable[[Host], Array] = np.asarray,
    shape: tuple[int, ...] = (16, 12, 3),
    dtype: str = "float64",
    seed: int = 0,
    rtol: float | None = None,
    expected_failures: Mapping[str, str] | None = None,
) -> None:
    """Check that what `make` makes is an objective.

    Parameters
    ----------
    make : callable
        ``make(reference)`` gives an objective for this reference image.
    asarray : callable
        Turns a NumPy array into one of the library to test with.
    shape, dtype, seed
        Of the random images.
    rtol : float, optional
        Largest relative error of slopes against central differences; by default 5e-4 in float64, 5e-3 in float32.
    expected_failures : dict of str, optional
        Names of checks that are known to fail, with the reason. One that passes is an error too.

    Raises
    ------
    ConformanceError
        At the first check that fails: its name, what was expected and what came, and the rule.
    """
    run_checks(OBJECTIVE_CHECKS, ObjectiveSubject(make, asarray, shape, dtype, seed, rtol), expected_failures)


def _check_value(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = map(subject.asarray, subject.images())
    value = subject.make(reference).value(image)
    try:
        as_floating("value", value)
    except ImageTypeError as error:
        check.fail(str(error))
    if tuple(value.shape) != ():
        check.fail(f"expected a value of shape (), got {tuple(value.shape)}")
    if library_name(value) != library_name(image) or value.dtype != image.dtype:
        check.fail(f"image is {library_name(image)} {image.dtype}, value {library_name(value)} {value.dtype}")
    if not np.isfinite(float(value)):
        check.fail(f"expected a finite value between two ordinary images, got {float(value)}")


def _check_pair(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = map(subject.asarray, subject.images())
    objective = subject.make(reference)
    alone = float(objective.value(image))
    value, gradient = objective.value_and_grad(image)
    if abs(float(value) - alone) > 1e2 * epsilon(image) * max(abs(alone), 1e-30):
        check.fail(f"value gives {alone:.9g}, value_and_grad {float(value):.9g}")
    if tuple(gradient.shape) != tuple(image.shape):
        check.fail(f"expected a gradient of shape {tuple(image.shape)}, got {tuple(gradient.shape)}")
    if library_name(gradient) != library_name(image) or gradient.dtype != image.dtype:
        check.fail(f"image is {library_name(image)} {image.dtype}, gradient {library_name(gradient)} {gradient.dtype}")
    if not np.all(np.isfinite(to_numpy(gradient))):
        check.fail("the gradient is not finite")


def _check_minimum(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    objective = subject.make(subject.asarray(reference))
    value, gradient = objective.value_and_grad(subject.asarray(reference))
    elsewhere, away = objective.value_and_grad(subject.asarray(image))
    if not float(value) < float(elsewhere):
        check.fail(f"the value at the reference is {float(value):.6g}, at another image {float(elsewhere):.6g}")
    rest, far = float(np.linalg.norm(to_numpy(gradient))), float(np.linalg.norm(to_numpy(away)))
    if rest > 1e-3 * far:
        check.fail(f"the gradient at the reference has norm {rest:.3g}, at another image {far:.3g}")


def _check_differences(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    _check_slopes(check, subject, subject.make(subject.asarray(reference)), image)


def _check_weights(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    weights = np.random.default_rng(subject.seed).uniform(0.2, 1.0, subject.shape[:2])
    weights[0] = 0.0
    weights[-1, -1] = 1.0
    objective = subject.make(subject.asarray(reference))
    if not isinstance(objective, ImageObjective) or not objective.takes_weights:
        return
    make: Callable[..., Objective] = subject.make
    try:
        ways = weights, 2.0 * weights, np.where(weights > 0.0, 1.0, 0.0)
        weighed, doubled, masked = (make(subject.asarray(reference), weights=one) for one in ways)
    except TypeError:
        return  # what makes it takes a reference alone
    value, gradient = weighed.value_and_grad(subject.asarray(image))
    twice = float(doubled.value(subject.asarray(image)))
    if abs(twice - 2.0 * float(value)) > 1e2 * float(np.finfo(subject.dtype).eps) * abs(twice):
        check.fail(f"the value is {float(value):.9g}, and {twice:.9g} with weights that are twice as large")
    if np.any(to_numpy(gradient)[0]):
        check.fail("the gradient is not 0 in pixels of weight 0")
    if float(value) == float(masked.value(subject.asarray(image))):
        check.fail("the value is the same whatever the weights are, if they are not 0")
    _check_slopes(check, subject, weighed, image)


def _check_batch(check: _Check, subject: ObjectiveSubject) -> None:
    """Of what takes batches; others may refuse them."""
    image, reference = subject.images()
    pairs = [(image, reference), (0.5 * (image + reference), image[::-1].copy())]
    images, references = (np.stack(each).astype(image.dtype) for each in zip(*pairs, strict=True))
    try:
        value = float(subject.make(subject.asarray(references)).value(subject.asarray(images)))
    except ValueError:
        return
    each = [float(subject.make(subject.asarray(two)).value(subject.asarray(one))) for one, two in pairs]
    if abs(value - sum(each) / 2.0) > 1e3 * float(np.finfo(subject.dtype).eps) * abs(value):
        check.fail(f"a batch of two gave {value:.6g}, the two alone {each[0]:.6g} and {each[1]:.6g}")


def _check_channels(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    objective = subject.make(subject.asarray(reference))
    for channel in range(image.shape[-1]):
        other = reference.copy()
        other[..., channel] = image[..., channel]
        if float(objective.value(subject.asarray(other))) == float(objective.value(subject.asarray(reference))):
            check.fail(f"the value is the same whatever channel {channel} is")


def _check_slopes(check: _Check, subject: ObjectiveSubject, objective: Objective, image: Host) -> None:
    _, gradient = objective.value_and_grad(subject.asarray(image))

    def value(moved: Host) -> float:
        return float(objective.value(subject.asarray(moved.astype(subject.dtype))))

    coarsest = float(np.finfo(subject.dtype).eps)
    slopes = measure_slopes(
        [value],
        image.astype(np.float64),
        [to_numpy(gradient).astype(np.float64)],
        rounded=lambda moved: moved.astype(subject.dtype).astype(np.float64),
        epsilon=coarsest,
        seed=subject.seed,
    )
    finding = slopes.finding(slope_tolerance(coarsest) if subject.rtol is None else subject.rtol)
    if finding:
        check.fail(finding)


def _check_no_memory(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    objective = subject.make(subject.asarray(reference))
    first, gradient = objective.value_and_grad(subject.asarray(image))
    before = float(first), to_numpy(gradient).copy()
    other = 0.5 * (image + reference)
    if float(objective.value(subject.asarray(other))) == before[0]:
        check.fail("two different images gave the same value to the bit")
    again, second = objective.value_and_grad(subject.asarray(image))
    if float(again) != before[0] or not same(to_numpy(second), before[1]):
        check.fail("after another image, the first one gave another value or gradient")


def _check_no_mutation(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    given_image, given_reference = subject.asarray(image.copy()), subject.asarray(reference.copy())
    subject.make(given_reference).value_and_grad(given_image)
    for name, given, kept in (("image", given_image, image), ("reference", given_reference, reference)):
        if not same(to_numpy(given), kept):
            check.fail(f"the {name} was written to")


def _check_own_reference(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    given = reference.copy()
    objective = subject.make(given)
    before = float(objective.value(subject.asarray(image)))
    given[...] = 0.5
    after = float(objective.value(subject.asarray(image)))
    if before != after:
        check.fail(f"the value went from {before:.6g} to {after:.6g} when the caller wrote to the reference array")


def _check_non_finite(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    image[1, 2, 0] = np.nan
    try:
        value, gradient = subject.make(subject.asarray(reference)).value_and_grad(subject.asarray(image))
    except ValueError:
        return
    except Exception as error:  # noqa: BLE001 - anything else is what this check is about
        check.fail(f"expected a ValueError for an image with a NaN, got {type(error).__name__}: {error}")
    if np.isfinite(float(value)) and np.any(to_numpy(gradient)[1, 2, 0]):
        check.fail(f"a NaN pixel gave the finite value {float(value):.6g} and a gradient at that pixel")
    if np.isfinite(float(value)) and not np.all(np.isfinite(to_numpy(gradient))):
        check.fail("a NaN pixel gave a finite value and a gradient that is not")
    if np.isfinite(float(value)) and not _masks(subject, image, reference, float(value)):
        check.fail("a NaN pixel was taken for some number: the value depends on it")


def _masks(subject: ObjectiveSubject, image: Host, reference: Host, value: float) -> bool:
    """Whether the value is that of an image which equals the reference at the bad pixel."""
    fixed = np.where(np.isnan(image), reference, image)
    wanted = float(subject.make(subject.asarray(reference)).value(subject.asarray(fixed)))
    return abs(wanted - value) <= 1e-4 * max(abs(wanted), 1e-30)


OBJECTIVE_CHECKS: Final[tuple[_Check, ...]] = (
    Check("value", "value gives a finite 0-d array of the image's library and dtype", _check_value),
    Check("value_and_grad", "value_and_grad gives that value, and a gradient like the image", _check_pair),
    Check("minimum", "the reference is the least of all images, and the gradient is zero there", _check_minimum),
    Check("finite_differences", "the gradient is the derivative of the value", _check_differences),
    Check("weights", "if it takes weights, pixels count by them, and by nothing if they are 0", _check_weights),
    Check("batch", "if it takes batches, the value of one is the mean of its images' values", _check_batch),
    Check("channels", "every channel counts", _check_channels),
    Check("no_memory", "a value depends on the image given, not on earlier calls", _check_no_memory),
    Check("no_mutation", "nothing that is given is written to", _check_no_mutation),
    Check("own_reference", "the reference is the objective's own: later writes change nothing", _check_own_reference),
    Check("non_finite", "a NaN pixel is refused with a ValueError, masked, or seen in the value", _check_non_finite),
)
"""What `check_objective` checks, in its order: each has a `name` and the `rule` that it holds an objective to."""

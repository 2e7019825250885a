"""Checks of the objective interface, :class:`loi_core.Objective`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.errors import ImageTypeError
from loi_core.objectives.base import ImageObjective, Objective
from loi_core.support.arrays import Array, Host, arrays_equal, as_floating, epsilon, library_name, to_numpy
from loi_core.support.keywords import suggest_keywords
from loi_core.testing.checks import Check, measure_slopes, run_checks, slope_tolerance

__all__ = ["OBJECTIVE_CHECKS", "ObjectiveSubject", "check_objective"]


@suggest_keywords
@dataclass(frozen=True)
class ObjectiveSubject:
    """A factory of objectives under test.

    Attributes
    ----------
    make : callable
        ``make(reference)`` returns an objective.
    asarray : callable
        Converts a NumPy array to the library of the test.
    shape : tuple of int
        Shape of the images, (H, W, C).
    dtype : str
        Dtype of the images.
    seed : int
        Seed of the random images.
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
        """Return two random images, strictly inside [0, 1]."""
        first, second = np.random.default_rng(self.seed).uniform(0.05, 0.95, (2, *self.shape)).astype(self.dtype)
        return first, second


_Check: TypeAlias = Check[ObjectiveSubject]


@suggest_keywords
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
    """Check that `make` returns objectives that keep the contract.

    Parameters
    ----------
    make, asarray, shape, dtype, seed, rtol
        As in :class:`ObjectiveSubject`.
    expected_failures : dict of str, optional
        Names of checks that are known to fail, with the reason. One that passes is an error too.

    Raises
    ------
    ConformanceError
        At the first check that fails: its name, the expected and the actual behaviour, and the rule.
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
    expected = float(objective.value(image))
    value, gradient = objective.value_and_grad(image)
    if abs(float(value) - expected) > 1e2 * epsilon(image) * max(abs(expected), 1e-30):
        check.fail(f"value gives {expected:.9g}, value_and_grad {float(value):.9g}")
    if tuple(gradient.shape) != tuple(image.shape):
        check.fail(f"expected a gradient of shape {tuple(image.shape)}, got {tuple(gradient.shape)}")
    if library_name(gradient) != library_name(image) or gradient.dtype != image.dtype:
        check.fail(f"image is {library_name(image)} {image.dtype}, gradient {library_name(gradient)} {gradient.dtype}")
    if not np.all(np.isfinite(to_numpy(gradient))):
        check.fail("the gradient is not finite")


def _check_minimum(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    objective = subject.make(subject.asarray(reference))
    minimum, gradient = objective.value_and_grad(subject.asarray(reference))
    value, slope = objective.value_and_grad(subject.asarray(image))
    if not float(minimum) < float(value):
        check.fail(f"the value at the reference is {float(minimum):.6g}, at another image {float(value):.6g}")
    norm, image_norm = float(np.linalg.norm(to_numpy(gradient))), float(np.linalg.norm(to_numpy(slope)))
    if norm > 1e-3 * image_norm:
        check.fail(f"the gradient at the reference has norm {norm:.3g}, at another image {image_norm:.3g}")


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
        arguments = weights, 2.0 * weights, np.where(weights > 0.0, 1.0, 0.0)
        weighted, doubled, masked = (make(subject.asarray(reference), weights=argument) for argument in arguments)
    except TypeError:
        return  # the factory takes only a reference
    value, gradient = weighted.value_and_grad(subject.asarray(image))
    twice = float(doubled.value(subject.asarray(image)))
    if abs(twice - 2.0 * float(value)) > 1e2 * float(np.finfo(subject.dtype).eps) * abs(twice):
        check.fail(f"the value is {float(value):.9g}, and {twice:.9g} with weights that are twice as large")
    if np.any(to_numpy(gradient)[0]):
        check.fail("the gradient is not 0 in pixels of weight 0")
    if float(value) == float(masked.value(subject.asarray(image))):
        check.fail("the value is the same for all positive weights")
    called = float(objective.value(subject.asarray(image), weights=weights))
    if abs(called - float(value)) > 1e2 * float(np.finfo(subject.dtype).eps) * abs(called):
        check.fail(f"weights of the reference give the value {float(value):.9g}, the same in a call {called:.9g}")
    _check_slopes(check, subject, weighted, image)


def _check_batch(check: _Check, subject: ObjectiveSubject) -> None:
    """Check batches, which an objective may refuse."""
    image, reference = subject.images()
    pairs = [(image, reference), (0.5 * (image + reference), image[::-1].copy())]
    images, references = (np.stack(arrays).astype(image.dtype) for arrays in zip(*pairs, strict=True))
    try:
        value = float(subject.make(subject.asarray(references)).value(subject.asarray(images)))
    except ValueError:
        return
    first, second = (
        float(subject.make(subject.asarray(target)).value(subject.asarray(image))) for image, target in pairs
    )
    if abs(value - (first + second) / 2.0) > 1e3 * float(np.finfo(subject.dtype).eps) * abs(value):
        check.fail(f"a batch of two gave {value:.6g}, the two alone {first:.6g} and {second:.6g}")


def _check_channels(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    objective = subject.make(subject.asarray(reference))
    for channel in range(image.shape[-1]):
        changed = reference.copy()
        changed[..., channel] = image[..., channel]
        if float(objective.value(subject.asarray(changed))) == float(objective.value(subject.asarray(reference))):
            check.fail(f"the value does not depend on channel {channel}")


def _check_slopes(check: _Check, subject: ObjectiveSubject, objective: Objective, image: Host) -> None:
    _, gradient = objective.value_and_grad(subject.asarray(image))

    def value(moved: Host) -> float:
        return float(objective.value(subject.asarray(moved.astype(subject.dtype))))

    eps = float(np.finfo(subject.dtype).eps)
    slopes = measure_slopes(
        [value],
        image.astype(np.float64),
        [to_numpy(gradient).astype(np.float64)],
        rounded=lambda moved: moved.astype(subject.dtype).astype(np.float64),
        epsilon=eps,
        seed=subject.seed,
    )
    finding = slopes.finding(slope_tolerance(eps) if subject.rtol is None else subject.rtol)
    if finding:
        check.fail(finding)


def _check_no_memory(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    objective = subject.make(subject.asarray(reference))
    value, gradient = objective.value_and_grad(subject.asarray(image))
    first, slopes = float(value), to_numpy(gradient).copy()
    if float(objective.value(subject.asarray(0.5 * (image + reference)))) == first:
        check.fail("two different images gave the same value to the bit")
    second, gradient = objective.value_and_grad(subject.asarray(image))
    if float(second) != first or not arrays_equal(to_numpy(gradient), slopes):
        check.fail("after another image, the first one gave another value or gradient")


def _check_no_mutation(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    image_copy, reference_copy = subject.asarray(image.copy()), subject.asarray(reference.copy())
    subject.make(reference_copy).value_and_grad(image_copy)
    for name, copy, original in (("image", image_copy, image), ("reference", reference_copy, reference)):
        if not arrays_equal(to_numpy(copy), original):
            check.fail(f"the {name} was written to")


def _check_own_reference(check: _Check, subject: ObjectiveSubject) -> None:
    image, reference = subject.images()
    argument = reference.copy()
    objective = subject.make(argument)
    before = float(objective.value(subject.asarray(image)))
    argument[...] = 0.5
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
    except Exception as error:  # noqa: BLE001 - this check is about other errors
        check.fail(f"expected a ValueError for an image with a NaN, got {type(error).__name__}: {error}")
    if np.isfinite(float(value)) and np.any(to_numpy(gradient)[1, 2, 0]):
        check.fail(f"a NaN pixel gave the finite value {float(value):.6g} and a gradient at that pixel")
    if np.isfinite(float(value)) and not np.all(np.isfinite(to_numpy(gradient))):
        check.fail("a NaN pixel gave a finite value and a gradient that is not finite")
    if np.isfinite(float(value)) and not _masks(subject, image, reference, float(value)):
        check.fail("a NaN pixel was replaced by a number, and the value depends on it")


def _masks(subject: ObjectiveSubject, image: Host, reference: Host, value: float) -> bool:
    """Return whether an image that equals the reference at the bad pixel has this value."""
    fixed = np.where(np.isnan(image), reference, image)
    expected = float(subject.make(subject.asarray(reference)).value(subject.asarray(fixed)))
    return abs(expected - value) <= 1e-4 * max(abs(expected), 1e-30)


OBJECTIVE_CHECKS: Final[tuple[_Check, ...]] = (
    Check("value", "value returns a finite 0-d array of the image's library and dtype", _check_value),
    Check("value_and_grad", "value_and_grad returns the same value, and a gradient like the image", _check_pair),
    Check("minimum", "the reference has the smallest value of all images, and a gradient of zero", _check_minimum),
    Check("finite_differences", "the gradient is the derivative of the value", _check_differences),
    Check("weights", "if it takes weights, they multiply the contributions of pixels", _check_weights),
    Check("batch", "if it takes batches, their value is the mean of their images' values", _check_batch),
    Check("channels", "every channel changes the value", _check_channels),
    Check("no_memory", "a value depends on the image, not on earlier calls", _check_no_memory),
    Check("no_mutation", "arguments are never written to", _check_no_mutation),
    Check("own_reference", "the reference is copied: later writes change nothing", _check_own_reference),
    Check("non_finite", "a NaN pixel raises a ValueError, is masked, or makes the value NaN", _check_non_finite),
)
"""The checks of `check_objective`, in order, each with a `name` and a `rule`."""

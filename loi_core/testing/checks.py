"""The engine of all checks: named rules, their execution, and the comparison of a gradient with differences."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Generic, NoReturn, TypeVar

import numpy as np

from loi_core.errors import ConformanceError, OptionError
from loi_core.support.arrays import Host
from loi_core.support.wording import described

__all__ = ["Check", "Slopes", "measure_slopes", "run_checks", "slope_tolerance"]

SubjectT = TypeVar("SubjectT")

STEP_FACTORS: Final = tuple(16.0 * 4.0**-power for power in range(9))
"""Widths of central differences, in units of the cube root of epsilon times the size of the argument.

Their error grows with the square of the width, and the effect of rounding shrinks with it: at the cube root the two are
equal for a function whose derivatives have its own magnitude. Sums with cancellation need wider steps; where an edge
just touches a pixel, errors grow only with the root of the width, which calls for narrower ones.
"""

DIRECTIONS: Final = 4
PERTURBATION_ULPS: Final = 3  # largest perturbation of an argument that samples the noise of a function
NOISE_SAMPLES: Final = 6
STANDARD_ERRORS: Final = 3.0  # of a mean over seeds that are attributed to chance
MAX_UNCERTAINTY: Final = 0.05  # largest relative uncertainty of a measured slope that can judge a gradient


def slope_tolerance(epsilon: float) -> float:
    """Return the relative error of slopes that is allowed by default: 5e-4 in float64, 5e-3 in float32.

    Half of the errors that must be detected in a function without noise. Central differences reach eps**(2/3), 4e-11
    and 2e-5, for a smooth function; the rest allows for edges that cross pixels and for sums with cancellation.
    """
    return min(max(5e-4, 4e4 * epsilon), 0.1)


@dataclass(frozen=True)
class Check(Generic[SubjectT]):
    """A named rule and the function that tests it.

    Attributes
    ----------
    name : str
    rule : str
        The rule of the contract, in one sentence.
    test : callable
        Called with the check and the subject; calls :meth:`fail` if the rule is broken.
    """

    name: str
    rule: str
    test: Callable[[Check[SubjectT], SubjectT], None]

    def __call__(self, subject: SubjectT) -> None:
        """Run the check; raises :class:`ConformanceError` if the subject breaks the rule, or fails with an error."""
        try:
            self.test(self, subject)
        except ConformanceError:
            raise
        except Exception as error:  # a subject may raise anything
            msg = f"the check ended with {described(error)}"
            raise ConformanceError(self.name, self.rule, msg) from error

    def finding(self, subject: SubjectT) -> str:
        """Return how the subject breaks the rule, in a line; empty if it keeps the rule."""
        try:
            self(subject)
        except ConformanceError as error:
            return error.finding
        return ""

    def __str__(self) -> str:
        return self.name

    def fail(self, finding: str) -> NoReturn:
        """Raise :class:`ConformanceError` with the expected and the actual behaviour."""
        raise ConformanceError(self.name, self.rule, finding)


def run_checks(
    checks: Iterable[Check[SubjectT]], subject: SubjectT, expected_failures: Mapping[str, str] | None = None
) -> None:
    """Run all checks, stopping at the first unexpected failure.

    Raises
    ------
    ConformanceError
        If a check fails that is not in `expected_failures`, or one that is there passes.
    OptionError
        If `expected_failures` names a check that does not exist.
    """
    expected = dict(expected_failures or {})
    checks = list(checks)
    names = [check.name for check in checks]
    for name in expected:
        if name not in names:
            msg = f"`expected_failures` names {name!r}; the checks are {', '.join(names)}"
            raise OptionError(msg)
    for check in checks:
        try:
            check(subject)
        except ConformanceError:
            if check.name not in expected:
                raise
        else:
            if check.name in expected:
                check.fail(f"passed, but was expected to fail: {expected[check.name]}")


@dataclass(frozen=True)
class Slopes:
    """Directional derivatives along a few directions, from a gradient and from central differences.

    Attributes
    ----------
    claimed, measured : tuple of float
        From the gradient and from differences, for each direction.
    uncertainty : float
        Uncertainty of the measured slopes, 2-norm over directions.
    noise : float
        The component of `uncertainty` from the noise of the seeds, which is the same at all arguments.
    """

    claimed: tuple[float, ...]
    measured: tuple[float, ...]
    uncertainty: float
    noise: float

    @property
    def size(self) -> float:
        """2-norm of the measured slopes."""
        return math.hypot(*self.measured)

    @property
    def relative_uncertainty(self) -> float:
        """Uncertainty of the measured slopes in units of the larger of the two norms."""
        return self.uncertainty / self._larger

    @property
    def roughness(self) -> float:
        """Component of the relative uncertainty that depends on the argument, and may be smaller at another one."""
        return (self.uncertainty - self.noise) / self._larger

    @property
    def _larger(self) -> float:
        return max(self.size, math.hypot(*self.claimed), 1e-300)

    @property
    def error(self) -> float:
        """2-norm of the difference of claimed and measured slopes."""
        return math.dist(self.claimed, self.measured)

    def finding(self, rtol: float) -> str:
        """Return the fault of the gradient in a sentence; empty if there is none.

        Noise loosens the test only by its own size. If it could hide an error of one in twenty, the finding is that the
        measurement is too uncertain.
        """
        if self.error == 0.0:  # a parameter without effect, whose slopes have no size to be uncertain by
            return ""
        listed = (
            f"central differences give {_listed(self.measured)} along random directions, the gradient "
            f"{_listed(self.claimed)}"
        )
        if self.error > rtol * self.size + self.uncertainty:
            relative = self.error / max(self.size, 1e-300)
            return f"{listed}: off by {relative:.2g}, allowed {rtol:.2g}"
        if self.relative_uncertainty > max(rtol, MAX_UNCERTAINTY):
            return f"{listed}, but these are uncertain by {self.relative_uncertainty:.2g}; average over more seeds"
        return ""


def _listed(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"


def measure_slopes(
    functions: Sequence[Callable[[Host], float]],
    at: Host,
    gradients: Sequence[Host],
    *,
    rounded: Callable[[Host], Host],
    epsilon: float,
    seed: int,
) -> Slopes:
    """Compare gradients with central differences, in the mean over some functions.

    Parameters
    ----------
    functions : sequence of callables
        The same function under different seeds; a single one if it has no noise.
    at : array
        The argument, float64.
    gradients : sequence of arrays
        The gradient of each function at `at`, float64.
    rounded : callable
        Maps float64 to the numbers that the function sees, as float64.
    epsilon : float
        Machine epsilon of its arithmetic.
    seed : int
        Seed of the directions.
    """
    rng = np.random.default_rng(seed)
    size = max(1.0, float(np.abs(at).max(initial=0.0)))
    directions = [np.asarray(rng.standard_normal(at.shape)) for _ in range(DIRECTIONS)]
    ulps = PERTURBATION_ULPS
    perturbed = [rounded(at * (1.0 + epsilon * rng.integers(-ulps, ulps + 1, at.shape))) for _ in range(NOISE_SAMPLES)]
    noise = _noise(functions[0], perturbed, gradients[0], epsilon)
    widths: list[_Width] = []
    errors: list[float] = []  # of each width but the first
    for factor in STEP_FACTORS:
        step = factor * epsilon ** (1.0 / 3.0) * size
        pairs = [(rounded(at + step * direction), rounded(at - step * direction)) for direction in directions]
        # In float32 an argument moves by the step after rounding, not by the step.
        claimed = np.array([[np.sum(slope * (up - down)) for up, down in pairs] for slope in gradients]) / (2.0 * step)
        measured = np.array([[value(up) - value(down) for up, down in pairs] for value in functions]) / (2.0 * step)
        rounding = STANDARD_ERRORS * noise * math.sqrt(DIRECTIONS / len(functions)) / step
        widths.append(_Width(claimed, measured, rounding))
        if len(widths) > 1 and rounding > 4.0 * min(errors, default=math.inf):
            break
        if len(widths) > 1:
            # The change of slopes from one width to a fourth of it bounds the error at the latter: the change equals
            # the error where errors fall with the root of the width, and is 15 times larger where they fall with its
            # square.
            errors.append(widths[-2].distance(widths[-1]) + rounding)
    best = int(np.argmin(errors))
    claimed, measured = widths[best + 1].claimed, widths[best + 1].measured
    chance = 0.0
    if len(functions) > 1:
        deviations = np.std(measured - claimed, axis=0, ddof=1) / math.sqrt(len(functions))
        chance = STANDARD_ERRORS * float(np.linalg.norm(deviations))
    return Slopes(
        tuple(map(float, np.mean(claimed, axis=0))),
        tuple(map(float, np.mean(measured, axis=0))),
        errors[best] + chance,
        chance,
    )


@dataclass(frozen=True)
class _Width:
    """Slopes from differences of one width, shape (functions, directions), and the effect of rounding on them."""

    claimed: Host
    measured: Host
    rounding: float

    def distance(self, width: _Width) -> float:
        """Return the 2-norm over directions of the difference of the mean slopes at two widths."""
        return float(np.linalg.norm(np.mean(self.measured - width.measured, axis=0)))


def _noise(function: Callable[[Host], float], arguments: Sequence[Host], gradient: Host, epsilon: float) -> float:
    """Return the deviation of a function from a line at adjacent arguments, caused by its own arithmetic."""
    values = [function(argument) for argument in arguments]
    deviations = [
        value - float(np.sum(gradient * (argument - arguments[0])))
        for value, argument in zip(values, arguments, strict=True)
    ]
    return float(np.std(deviations)) + epsilon * abs(float(np.mean(values)))

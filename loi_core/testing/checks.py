"""What all checks share: named rules, running them, and comparing a gradient with differences."""

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

STEPS: Final = tuple(16.0 * 4.0**-power for power in range(9))
"""Widths of central differences, times the cube root of epsilon and the size of what moves.

Their error grows with the square of the width, and that of rounding falls with it: at the cube root the two are alike
for a function whose derivatives are of its own size. Sums that cancel want wider steps; where an edge just touches a
pixel, errors grow with the root of the width only, and narrower ones are wanted.
"""

DIRECTIONS: Final = 4
ULPS: Final = 3  # how many roundings an argument is moved by to see the noise of a function
NEIGHBOURS: Final = 6  # and how often
SIGMAS: Final = 3.0  # standard errors of a mean over seeds that are put down to chance
COARSEST: Final = 0.05  # relative error of a measured slope beyond which nothing is said about a gradient


def slope_tolerance(epsilon: float) -> float:
    """The relative error of slopes that is allowed by default: 5e-4 in float64, 5e-3 in float32.

    Half of what has to be caught where nothing is noisy. Central differences reach eps**(2/3): 4e-11 and 2e-5 for a
    smooth function; edges that pass from pixel to pixel, and sums that cancel, cost the rest.
    """
    return min(max(5e-4, 4e4 * epsilon), 0.1)


@dataclass(frozen=True)
class Check(Generic[SubjectT]):
    """One named rule and the function that tests it.

    Attributes
    ----------
    name : str
    rule : str
        What the contract says, in a sentence.
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
        except Exception as error:  # of the subject, which may raise anything
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
        """Say what was expected and what came."""
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
    """Slopes along a few directions, as a gradient claims them and as central differences measure them.

    Attributes
    ----------
    claimed, measured : tuple of float
        Along each direction.
    uncertainty : float
        How far the measured ones may be off, 2-norm over directions.
    noise : float
        What of it is noise of the seeds, which is there wherever slopes are measured.
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
    def doubt(self) -> float:
        """How far the measured ones may be off, relative to the larger of the two."""
        return self.uncertainty / self._larger

    @property
    def roughness(self) -> float:
        """What of `doubt` comes of where they are measured, and may be less elsewhere."""
        return (self.uncertainty - self.noise) / self._larger

    @property
    def _larger(self) -> float:
        return max(self.size, math.hypot(*self.claimed), 1e-300)

    @property
    def off(self) -> float:
        """2-norm of the difference."""
        return math.dist(self.claimed, self.measured)

    def finding(self, rtol: float) -> str:
        """What is wrong with the claim, in a sentence; empty if nothing is.

        Noise makes the test no looser than by itself, and not at all where it would hide an error of one in twenty:
        then the finding is that nothing can be said.
        """
        listed = (
            f"central differences give {_listed(self.measured)} along random directions, the gradient "
            f"{_listed(self.claimed)}"
        )
        if self.off > rtol * self.size + self.uncertainty:
            relative = self.off / max(self.size, 1e-300)
            return f"{listed}: off by {relative:.2g}, allowed {rtol:.2g}"
        if self.doubt > max(rtol, COARSEST):
            return f"{listed}, but these are uncertain by {self.doubt:.2g}; average over more seeds"
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
        The same function under different seeds; one if it has no noise.
    at : array
        Where, float64.
    gradients : sequence of arrays
        Of each function there, float64.
    rounded : callable
        From float64 to the numbers that the function sees, as float64.
    epsilon : float
        Machine epsilon of its arithmetic.
    seed : int
        For the directions.
    """
    rng = np.random.default_rng(seed)
    size = max(1.0, float(np.abs(at).max(initial=0.0)))
    directions = [np.asarray(rng.standard_normal(at.shape)) for _ in range(DIRECTIONS)]
    near = [rounded(at * (1.0 + epsilon * rng.integers(-ULPS, ULPS + 1, at.shape))) for _ in range(NEIGHBOURS)]
    noise = _noise(functions[0], near, gradients[0], epsilon)
    widths: list[_Width] = []
    errors: list[float] = []  # of each width but the first
    for step in STEPS:
        reach = step * epsilon ** (1.0 / 3.0) * size
        ends = [(rounded(at + reach * one), rounded(at - reach * one)) for one in directions]
        # An argument in float32 moves by what its rounding leaves of a step.
        claimed = np.array([[np.sum(one * (up - down)) for up, down in ends] for one in gradients]) / (2.0 * reach)
        measured = np.array([[one(up) - one(down) for up, down in ends] for one in functions]) / (2.0 * reach)
        rounding = SIGMAS * noise * math.sqrt(DIRECTIONS / len(functions)) / reach
        widths.append(_Width(claimed, measured, rounding))
        if len(widths) > 1 and rounding > 4.0 * min(errors, default=math.inf):
            break
        if len(widths) > 1:
            # How slopes change from one width to a fourth of it is at least what is left at that fourth: as much where
            # errors fall with the root of the width, a fifteenth where they fall with its square.
            errors.append(widths[-2].distance(widths[-1]) + rounding)
    best = int(np.argmin(errors))
    claimed, measured = widths[best + 1].claimed, widths[best + 1].measured
    chance = 0.0
    if len(functions) > 1:
        deviations = np.std(measured - claimed, axis=0, ddof=1) / math.sqrt(len(functions))
        chance = SIGMAS * float(np.linalg.norm(deviations))
    return Slopes(
        tuple(map(float, np.mean(claimed, axis=0))),
        tuple(map(float, np.mean(measured, axis=0))),
        errors[best] + chance,
        chance,
    )


@dataclass(frozen=True)
class _Width:
    """Slopes from differences of one width, shape (functions, directions), and how far rounding may have moved them."""

    claimed: Host
    measured: Host
    rounding: float

    def distance(self, other: _Width) -> float:
        """Between the mean slopes of two widths, 2-norm over directions."""
        return float(np.linalg.norm(np.mean(self.measured - other.measured, axis=0)))


def _noise(function: Callable[[Host], float], places: Sequence[Host], gradient: Host, epsilon: float) -> float:
    """How far values next to each other are off a line: what the function's own arithmetic does to them."""
    values = [function(place) for place in places]
    off = [value - float(np.sum(gradient * (place - places[0]))) for value, place in zip(values, places, strict=True)]
    return float(np.std(off)) + epsilon * abs(float(np.mean(values)))

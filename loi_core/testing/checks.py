"""What all checks share: named rules, running them, and comparing a gradient with differences."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NoReturn, TypeAlias, TypeVar

import numpy as np

from loi_core.errors import ConformanceError, OptionError

__all__ = ["Check", "Host", "compare_slopes", "directional_slopes", "run_checks", "same"]

Host: TypeAlias = np.ndarray[Any, Any]
SubjectT = TypeVar("SubjectT")

STEPS = (1e-1, 1e-2, 1e-3)  # times the cube root of epsilon: one of them straddles no kink and drowns in no rounding


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
        """Run the check; raises :class:`ConformanceError` if the subject breaks the rule."""
        self.test(self, subject)

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


def same(first: Host, second: Host) -> bool:
    """Equal to the bit, NaN equal to NaN."""
    return first.shape == second.shape and bool(np.array_equal(first, second, equal_nan=first.dtype.kind == "f"))


def directional_slopes(
    function: Callable[[Host], float], at: Host, directions: Sequence[Host], epsilon: float, step: float
) -> list[float]:
    """Central differences of `function` along directions, as wide as its size and precision ask for."""
    reach = step * epsilon ** (1.0 / 3.0) * max(1.0, float(np.abs(at).max(initial=0.0)))
    return [(function(at + reach * one) - function(at - reach * one)) / (2.0 * reach) for one in directions]


def compare_slopes(
    function: Callable[[Host], float], at: Host, gradient: Host, *, epsilon: float, rtol: float, seed: int
) -> tuple[float, list[float], list[float]]:
    """The least relative error of a gradient against differences over several widths of step.

    Returns
    -------
    error : float
        Norm of the difference of the slopes along random directions over the norm of the measured ones.
    claimed, measured : list of float
        Slopes along these directions: from the gradient, and from the best width.
    """
    rng = np.random.default_rng(seed)
    directions: list[Host] = [np.asarray(rng.standard_normal(at.shape)) for _ in range(4)]
    claimed = [float(np.sum(gradient * one)) for one in directions]
    scale = abs(function(at)) + 1e-300
    best: tuple[float, list[float]] = (math.inf, [])
    for step in STEPS:
        measured = directional_slopes(function, at, directions, epsilon, step)
        off = math.sqrt(sum((one - two) ** 2 for one, two in zip(claimed, measured, strict=True)))
        reach = step * epsilon ** (1.0 / 3.0)
        noise = epsilon * scale / reach  # what rounding of the function alone makes of a difference
        size = math.sqrt(sum(one * one for one in measured))
        error = max(off - 8.0 * noise, 0.0) / max(size, 1e-300) if off > 8.0 * noise else 0.0
        if not best[1] or error < best[0]:
            best = (error, measured)
        if error <= rtol:
            break
    return best[0], claimed, best[1]

"""Runs of methods on problems, and the table of their results."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from examples.external.counting import CountedRenderer, Tally
from examples.external.problem import Answer, Method, Problem, Task
from loi_core import LoiError

__all__ = ["HEADS", "Outcome", "Summary", "run", "solved_by_problem", "summary", "verdict_line"]

HEADS: Final = ("problem", "method", "solved", "median error", "renders", "true verdicts", "seconds")


@dataclass(frozen=True)
class Outcome:
    """The result of one method from one start.

    Attributes
    ----------
    problem, method : str
    seed : int
    distance, error : float
        Error of the start and of the result, in the unit of the problem.
    solved : bool
        Whether the error is within the tolerance.
    renders : int
    reached : int or None
        Number of images after which the parameters were first within the tolerance.
    verdict : str
        Of the library's fit; empty for other methods.
    ok : bool or None
        Whether the verdict claims that the target was found.
    seconds : float
    """

    problem: str
    method: str
    seed: int
    distance: float
    error: float
    solved: bool
    renders: int
    reached: int | None
    verdict: str
    ok: bool | None
    seconds: float


def run(problem: Problem, method: Method, seed: int) -> Outcome:
    """Return the outcome of a method from one start."""
    start = problem.make(seed)
    tally = Tally(lambda params: start.error(params) <= problem.tolerance)
    renderer = CountedRenderer(start.renderer, tally)
    started = time.perf_counter()
    task = Task(problem, start, renderer, lambda: tally.renders >= problem.renders, seed)
    try:
        answer = method.minimise(task)
    except LoiError as error_of_fit:
        answer = Answer(start.first, f"failed: {error_of_fit}")
    seconds = time.perf_counter() - started
    error = start.error(answer.params)
    return Outcome(
        problem.name,
        method.name,
        seed,
        start.distance,
        error,
        error <= problem.tolerance,
        tally.renders if answer.renders is None else answer.renders,
        tally.reached,
        answer.verdict,
        answer.ok,
        seconds,
    )


@dataclass(frozen=True)
class Summary:
    """The results of one method on one problem, from several starts; `skipped` has the reason if there are none."""

    problem: str
    method: str
    unit: str = ""
    outcomes: tuple[Outcome, ...] = ()
    skipped: str = ""

    @property
    def solved(self) -> int:
        """Number of solved starts."""
        return sum(outcome.solved for outcome in self.outcomes)

    @property
    def median_error(self) -> float:
        """Median error of all starts."""
        return float(np.median([outcome.error for outcome in self.outcomes]))

    @property
    def renders(self) -> float:
        """Mean number of images."""
        return float(np.mean([outcome.renders for outcome in self.outcomes]))

    @property
    def renders_of_95_percent(self) -> float | None:
        """Number of images after which 95 % of the starts were within the tolerance; None if they never were."""
        counts = sorted(
            float(outcome.reached) if outcome.solved and outcome.reached is not None else np.inf
            for outcome in self.outcomes
        )
        count = counts[int(np.ceil(0.95 * len(counts))) - 1]
        return count if np.isfinite(count) else None

    @property
    def verdicts(self) -> tuple[int, int]:
        """Number of true verdicts, and of all verdicts."""
        judged = [outcome for outcome in self.outcomes if outcome.ok is not None]
        return sum(outcome.ok == outcome.solved for outcome in judged), len(judged)

    def row(self) -> list[str]:
        """Return the cells of the table."""
        if not self.outcomes:
            return [self.problem, self.method, f"skipped: {self.skipped}", "", "", "", ""]
        correct, judged = self.verdicts
        return [
            self.problem,
            self.method,
            f"{self.solved} of {len(self.outcomes)}",
            f"{self.median_error:.3g} {self.unit}",
            f"{self.renders:.0f}",
            f"{correct} of {judged}" if judged else "",
            f"{np.mean([outcome.seconds for outcome in self.outcomes]):.1f}",
        ]


def summary(problem: Problem, method: Method, seeds: Iterable[int]) -> Summary:
    """Return the results of a method from several starts, or the reason why it is skipped."""
    missing = problem.missing() or method.missing()
    if missing:
        return Summary(problem.name, method.name, problem.unit, skipped=missing)
    outcomes = tuple(run(problem, method, seed) for seed in seeds)
    return Summary(problem.name, method.name, problem.unit, outcomes)


def solved_by_problem(summaries: Sequence[Summary]) -> tuple[list[str], list[list[str]]]:
    """Return the heads and rows of a table with a column of solved starts for each method."""
    problems, methods = (
        list(dict.fromkeys(getattr(entry, name) for entry in summaries)) for name in ("problem", "method")
    )
    cells = {(entry.problem, entry.method): entry.row()[2] for entry in summaries if entry.outcomes}
    methods = [name for name in methods if any((problem, name) in cells for problem in problems)]
    rows = [[problem, *(cells.get((problem, name), "") for name in methods)] for problem in problems]
    return ["problem", *methods], rows


def verdict_line(summaries: Sequence[Summary]) -> str:
    """Return the share of true verdicts over all problems."""
    counts = [entry.verdicts for entry in summaries]
    correct, judged = (sum(column) for column in zip(*counts, strict=True)) if counts else (0, 0)
    return f"true verdicts: {correct} of {judged}" + (f" ({correct / judged:.0%})" if judged else "")

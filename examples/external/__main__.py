"""Run problems of other projects by the library and by rival methods, with equal numbers of renders.

``python -m examples.external [--problem disks] [--method loi] [--starts 8] [--quick] [--json]``. Problems and methods
whose packages are not installed are listed as skipped; ``pip install 'loi[external]'`` installs them.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import Any, Final, TypeVar

from examples.convergence.flat import WARPS
from examples.external.disks import DISKS
from examples.external.methods import METHODS
from examples.external.pasted import PASTED, POSES
from examples.external.problem import Method, Problem, problem_of_case
from examples.external.registration import REGISTRATIONS
from examples.external.running import HEADS, Summary, solved_by_problem, summary, verdict_line
from examples.external.shapes import SHAPES
from examples.external.solid import SOLIDS
from examples.external.xray import XRAYS
from loi_core.support.markdown import markdown

QUICK_METHODS: Final = ("loi", "loi, matched", "pixel L2", "Gaussian pyramid", "CMA-ES")
QUICK_STARTS: Final = 1

Named = TypeVar("Named", Problem, Method)


def problems() -> tuple[Problem, ...]:
    """Return all problems."""
    darker = next(case for case in WARPS if case.name.endswith("darker"))
    return (*DISKS, *PASTED, *POSES, problem_of_case(darker), *REGISTRATIONS, *SHAPES, *XRAYS, *SOLIDS)


def selected(problem: str, method: str, *, quick: bool) -> Iterator[tuple[Problem, Method]]:
    """Yield the problems and methods whose names contain these texts; a full name selects itself alone."""
    chosen = matching(problem, problems())
    for entry in (candidate for candidate in chosen if candidate.quick or not quick):
        for candidate in matching(method, (*METHODS, *entry.methods)):
            if not quick or candidate.name in QUICK_METHODS:
                yield entry, candidate


def matching(text: str, candidates: Iterable[Named]) -> list[Named]:
    """Return the candidates whose name is, or else contains, a text."""
    exact = [candidate for candidate in candidates if candidate.name == text]
    return exact or [candidate for candidate in candidates if text in candidate.name]


def record(entry: Summary) -> dict[str, Any]:
    """Return a summary for JSON."""
    if not entry.outcomes:
        return {"problem": entry.problem, "method": entry.method, "skipped": entry.skipped}
    correct, judged = entry.verdicts
    return {
        "problem": entry.problem,
        "method": entry.method,
        "unit": entry.unit,
        "solved": entry.solved,
        "starts": len(entry.outcomes),
        "median_error": entry.median_error,
        "renders": entry.renders,
        "renders_of_95_percent": entry.renders_of_95_percent,
        "true_verdicts": correct,
        "verdicts": judged,
        "outcomes": [asdict(outcome) for outcome in entry.outcomes],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, or JSON."""
    parser = argparse.ArgumentParser(prog="python -m examples.external", description=__doc__)
    parser.add_argument("--problem", default="", help="part of the names of the problems to run")
    parser.add_argument("--method", default="", help="name of a method, or part of the names of several")
    parser.add_argument("--starts", type=int, help="number of starts of each problem")
    parser.add_argument("--quick", action="store_true", help="a few starts of small problems, in a minute")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    options = parser.parse_args(arguments)
    summaries = []
    for problem, method in selected(options.problem, options.method, quick=options.quick):
        count = options.starts or (QUICK_STARTS if options.quick else problem.starts)
        summaries.append(summary(problem, method, range(count)))
        print(" | ".join(summaries[-1].row()), file=sys.stderr if options.json else sys.stdout, flush=True)
    if options.json:
        print(json.dumps([record(entry) for entry in summaries], indent=1))
    else:
        print("\n" + "\n".join(markdown(HEADS, [entry.row() for entry in summaries])))
        print("\n" + "\n".join(markdown(*solved_by_problem(summaries))))
        print("\n" + verdict_line(summaries))


if __name__ == "__main__":
    main()

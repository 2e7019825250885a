"""Fit every scene of the suite from several random starts with nothing given but the bounds, and print what came of it.

``python -m examples.convergence [--kind warp] [--seeds 3] [--before]``; ``--before`` adds the fit that there was
before stages: the objective alone, at the same rates.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Sequence

from examples.convergence.case import Case, within
from loi_core import LOIObjective, fit
from loi_core.support.markdown import markdown

HEADS = ("scene", "found", "worst error", "right verdicts", "verdicts", "seconds")


def cases(kind: str) -> Iterable[Case]:
    """The scenes whose name begins so; Mitsuba's are imported only if they are asked for."""
    from examples.convergence.flat import VECTORS, WARPS

    yield from (case for case in (*WARPS, *VECTORS) if case.name.startswith(kind))
    if not kind or kind.startswith("M"):
        from examples.convergence.solid import SOLIDS

        yield from SOLIDS


def row(case: Case, seeds: Sequence[int], *, before: bool = False) -> list[str]:
    """What came of one scene: found of how many, the worst error in units of what is allowed, and the verdicts."""
    found = right = 0
    worst, verdicts, started = 0.0, [], time.perf_counter()
    for seed in seeds:
        trial = case.make(seed)
        result = fit(
            trial.renderer,
            LOIObjective(trial.target),
            optimise=trial.free,
            seed=1000 * seed,
            stages=None if before else "auto",
        )
        there, error = within(trial, result.best_params)
        diagnosis = result.diagnosis
        found, worst = found + there, max(worst, error)
        right += diagnosis is not None and diagnosis.ok == there
        verdicts.append("none" if diagnosis is None else f"{diagnosis.verdict} ({diagnosis.left:.0%})")
    count, seconds = len(seeds), (time.perf_counter() - started) / len(seeds)
    name = f"{case.name}, before" if before else case.name
    return [name, f"{found} of {count}", f"{worst:.2g}", f"{right} of {count}", ", ".join(verdicts), f"{seconds:.0f}"]


def main() -> None:
    """Print the table, a row as soon as it is there."""
    parser = argparse.ArgumentParser(prog="python -m examples.convergence", description=__doc__)
    parser.add_argument("--kind", default="", help="warp, vector or Mitsuba")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--before", action="store_true")
    options = parser.parse_args()
    rows = []
    for case in cases(options.kind):
        for before in (False, True) if options.before else (False,):
            rows.append(row(case, range(options.first, options.first + options.seeds), before=before))
            print(" | ".join(rows[-1]), flush=True)
    print("\n" + "\n".join(markdown(HEADS, rows)))


if __name__ == "__main__":
    main()

"""Fit every scene of the suite from several random starts, with bounds alone, and print the results.

``python -m examples.convergence [--kind warp] [--seeds 3] [--single-stage] [--manual]``; ``--single-stage`` adds fits
of the objective alone, at the same rates. ``--manual`` adds an expert's schedule: the widest extent alone first, at
twice the rate, in three quarters of the steps, without a search.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Sequence
from typing import Any

from examples.convergence.case import Case, within
from loi_core import LOIObjective, ScaleSpace, fit
from loi_core.support.markdown import markdown

HEADS = ("scene", "solved", "worst error", "right verdicts", "verdicts", "seconds")


def cases(prefix: str) -> Iterable[Case]:
    """Yield the scenes whose name begins with `prefix`; Mitsuba is imported only on request."""
    from examples.convergence.flat import VECTORS, WARPS

    yield from (case for case in (*WARPS, *VECTORS) if case.name.startswith(prefix))
    if not prefix or prefix.startswith("M"):
        from examples.convergence.solid import SOLIDS

        yield from SOLIDS


def settings(height: int, width: int) -> dict[str, dict[str, Any]]:
    """Return the compared settings by the suffix of their rows; the first is the default."""
    widest = max(ScaleSpace.for_image(height, width).alpha)
    manual = {"stages": [ScaleSpace(1.0, widest, 0.125)], "steps": 150, "learning_rate": f"{width / 50:g} px"}
    return {"": {}, ", single stage": {"stages": None}, ", manual": manual}


def row(case: Case, seeds: Sequence[int], setting: str = "") -> list[str]:
    """Fit one scene; return the solved starts, the worst error in tolerances, and the verdicts."""
    solved = correct_verdicts = 0
    worst, verdicts, started = 0.0, [], time.perf_counter()
    for seed in seeds:
        trial = case.make(seed)
        options = settings(*trial.target.shape[:2])[setting]
        result = fit(trial.renderer, LOIObjective(trial.target), optimise=trial.free, seed=1000 * seed, **options)
        is_solved, error = within(trial, result.best_params)
        diagnosis = result.diagnosis
        solved, worst = solved + is_solved, max(worst, error)
        correct_verdicts += diagnosis is not None and diagnosis.ok == is_solved
        verdicts.append("none" if diagnosis is None else f"{diagnosis.verdict} ({diagnosis.left:.0%})")
    count, seconds = len(seeds), (time.perf_counter() - started) / len(seeds)
    return [
        case.name + setting,
        f"{solved} of {count}",
        f"{worst:.2g}",
        f"{correct_verdicts} of {count}",
        ", ".join(verdicts),
        f"{seconds:.1f}",
    ]


def main() -> None:
    """Print the table row by row."""
    parser = argparse.ArgumentParser(prog="python -m examples.convergence", description=__doc__)
    parser.add_argument("--kind", default="", help="warp, vector, SVG or Mitsuba")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--single-stage", action="store_true")
    parser.add_argument("--manual", action="store_true")
    options = parser.parse_args()
    requested = {"": True, ", single stage": options.single_stage, ", manual": options.manual}
    rows = []
    for case in cases(options.kind):
        for setting in (name for name, is_requested in requested.items() if is_requested):
            rows.append(row(case, range(options.first, options.first + options.seeds), setting))
            print(" | ".join(rows[-1]), flush=True)
    print("\n" + "\n".join(markdown(HEADS, rows)))


if __name__ == "__main__":
    main()

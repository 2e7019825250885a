"""Fit every scene of the suite from several random starts with nothing given but the bounds, and print what came of it.

``python -m examples.convergence [--kind warp] [--seeds 3] [--before] [--by-hand]``; ``--before`` adds the fit that
there was before stages: the objective alone, at the same rates. ``--by-hand`` adds what somebody who knows the scenes
would do: the widest extent alone first, at twice the rate, in three quarters of the steps, and no search.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Sequence
from typing import Any

from examples.convergence.case import Case, within
from loi_core import LOIObjective, ScaleSpace, fit
from loi_core.support.markdown import markdown

HEADS = ("scene", "found", "worst error", "right verdicts", "verdicts", "seconds")


def cases(kind: str) -> Iterable[Case]:
    """The scenes whose name begins so; Mitsuba's are imported only if they are asked for."""
    from examples.convergence.flat import VECTORS, WARPS

    yield from (case for case in (*WARPS, *VECTORS) if case.name.startswith(kind))
    if not kind or kind.startswith("M"):
        from examples.convergence.solid import SOLIDS

        yield from SOLIDS


def settings(height: int, width: int) -> dict[str, dict[str, Any]]:
    """What is compared, by what its rows are called; the first is the default."""
    widest = max(ScaleSpace.for_image(height, width).alpha)
    by_hand = {"stages": [ScaleSpace(1.0, widest, 0.125)], "steps": 150, "learning_rate": f"{width / 50:g} px"}
    return {"": {}, ", before": {"stages": None}, ", by hand": by_hand}


def row(case: Case, seeds: Sequence[int], way: str = "") -> list[str]:
    """What came of one scene: found of how many, the worst error in units of what is allowed, and the verdicts."""
    found = right = 0
    worst, verdicts, started = 0.0, [], time.perf_counter()
    for seed in seeds:
        trial = case.make(seed)
        options = settings(*trial.target.shape[:2])[way]
        result = fit(trial.renderer, LOIObjective(trial.target), optimise=trial.free, seed=1000 * seed, **options)
        there, error = within(trial, result.best_params)
        diagnosis = result.diagnosis
        found, worst = found + there, max(worst, error)
        right += diagnosis is not None and diagnosis.ok == there
        verdicts.append("none" if diagnosis is None else f"{diagnosis.verdict} ({diagnosis.left:.0%})")
    count, seconds = len(seeds), (time.perf_counter() - started) / len(seeds)
    return [
        case.name + way,
        f"{found} of {count}",
        f"{worst:.2g}",
        f"{right} of {count}",
        ", ".join(verdicts),
        f"{seconds:.1f}",
    ]


def main() -> None:
    """Print the table, a row as soon as it is there."""
    parser = argparse.ArgumentParser(prog="python -m examples.convergence", description=__doc__)
    parser.add_argument("--kind", default="", help="warp, vector, SVG or Mitsuba")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--before", action="store_true")
    parser.add_argument("--by-hand", action="store_true")
    options = parser.parse_args()
    asked = {"": True, ", before": options.before, ", by hand": options.by_hand}
    rows = []
    for case in cases(options.kind):
        for way in (way for way, wanted in asked.items() if wanted):
            rows.append(row(case, range(options.first, options.first + options.seeds), way))
            print(" | ".join(rows[-1]), flush=True)
    print("\n" + "\n".join(markdown(HEADS, rows)))


if __name__ == "__main__":
    main()

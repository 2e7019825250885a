"""``python -m examples.effects``: print the gain of planned effects for each scene as Markdown."""

from __future__ import annotations

import argparse
import dataclasses
import math
import statistics
import sys

import loi_mitsuba  # noqa: F401 - before Dr.Jit, so that it gets an LLVM that works

# isort: split
import mitsuba as mi

from examples.effects.measure import FULL, MAX_ERROR, QUICK, Row, measure
from examples.effects.scenes import SUITE
from loi_core.support.markdown import markdown

HEADS = [
    "scene",
    "on",
    "cosine",
    "norm ratio",
    "noise",
    "ms a step",
    "everything on",
    "defaults",
    "manual",
    "pilot",
    "revisions",
    "solved, left",
    "everything on: solved, left",
]


def main() -> None:
    """Measure the named scenes, by default all."""
    parser = argparse.ArgumentParser(prog="python -m examples.effects", description=__doc__)
    parser.add_argument("scenes", nargs="*", metavar="WORDS", help="scenes whose name has these words (default: all)")
    parser.add_argument("--quick", action="store_true", help="tiny images and few draws; its numbers mean little")
    parser.add_argument("--fits", type=int, metavar="N", help="fits of each, with other seeds (default: 3; quick: 1)")
    parser.add_argument("--no-defaults", action="store_true", help="leave out Mitsuba's defaults, which take minutes")
    options = parser.parse_args()
    effort = QUICK if options.quick else FULL
    if options.fits is not None:
        effort = dataclasses.replace(effort, fits=options.fits)
    if options.no_defaults:
        effort = dataclasses.replace(effort, defaults=0)
    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)  # Mitsuba logs advice about every new projective integrator
    rows = []
    for case in SUITE:
        if not options.scenes or any(words in case.name for words in options.scenes):
            print(case.name, file=sys.stderr, flush=True)
            rows.append(measure(case, effort))
    print("\n".join(markdown(HEADS, map(cells, rows))))
    for row in rows:
        print(f"\n### {row.name}\n\n{row.plan}")


def cells(row: Row) -> list[str]:
    """Return a row of the table, with times as multiples of the plan's time."""
    short = {"continuous shading": "shading", "primary visibility": "outlines", "indirect visibility": "shadows"}
    terms = [f"{short[choice.effect]} {choice.samples}" for choice in row.plan.choices if choice.samples]
    gradient = row.gradient
    return [
        row.name,
        f"{', '.join(terms)}; depth {row.plan.settings['max_depth']}",
        _with_error(gradient.cosine, gradient.cosine_error, 4),
        _with_error(gradient.ratio, gradient.ratio_error, 3),
        f"{gradient.noise:.2g}, {gradient.reference_noise:.2g}",
        f"{1e3 * row.seconds:.3g}",
        *(_times(seconds / row.seconds) for seconds in (row.full_seconds, row.default_seconds, row.manual_seconds)),
        f"{row.pilot_fraction:.1%}",
        f"{row.revisions_fraction:.1%}",
        _ends(row.errors),
        _ends(row.full_errors),
    ]


def _with_error(value: float, error: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f} +- {error:.{digits}f}"


def _ends(errors: tuple[float, ...]) -> str:
    """Return the number of fits that have found the true values, and the median relative error."""
    return (
        f"{sum(error < MAX_ERROR for error in errors)}/{len(errors)}, {statistics.median(errors):.2g}"
        if errors
        else "-"
    )


def _times(ratio: float) -> str:
    return "-" if math.isnan(ratio) else f"{ratio:.3g}x"


if __name__ == "__main__":
    main()

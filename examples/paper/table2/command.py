"""``python -m examples.paper table2``: the runs, then tables, contact sheets and convergence plots."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from examples.paper.lib.pictures import animation, moments
from examples.paper.lib.results import Results
from examples.paper.lib.store import load, slug
from examples.paper.lib.study import Study, Subtable, add_options, carry_out_and_report, selected_columns
from examples.paper.table2.cost import cost_of
from examples.paper.table2.problem import COLUMNS, Column, Problem
from examples.paper.table2.published import PAPER
from examples.paper.table2.run import CURVE_STEPS, VARIANT, Run, carry_out
from examples.paper.table2.savings import savings
from examples.paper.table2.settings import LABELS, PROTOCOLS, RATES, Method, Setting, many, ours
from loi_mitsuba.scene.load import VARIANTS

# isort: split
import mitsuba as mi
import numpy as np

__all__ = ["PARTS", "main", "part_of"]

PARTS: Final = ("tuning", "ours", "published", "noise", "anywhere", "savings")
TUNED: Final = 100  # the seed of the search, which no table has
NOISY: Final = tuple(
    replace(
        COLUMNS[0],
        name=f"{COLUMNS[0].name}, {samples} sample{'s' if samples > 1 else ''}",
        samples=samples,
        scene=COLUMNS[0].name,
    )
    for samples in (256, 64, 16, 4, 1)
)
ANYWHERE: Final = replace(COLUMNS[3], name="Sort, anywhere", scene="Sort, anywhere")
NOISY_METHODS: Final[tuple[Method, ...]] = ("gaussian_pyramid", "ms_ssim", "loi")
FRAME_SAMPLES: Final = 64
GAMMA: Final = 1.0 / 2.2
SEARCHED: Final = "Envlight"  # of the search: the column whose steps are cheapest


def main(words: Sequence[str] | None = None) -> None:
    """Carry out what is missing and write everything anew."""
    parser = argparse.ArgumentParser(prog="python -m examples.paper table2", description=__doc__)
    add_options(parser, "table2", PARTS, "two methods, one start, one tiny column, few steps")
    parser.add_argument("--methods", nargs="+", choices=list(LABELS), default=list(LABELS), help="default: all")
    parser.add_argument("--seeds", type=int, default=3, help="starts (default: 3)")
    parser.add_argument("--variant", choices=VARIANTS, default=VARIANT, help=f"Mitsuba's (default: {VARIANT})")
    options = parser.parse_args(words)
    methods = tuple(method for method in LABELS if method in options.methods)
    columns = selected_columns(parser, options, COLUMNS)
    mi.set_variant(options.variant)
    parts = {name: part_of(name, methods, columns, options.seeds) for name in options.parts if name != "savings"}
    study = replace(STUDY, carry_out=partial(carry_out, variant=options.variant))
    if "savings" in options.parts and not (options.quick or options.report):
        saved = {"savings": savings(columns)}  # measured anew on every call: a time is of this machine, now
        study = replace(study, extra_tables=lambda results, parts: _costs(results, parts) | saved)
    carry_out_and_report(parser, options, study, {"ours": _quick()} if options.quick else parts)


def part_of(
    name: str, methods: Sequence[Method] = tuple(LABELS), columns: Sequence[Column] = COLUMNS, seeds: int = 3
) -> Subtable[Run]:
    """The runs of a part that has runs, which is all but "savings"."""
    if name == "tuning":
        searched = [column for column in columns if column.name == SEARCHED]
        rows = {
            LABELS[method]: [Run(ours(method, rate), column, TUNED) for rate in RATES for column in searched]
            for method in methods
        }
        return Subtable(rows, rates=RATES)
    settings = PROTOCOLS["published" if name == "published" else "ours"]
    if name == "noise":
        methods = [method for method in methods if method in NOISY_METHODS]
    columns = {"noise": NOISY, "anywhere": (ANYWHERE,)}.get(name, tuple(columns))
    rows = {
        LABELS[method]: [
            Run(_in_column(settings[method], column), column, seed) for column in columns for seed in range(seeds)
        ]
        for method in methods
    }
    return Subtable(rows, columns)


def _in_column(setting: Setting, column: Column) -> Setting:
    return many(setting) if setting.name == "ours" and column.crowded else setting


def _quick() -> Subtable[Run]:
    column = replace(COLUMNS[4], width=32, samples=4)
    methods: tuple[Method, ...] = ("prdpt", "loi")
    few = {method: replace(PROTOCOLS["ours"][method], steps=8) for method in methods}
    return Subtable({LABELS[method]: [Run(setting, column, 0)] for method, setting in few.items()}, (column,))


def _costs(results: Results, parts: Mapping[str, Subtable[Run]]) -> dict[str, list[str]]:
    wanted = {name: part for name, part in parts.items() if name in PROTOCOLS}
    return {f"cost, {name}": cost_of(results, part) for name, part in wanted.items()}


def _animate(parts: Mapping[str, Subtable[Run]], runs: Path, folder: Path) -> None:
    """Our first fit of each column, as it converges."""
    part = parts.get("ours")
    for run in part.rows.get(LABELS["loi"], ()) if part else ():
        record = load(runs, run)
        if record is not None and run.seed == 0:
            problem = Problem.of(run.column, 0)
            images = (problem.picture(params, FRAME_SAMPLES) for params in moments(record["path"]))
            shown = [np.clip(image, 0.0, 1.0) ** GAMMA for image in images]
            animation(folder / f"{slug(run.column.name)}.webp", shown, _target(run))


def _title(column: Column) -> str:
    return f"{column.name}, MAE"


def _target(run: Run) -> Any:
    return np.clip(Problem.of(run.column, run.seed).target, 0.0, 1.0) ** GAMMA


STUDY: Final = Study(
    name="table2",
    carry_out=carry_out,
    target=_target,
    measures=("psnr", "mae", "step", "near"),
    second_measure=lambda _: "mae",
    curve_steps=CURVE_STEPS,
    columns=COLUMNS,
    paper=PAPER,
    title=_title,
    animate=_animate,
    extra_tables=_costs,
    unpublished_columns=(*NOISY, ANYWHERE),
)

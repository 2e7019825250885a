"""``python -m examples.paper table2``: run Table 2, and write its tables, contact sheets and convergence plots."""

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
from examples.paper.table2.settings import LABELS, PROTOCOLS, RATES, Method, Setting, for_many_objects, ours
from loi_mitsuba.scene.load import VARIANTS

# isort: split
import mitsuba as mi
import numpy as np

__all__ = ["SUBTABLES", "main", "subtable_of"]

SUBTABLES: Final = ("tuning", "ours", "published", "noise", "anywhere", "savings")
TUNING_SEED: Final = 100  # no other subtable has this seed
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
TUNING_COLUMN: Final = "Envlight"  # the column with the cheapest steps


def main(arguments: Sequence[str] | None = None) -> None:
    """Carry out the missing runs, and write all tables and pictures."""
    parser = argparse.ArgumentParser(prog="python -m examples.paper table2", description=__doc__)
    add_options(parser, "table2", SUBTABLES, "two methods, one start, one tiny column, few steps")
    parser.add_argument(
        "--methods", nargs="+", choices=list(LABELS), default=list(LABELS), help="methods (default: all)"
    )
    parser.add_argument("--seeds", type=int, default=3, help="number of starts (default: 3)")
    parser.add_argument("--variant", choices=VARIANTS, default=VARIANT, help=f"variant of Mitsuba (default: {VARIANT})")
    options = parser.parse_args(arguments)
    methods = tuple(method for method in LABELS if method in options.methods)
    columns = selected_columns(parser, options, COLUMNS)
    mi.set_variant(options.variant)
    names = [name for name in options.parts if name != "savings"]
    subtables = {name: subtable_of(name, methods, columns, options.seeds) for name in names}
    study = replace(STUDY, carry_out=partial(carry_out, variant=options.variant))
    if "savings" in options.parts and not (options.quick or options.report):
        timings = {"savings": savings(columns)}  # no record: times depend on the machine and its load
        study = replace(study, extra_tables=lambda results, subtables: _costs(results, subtables) | timings)
    carry_out_and_report(parser, options, study, {"ours": _quick()} if options.quick else subtables)


def subtable_of(
    name: str, methods: Sequence[Method] = tuple(LABELS), columns: Sequence[Column] = COLUMNS, seeds: int = 3
) -> Subtable[Run]:
    """Return the runs of a subtable; "savings" has no runs."""
    if name == "tuning":
        tuning_columns = [column for column in columns if column.name == TUNING_COLUMN]
        rows = {
            LABELS[method]: [
                Run(ours(method, rate), column, TUNING_SEED) for rate in RATES for column in tuning_columns
            ]
            for method in methods
        }
        return Subtable(rows, rates=RATES)
    settings = PROTOCOLS["published" if name == "published" else "ours"]
    if name == "noise":
        methods = [method for method in methods if method in NOISY_METHODS]
    columns = {"noise": NOISY, "anywhere": (ANYWHERE,)}.get(name, tuple(columns))
    rows = {
        LABELS[method]: [
            Run(_setting_in(settings[method], column), column, seed) for column in columns for seed in range(seeds)
        ]
        for method in methods
    }
    return Subtable(rows, columns)


def _setting_in(setting: Setting, column: Column) -> Setting:
    return for_many_objects(setting) if setting.name == "ours" and column.crowded else setting


def _quick() -> Subtable[Run]:
    column = replace(COLUMNS[4], width=32, samples=4)
    methods: tuple[Method, ...] = ("prdpt", "loi")
    settings = {method: replace(PROTOCOLS["ours"][method], steps=8) for method in methods}
    return Subtable({LABELS[method]: [Run(setting, column, 0)] for method, setting in settings.items()}, (column,))


def _costs(results: Results, subtables: Mapping[str, Subtable[Run]]) -> dict[str, list[str]]:
    return {f"cost, {name}": cost_of(results, subtables[name]) for name in subtables if name in PROTOCOLS}


def _animate(subtables: Mapping[str, Subtable[Run]], runs: Path, folder: Path) -> None:
    """Animate the first LOI fit of each column."""
    subtable = subtables.get("ours")
    for run in subtable.rows.get(LABELS["loi"], ()) if subtable else ():
        record = load(runs, run)
        if record is not None and run.seed == 0:
            problem = Problem.of(run.column, 0)
            images = (problem.picture(params, FRAME_SAMPLES) for params in moments(record["path"]))
            encoded = [np.clip(image, 0.0, 1.0) ** GAMMA for image in images]
            animation(folder / f"{slug(run.column.name)}.webp", encoded, _target(run))


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

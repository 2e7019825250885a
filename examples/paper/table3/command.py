"""``python -m examples.paper table3``: run Table 3, and write its tables, contact sheets and convergence plots."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from examples.paper.lib.study import Study, Subtable, add_options, carry_out_and_report, selected_columns
from examples.paper.table3.problem import COLUMNS, Column, FloatArray, Problem
from examples.paper.table3.published import PAPER
from examples.paper.table3.run import CURVE_STEPS, Run, carry_out
from examples.paper.table3.settings import LABELS, PROTOCOLS, RATES, Method, ours

__all__ = ["main"]

SUBTABLES: Final = ("tuning", "ours", "published")
SEEDS: Final = 10
TUNING_SEED: Final = 100  # no other subtable has this seed


def main(arguments: Sequence[str] | None = None) -> None:
    """Carry out the missing runs, and write all tables and pictures."""
    parser = argparse.ArgumentParser(prog="python -m examples.paper table3", description=__doc__)
    add_options(parser, "table3", SUBTABLES, "two methods, one start, one small column, few steps")
    parser.add_argument(
        "--methods", nargs="+", choices=list(LABELS), default=list(LABELS), help="methods (default: all)"
    )
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"number of starts (default: {SEEDS})")
    options = parser.parse_args(arguments)
    methods = tuple(method for method in LABELS if method in options.methods)
    columns = selected_columns(parser, options, COLUMNS)
    subtables = {name: _subtable(name, methods, columns, options.seeds) for name in options.parts}
    carry_out_and_report(parser, options, STUDY, {"ours": _quick()} if options.quick else subtables)


def _subtable(name: str, methods: Sequence[Method], columns: tuple[Column, ...], seeds: int) -> Subtable[Run]:
    if name == "tuning":
        rows = {
            LABELS[method]: [Run(ours(method, rate), column, TUNING_SEED) for rate in RATES for column in columns]
            for method in methods
        }
        return Subtable(rows, rates=RATES)
    settings = PROTOCOLS["published" if name == "published" else "ours"]
    rows = {
        LABELS[method]: [
            Run(settings[method], column, seed) for column in columns for seed in range(min(seeds, column.seeds))
        ]
        for method in methods
    }
    return Subtable(rows, columns)


def _quick() -> Subtable[Run]:
    column = replace(COLUMNS[3], side=32)
    methods: tuple[Method, ...] = ("rgbxy_finetune", "loi")
    settings = {method: replace(PROTOCOLS["ours"][method], steps=40, grid=16) for method in methods}
    return Subtable({LABELS[method]: [Run(setting, column, 0)] for method, setting in settings.items()}, (column,))


def _target(run: Run) -> FloatArray:
    return next(iter(Problem.of(run.column, run.seed).targets.values()))


STUDY: Final = Study(
    name="table3",
    carry_out=carry_out,
    target=_target,
    measures=("psnr", "ssim", "mae"),
    second_measure=lambda column: str(column.error).lower(),
    curve_steps=CURVE_STEPS,
    columns=COLUMNS,
    paper=PAPER,
    title=lambda column: f"{column.name}, {column.error}",
)

"""``python -m examples.paper table1``: run Table 1, and write its tables, contact sheets and convergence plots."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Final

from examples.paper.lib.study import Study, add_options, carry_out_and_report, selected_columns
from examples.paper.table1.extent import ABLATED, ABLATION_SEEDS, SEEDS, SUBTABLES, Extent
from examples.paper.table1.problem import COLUMNS, HARDER, Column, Image, Problem
from examples.paper.table1.published import PAPER
from examples.paper.table1.run import CURVE_STEPS, Run, carry_out
from examples.paper.table1.settings import LABELS

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Carry out the missing runs, and write all tables and pictures."""
    parser = argparse.ArgumentParser(prog="python -m examples.paper table1", description=__doc__)
    add_options(parser, "table1", SUBTABLES, "two methods, one start, 4 disks, few steps")
    parser.add_argument(
        "--methods", nargs="+", choices=list(LABELS), default=list(LABELS), help="methods (default: all)"
    )
    starts = f"number of starts (default: {SEEDS}, and {ABLATION_SEEDS} for remedies and ablations)"
    parser.add_argument("--seeds", type=int, default=SEEDS, help=starts)
    options = parser.parse_args(arguments)
    methods = tuple(method for method in LABELS if method in options.methods)
    if options.quick:
        extent = Extent(("ours",), ("pixel_l2", "loi"), (Column("4", 4, side=64),), (), (), 1, steps=60)
    else:
        selected = selected_columns(parser, options, (*COLUMNS, *HARDER))
        columns, harder, ablated = (
            tuple(column for column in group if column in selected) for group in (COLUMNS, HARDER, ABLATED)
        )
        ablation_seeds = min(options.seeds, ABLATION_SEEDS)
        extent = Extent(tuple(options.parts), methods, columns, harder, ablated, options.seeds, ablation_seeds)
    carry_out_and_report(parser, options, STUDY, extent.tables)


def _target(run: Run) -> Image:
    return Problem.of(run.column, run.seed).target


def _title(column: Column) -> str:
    return f"{column.name} disks" if column.name.isdigit() else column.name


STUDY: Final = Study(
    name="table1",
    carry_out=carry_out,
    target=_target,
    measures=("psnr", "ssim", "found"),
    second_measure=lambda _: "ssim",
    curve_steps=CURVE_STEPS,
    columns=COLUMNS,
    paper=PAPER,
    title=_title,
)

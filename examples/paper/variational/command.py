"""Command of the kaleidoscope and the orb: carry out runs, then write tables, pictures and an animation."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from examples.paper.lib.pages import fill
from examples.paper.lib.pictures import contact_sheet
from examples.paper.lib.runner import carry_out_all
from examples.paper.lib.study import check_out
from examples.paper.variational.drawing import animate, figure
from examples.paper.variational.problem import TRUTH_SEED, FloatArray
from examples.paper.variational.run import Run, carry_out, image_at, problem_of
from examples.paper.variational.settings import (
    CHOSEN,
    LABELS,
    QUICK,
    RATES,
    SIGMAS,
    SIZES,
    Method,
    Name,
    Setting,
    Size,
)
from examples.paper.variational.tables import csv_of, merged_csv, search_table, starts_table, summary
from loi_core.io.files import write_text
from loi_core.pixels.psnr import psnr

__all__ = ["run_scene"]

TABLES: Final = ("search", "starts", "truth")
DEFAULT_STARTS: Final = 10
SEARCH_SEED: Final = 101  # the start of the search, absent from all tables
ANIMATED_METHOD: Final[Method] = "paper"
PICTURED_SEEDS: Final[dict[Name, int]] = {"kaleidoscope": 1, "orb": 0}  # the first starts with different results


def run_scene(scene: Name, description: str | None, words: Sequence[str] | None = None) -> None:
    """Carry out the missing runs of a scene, and write all tables and pictures."""
    parser = argparse.ArgumentParser(
        prog=f"python -m examples.paper {scene}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    size = SIZES[scene]
    parser.add_argument("--quick", action="store_true", help="two methods, one start, small, a few steps")
    out_help = "output folder; finished runs in it are kept"
    parser.add_argument("--out", type=Path, default=Path("out") / scene, help=out_help)
    parser.add_argument("--processes", type=int, default=1, help="parallel runs; Mitsuba itself uses all cores (1)")
    parser.add_argument("--parts", nargs="+", choices=TABLES, default=list(TABLES), help="default: all")
    parser.add_argument("--methods", nargs="+", choices=list(LABELS), default=list(LABELS), help="default: all")
    parser.add_argument(
        "--seeds", type=int, default=DEFAULT_STARTS, help=f"number of starts (default: {DEFAULT_STARTS})"
    )
    parser.add_argument("--side", type=int, default=size.side, help=f"side of the image, in pixels ({size.side})")
    parser.add_argument("--samples", type=int, default=size.samples, help=f"samples per pixel ({size.samples})")
    parser.add_argument("--steps", type=int, default=size.steps, help=f"steps of each fit ({size.steps})")
    parser.add_argument("--report", action="store_true", help="report the finished runs and start none")
    parser.add_argument("--docs", type=Path, help="folder with variational.md; update its tables and pictures")
    options = parser.parse_args(words)
    if min(options.seeds, options.processes, options.samples, options.steps, options.side // 16) < 1:
        parser.error("--seeds, --processes, --samples and --steps must be 1 or more, --side 16 or more")
    check_out(parser, options.out)
    methods: list[Method] = [method for method in LABELS if method in options.methods]
    size = Size(options.side, options.samples, options.steps)
    if options.quick:
        methods, size, options.seeds, options.parts = ["pixels", "paper"], QUICK[scene], 1, ["starts"]
    tables = {table: _rows(scene, table, methods, size, options.seeds) for table in TABLES if table in options.parts}
    folder = options.out / "runs"
    all_runs = list(dict.fromkeys(run for rows in tables.values() for runs in rows.values() for run in runs))
    if not options.report:
        for rows in tables.values():
            ordered = sorted((run for runs in rows.values() for run in runs), key=lambda run: run.seed)
            carry_out_all(ordered, carry_out, folder, options.processes)
    groups = [group.label for group in problem_of(scene, size).groups]
    written = _tables(scene, tables, folder, size, groups)
    lines = [line for name, table in written.items() for line in (f"## {name}", "", *table, "")]
    numbers = csv_of(folder, all_runs, groups)
    write_text(options.out / "table.md", "\n".join(lines) + "\n")
    write_text(options.out / "runs.csv", numbers)
    print("\n".join(lines))
    _draw(scene, tables, folder, options.out)
    if options.docs:
        fill(options.docs / "variational.md", written)
        csv_path = options.docs / f"{scene}.csv"
        write_text(csv_path, merged_csv(numbers, csv_path))
        _draw(scene, tables, folder, options.docs / "images" / "variational")


def _rows(scene: Name, table: str, methods: Sequence[Method], size: Size, seeds: int) -> dict[str, list[Run]]:
    """Return the runs of a table by method."""
    rows = {}
    for method in methods:
        chosen = Setting(method, *CHOSEN[scene][method])
        if table == "search":
            settings = [Setting(method, rate, sigma) for rate in RATES[scene] for sigma in SIGMAS[scene]]
            rows[LABELS[method]] = [Run(scene, setting, size, SEARCH_SEED) for setting in settings]
        else:
            starts = range(seeds) if table == "starts" else [TRUTH_SEED]
            rows[LABELS[method]] = [Run(scene, chosen, size, seed) for seed in starts]
    return rows


def _tables(
    scene: Name, tables: dict[str, dict[str, list[Run]]], folder: Path, size: Size, groups: list[str]
) -> dict[str, list[str]]:
    """Return the lines of every table by its name."""
    written = {}
    for table, rows in tables.items():
        name = f"{scene} {table}"
        written[name] = search_table(folder, rows) if table == "search" else summary(folder, rows, groups)
        if table == "starts":
            written[f"{name}, each"] = starts_table(folder, rows)
    problem = problem_of(scene, size)
    at_truth = psnr(image_at(problem, problem.truth), problem.target)
    at_fit_samples = psnr(problem.images.render(problem.true_parameters(), seed=1), problem.target)
    written[f"{scene} floor"] = [
        f"The model at the truth: {at_truth:.1f} dB at many samples, {at_fit_samples:.1f} dB at {size.samples} a pixel."
    ]
    return written


def _draw(scene: Name, tables: dict[str, dict[str, list[Run]]], folder: Path, output: Path) -> None:
    """Draw the paper's figure for one start, the final images of all starts, and an animation of one fit of ours."""
    rows = tables.get("starts")
    if rows is None:
        return
    number = min(PICTURED_SEEDS[scene], max(map(len, rows.values())) - 1)
    figure(output / f"{scene}.png", folder, rows, number)
    contact_sheet(output / f"{scene}-starts.png", folder, rows, _target)
    for run in rows.get(LABELS[ANIMATED_METHOD], [])[number : number + 1]:
        animate(output / f"{scene}.webp", folder, run)


def _target(run: Run) -> FloatArray:
    return problem_of(run.scene, run.size).target

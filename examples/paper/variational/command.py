"""The command of either scene: the runs, then tables, pictures and an animation."""

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
from examples.paper.variational.problem import AT_TRUTH, FloatArray
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
from examples.paper.variational.tables import csv_of, kept_lines, search_table, starts_table, summary
from loi_core.io.files import write_text
from loi_core.pixels.psnr import psnr

__all__ = ["run_scene"]

PARTS: Final = ("search", "starts", "truth")
SEEDS: Final = 10
TUNED: Final = 101  # the start of the search, which no table has
SHOWN: Final[Method] = "paper"  # the method of the animation
FIRST: Final[dict[Name, int]] = {
    "kaleidoscope": 1,
    "orb": 0,
}  # the first start at which methods differ: that of pictures


def run_scene(scene: Name, about: str | None, words: Sequence[str] | None = None) -> None:
    """Carry out what is missing of a scene and write everything anew."""
    parser = argparse.ArgumentParser(
        prog=f"python -m examples.paper {scene}",
        description=about,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    size = SIZES[scene]
    parser.add_argument("--quick", action="store_true", help="two methods, one start, small, a few steps")
    parser.add_argument("--out", type=Path, default=Path("out") / scene, help="folder; what is in it is not done again")
    parser.add_argument("--processes", type=int, default=1, help="runs side by side; Mitsuba itself uses all cores (1)")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="default: all")
    parser.add_argument("--methods", nargs="+", choices=list(LABELS), default=list(LABELS), help="default: all")
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"starts (default: {SEEDS})")
    parser.add_argument("--side", type=int, default=size.side, help=f"of the image, in pixels ({size.side})")
    parser.add_argument("--samples", type=int, default=size.samples, help=f"per pixel ({size.samples})")
    parser.add_argument("--steps", type=int, default=size.steps, help=f"of each fit ({size.steps})")
    parser.add_argument("--report", action="store_true", help="do no more runs: report those that are done")
    parser.add_argument("--docs", type=Path, help="folder with variational.md, which gets tables and pictures")
    options = parser.parse_args(words)
    if min(options.seeds, options.processes, options.samples, options.steps, options.side // 16) < 1:
        parser.error("--seeds, --processes, --samples and --steps must be 1 or more, --side 16 or more")
    check_out(parser, options.out)
    methods: list[Method] = [method for method in LABELS if method in options.methods]
    asked = Size(options.side, options.samples, options.steps)
    if options.quick:
        methods, asked, options.seeds, options.parts = ["pixels", "paper"], QUICK[scene], 1, ["starts"]
    parts = {part: _rows(scene, part, methods, asked, options.seeds) for part in PARTS if part in options.parts}
    folder = options.out / "runs"
    every = list(dict.fromkeys(run for rows in parts.values() for runs in rows.values() for run in runs))
    if not options.report:
        for rows in parts.values():
            wanted = sorted((run for runs in rows.values() for run in runs), key=lambda run: run.seed)
            carry_out_all(wanted, carry_out, folder, options.processes)
    groups = [group.label for group in problem_of(scene, asked).groups]
    tables = _tables(scene, parts, folder, asked, groups)
    lines = [line for name, table in tables.items() for line in (f"## {name}", "", *table, "")]
    numbers = csv_of(folder, every, groups)
    write_text(options.out / "table.md", "\n".join(lines) + "\n")
    write_text(options.out / "runs.csv", numbers)
    print("\n".join(lines))
    _draw(scene, parts, folder, options.out)
    if options.docs:
        fill(options.docs / "variational.md", tables)
        shown = options.docs / f"{scene}.csv"
        write_text(shown, kept_lines(numbers, shown))
        _draw(scene, parts, folder, options.docs / "images" / "variational")


def _rows(scene: Name, part: str, methods: Sequence[Method], size: Size, seeds: int) -> dict[str, list[Run]]:
    """The runs of a part, by method."""
    rows = {}
    for method in methods:
        chosen = Setting(method, *CHOSEN[scene][method])
        if part == "search":
            settings = [Setting(method, rate, sigma) for rate in RATES[scene] for sigma in SIGMAS[scene]]
            rows[LABELS[method]] = [Run(scene, setting, size, TUNED) for setting in settings]
        else:
            starts = range(seeds) if part == "starts" else [AT_TRUTH]
            rows[LABELS[method]] = [Run(scene, chosen, size, seed) for seed in starts]
    return rows


def _tables(
    scene: Name, parts: dict[str, dict[str, list[Run]]], folder: Path, size: Size, groups: list[str]
) -> dict[str, list[str]]:
    tables = {}
    for part, rows in parts.items():
        name = f"{scene} {part}"
        tables[name] = search_table(folder, rows) if part == "search" else summary(folder, rows, groups)
        if part == "starts":
            tables[f"{name}, each"] = starts_table(folder, rows)
    problem = problem_of(scene, size)
    at_truth = psnr(image_at(problem, problem.truth), problem.target)
    drawn = psnr(problem.images.render(problem.at_truth(), seed=1), problem.target)
    tables[f"{scene} floor"] = [
        f"The model at the truth: {at_truth:.1f} dB at many samples, {drawn:.1f} dB at {size.samples} a pixel."
    ]
    return tables


def _draw(scene: Name, parts: dict[str, dict[str, list[Run]]], folder: Path, to: Path) -> None:
    """The paper's figure of a start, all ends of all starts, and a fit of ours."""
    rows = parts.get("starts")
    if rows is None:
        return
    number = min(FIRST[scene], max(map(len, rows.values())) - 1)
    figure(to / f"{scene}.png", folder, rows, number)
    contact_sheet(to / f"{scene}-starts.png", folder, rows, _target)
    for run in rows.get(LABELS[SHOWN], [])[number : number + 1]:
        animate(to / f"{scene}.webp", folder, run)


def _target(run: Run) -> FloatArray:
    return problem_of(run.scene, run.size).target

"""The paper's one-dimensional figures, and the width of every method's basin.

``python -m examples.paper figures1d`` measures all problems (minutes), writes ``figures-1d.csv`` and the pictures, and
updates the tables of ``figures-1d.md``. ``--quick`` measures too few starts for meaningful numbers.
"""

from __future__ import annotations

import argparse
import csv
import io
import itertools
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Final

import numpy as np

from examples.paper.figures.drawing1d import draw_landscapes, draw_support, draw_two
from examples.paper.figures.landscapes import NEAR_DISTANCE_PX, REACHED_DISTANCE_PX, Landscape
from examples.paper.figures.measure1d import Basin, Support, measure, measure_two, supports
from examples.paper.figures.signals import Host
from examples.paper.lib.pages import filled
from examples.paper.lib.problems import NOISE, PROBLEMS, SUPPORT, TONAL, TWO, Problem
from loi_core.io.files import write_text
from loi_core.support.markdown import markdown

__all__ = ["main"]

DOCS: Final = Path(__file__).parents[3] / "docs" / "results"
PAGE: Final = "figures-1d.md"
LANDSCAPE_PICTURES: Final = {  # by problem: the file, and the distance from the target that counts as success
    "signal": ("one-signal", REACHED_DISTANCE_PX),
    "picture": ("one-picture", REACHED_DISTANCE_PX),
    "three intensities in a row": ("tonal", REACHED_DISTANCE_PX),
    "light and dark in turns": ("turns", REACHED_DISTANCE_PX),
    "a dim one past a bright one": ("passing", REACHED_DISTANCE_PX),
    "signal, noise 0.1": ("noisy-signal", NEAR_DISTANCE_PX),
    "picture, noise 0.2": ("noisy-picture", NEAR_DISTANCE_PX),
}
QUICK_SPACINGS_PX: Final = {"signal": 0.7, "three intensities in a row": 1.4, "signal, noise 0.1": 2.6}


def main(arguments: Sequence[str]) -> None:
    """Measure all problems, draw the pictures, and write the tables."""
    parser = argparse.ArgumentParser(prog="python -m examples.paper figures1d", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few starts and one seed, for a test")
    parser.add_argument("--output", type=Path, default=DOCS, help="folder for the page, the numbers and the pictures")
    options = parser.parse_args(arguments)
    images = options.output / "images" / "figures-1d"
    problems = list(PROBLEMS)
    if options.quick:
        problems = [
            replace(problem, spacing=QUICK_SPACINGS_PX[problem.name], seeds=1)
            for problem in PROBLEMS
            if problem.name in QUICK_SPACINGS_PX
        ]
    basins: list[Basin] = []
    for problem in problems:
        print(problem.name, file=sys.stderr, flush=True)
        landscapes: dict[str, Landscape] = {}
        for basin, landscape in measure(problem):
            basins.append(basin)
            landscapes.setdefault(basin.method, landscape)  # of the first seed
        if problem.name in LANDSCAPE_PICTURES and not (options.quick and basins[0].problem != problem.name):
            name, distance = LANDSCAPE_PICTURES[problem.name]
            draw_landscapes(problem, landscapes, distance, images / f"{name}.png")
    names = {basin.problem for basin in basins}
    scales = list(supports([problem for problem in SUPPORT if problem.name in names]))
    draw_support(SUPPORT[0], images / "support.png")
    print(TWO.name, file=sys.stderr, flush=True)
    pairs = measure_two(TWO, *((4, 5) if options.quick else (64, 200)))
    draw_two(TWO, pairs, images / "two.png")
    tables = {
        "support": _support_table(scales),
        "one": _basin_table(basins, SUPPORT),
        "tonal": _basin_table(basins, TONAL),
        "two": _pair_table(pairs),
        "noise": _noise_table(basins),
    }
    for name, table in tables.items():
        print(f"\n{name}\n", *table, sep="\n")
    listed = {(basin.problem, basin.method) for basin in basins}
    scale_basins = [basin for scale in scales for basin in scale.basins if (basin.problem, basin.method) not in listed]
    write_text(options.output / "figures-1d.csv", _csv([*basins, *scale_basins, *_pair_basins(pairs)]))
    write_text(options.output / PAGE, filled((DOCS / PAGE).read_text(), tables))


def _support_table(scales: Sequence[Support]) -> list[str]:
    headings = ["sigma", "pixels that change", *(f"basin, {basin.problem}" for basin in scales[0].basins)]
    rows = ([f"{scale.sigma:g}", f"{scale.pixels:.0%}", *map(_interval, scale.basins)] for scale in scales)
    return markdown(headings, rows)


def _basin_table(basins: Sequence[Basin], problems: Sequence[Problem]) -> list[str]:
    """Methods by problems: the width of the basin on either side of the target in pixels, and its share of starts."""
    names = _measured_names(basins, problems)
    rows = [
        [method, *(_interval(basin) for name in names for basin in group if basin.problem == name)]
        for method, group in _by_method(basins)
    ]
    return markdown(["method", *names], rows)


def _measured_names(basins: Sequence[Basin], problems: Sequence[Problem]) -> list[str]:
    return [problem.name for problem in problems if problem.name in {basin.problem for basin in basins}]


def _interval(basin: Basin) -> str:
    return f"{basin.left:.1f} + {basin.right:.1f}, {basin.found:.0%}" if basin.found else "none"


def _noise_table(basins: Sequence[Basin]) -> list[str]:
    """Means over seeds: shares of starts that end within 0.1 and 0.5 pixels, and the distance of the minimum."""
    rows, names = [], _measured_names(basins, NOISE)
    for method, group in _by_method(basins):
        row = [method]
        for name in names:
            seeds = [basin for basin in group if basin.problem == name]
            reached_share = np.mean([basin.found for basin in seeds])
            near_share = np.mean([basin.near for basin in seeds])
            spread = np.std([basin.near for basin in seeds])
            offset = np.sqrt(np.mean([basin.offset**2 for basin in seeds]))
            row.append(f"{reached_share:.0%}, {near_share:.0%} +- {spread:.0%}, {offset:.2f}")
        rows.append(row)
    return markdown(["method", *names], rows)


def _pair_basins(pairs: dict[str, tuple[Host, Host]]) -> list[Basin]:
    """Return basins of the problem of two parameters: for all starts, and for starts in the order of the target."""
    basins = []
    for method, (starts, endpoints) in pairs.items():
        distances = np.max(np.abs(endpoints - TWO.target), axis=1)
        is_ordered = starts[:, 0] < starts[:, 1]
        for name, mask in ((TWO.name, np.ones_like(is_ordered)), (f"{TWO.name}, in order", is_ordered)):
            reached_share, near_share = (
                float(np.mean(distances[mask] <= distance)) if mask.any() else 0.0
                for distance in (REACHED_DISTANCE_PX, NEAR_DISTANCE_PX)
            )
            basins.append(Basin(name, method, 0, reached_share, near_share))
    return basins


def _pair_table(pairs: dict[str, tuple[Host, Host]]) -> list[str]:
    groups = itertools.groupby(_pair_basins(pairs), lambda basin: basin.method)
    return markdown(
        ["method", "all starts", "starts in the right order"],
        ([method, *(f"{basin.near:.0%}" for basin in group)] for method, group in groups),
    )


def _by_method(basins: Sequence[Basin]) -> list[tuple[str, list[Basin]]]:
    methods = dict.fromkeys(basin.method for basin in basins)
    return [(method, [basin for basin in basins if basin.method == method]) for method in methods]


def _csv(basins: Iterable[Basin]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(field.name for field in fields(Basin))
    for basin in basins:
        writer.writerow(f"{value:.6g}" if isinstance(value, float) else value for value in asdict(basin).values())
    return text.getvalue()

"""The paper's one-dimensional figures, and how wide the basin of every method is.

``python -m examples.paper figures1d`` measures all problems (minutes), writes ``figures-1d.csv`` and the pictures, and
puts the tables into ``figures-1d.md``; ``--quick`` tries few starts, of which the numbers mean little.
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
from examples.paper.figures.landscapes import FOUND, NEAR, Landscape
from examples.paper.figures.measure1d import Basin, Support, measure, measure_two, supports
from examples.paper.figures.signals import Host
from examples.paper.lib.pages import filled
from examples.paper.lib.problems import NOISE, PROBLEMS, SUPPORT, TONAL, TWO, Problem
from loi_core.io.files import write_text
from loi_core.support.markdown import markdown

__all__ = ["main"]

DOCS: Final = Path(__file__).parents[3] / "docs" / "results"
PAGE: Final = "figures-1d.md"
DRAWN: Final = {  # pictures of landscapes: their files, and the distance from the target that counts as found
    "signal": ("one-signal", FOUND),
    "picture": ("one-picture", FOUND),
    "three intensities in a row": ("tonal", FOUND),
    "light and dark in turns": ("turns", FOUND),
    "a dim one past a bright one": ("passing", FOUND),
    "signal, noise 0.1": ("noisy-signal", NEAR),
    "picture, noise 0.2": ("noisy-picture", NEAR),
}
QUICK: Final = {"signal": 0.7, "three intensities in a row": 1.4, "signal, noise 0.1": 2.6}  # and their spacing


def main(arguments: Sequence[str]) -> None:
    """Measure, draw and write."""
    parser = argparse.ArgumentParser(prog="python -m examples.paper figures1d", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few starts and one seed, for a test")
    parser.add_argument("--output", type=Path, default=DOCS, help="folder for the page, the numbers and the pictures")
    options = parser.parse_args(arguments)
    images = options.output / "images" / "figures-1d"
    problems = list(PROBLEMS)
    if options.quick:
        problems = [replace(one, spacing=QUICK[one.name], seeds=1) for one in PROBLEMS if one.name in QUICK]
    basins: list[Basin] = []
    for problem in problems:
        print(problem.name, file=sys.stderr, flush=True)
        landscapes: dict[str, Landscape] = {}
        for basin, found in measure(problem):
            basins.append(basin)
            landscapes.setdefault(basin.method, found)  # of the first seed
        if problem.name in DRAWN and not (options.quick and basins[0].problem != problem.name):
            name, within = DRAWN[problem.name]
            draw_landscapes(problem, landscapes, within, images / f"{name}.png")
    scales = list(supports([one for one in SUPPORT if one.name in {basin.problem for basin in basins}]))
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
    known = {(one.problem, one.method) for one in basins}
    alone = [one for scale in scales for one in scale.basins if (one.problem, one.method) not in known]
    write_text(options.output / "figures-1d.csv", _csv([*basins, *alone, *_pair_basins(pairs)]))
    write_text(options.output / PAGE, filled((DOCS / PAGE).read_text(), tables))


def _support_table(scales: Sequence[Support]) -> list[str]:
    heads = ["sigma", "pixels that change", *(f"basin, {one.problem}" for one in scales[0].basins)]
    return markdown(heads, ([f"{one.sigma:g}", f"{one.pixels:.0%}", *map(_interval, one.basins)] for one in scales))


def _basin_table(basins: Sequence[Basin], problems: Sequence[Problem]) -> list[str]:
    """Methods by problems: the basin's reach to both sides of the target in pixels, and its share of all starts."""
    names = _measured(basins, problems)
    rows = [
        [method, *(_interval(one) for name in names for one in group if one.problem == name)]
        for method, group in _by_method(basins)
    ]
    return markdown(["method", *names], rows)


def _measured(basins: Sequence[Basin], problems: Sequence[Problem]) -> list[str]:
    return [one.name for one in problems if one.name in {basin.problem for basin in basins}]


def _interval(basin: Basin) -> str:
    return f"{basin.left:.1f} + {basin.right:.1f}, {basin.found:.0%}" if basin.found else "none"


def _noise_table(basins: Sequence[Basin]) -> list[str]:
    """Means over seeds: shares of starts that end within 0.1 and 0.5 pixels, and the minimum's distance."""
    rows, names = [], _measured(basins, NOISE)
    for method, group in _by_method(basins):
        row = [method]
        for name in names:
            seeds = [one for one in group if one.problem == name]
            found, near = (np.mean([getattr(one, share) for one in seeds]) for share in ("found", "near"))
            spread = np.std([one.near for one in seeds])
            offset = np.sqrt(np.mean([one.offset**2 for one in seeds]))
            row.append(f"{found:.0%}, {near:.0%} +- {spread:.0%}, {offset:.2f}")
        rows.append(row)
    return markdown(["method", *names], rows)


def _pair_basins(pairs: dict[str, tuple[Host, Host]]) -> list[Basin]:
    """Of the problem of two parameters: all starts, and those in which the two are in the target's order."""
    made = []
    for method, (starts, ends) in pairs.items():
        away = np.max(np.abs(ends - TWO.target), axis=1)
        ordered = starts[:, 0] < starts[:, 1]
        for name, some in ((TWO.name, np.ones_like(ordered)), (f"{TWO.name}, in order", ordered)):
            found, near = (float(np.mean(away[some] <= within)) if some.any() else 0.0 for within in (FOUND, NEAR))
            made.append(Basin(name, method, 0, found, near))
    return made


def _pair_table(pairs: dict[str, tuple[Host, Host]]) -> list[str]:
    rows = itertools.groupby(_pair_basins(pairs), lambda one: one.method)
    return markdown(
        ["method", "all starts", "starts in the right order"],
        ([method, *(f"{one.near:.0%}" for one in group)] for method, group in rows),
    )


def _by_method(basins: Sequence[Basin]) -> list[tuple[str, list[Basin]]]:
    return [(name, [one for one in basins if one.method == name]) for name in dict.fromkeys(b.method for b in basins)]


def _csv(basins: Iterable[Basin]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(field.name for field in fields(Basin))
    for one in basins:
        writer.writerow(f"{value:.6g}" if isinstance(value, float) else value for value in asdict(one).values())
    return text.getvalue()

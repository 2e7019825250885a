"""Which way the loss sends each of many disks of random colours.

``python -m examples.paper guidance`` stands disks at random places, and prints the cosine between the direction in
which the loss falls fastest with the place of a disk and the way to where that disk belongs: 1 is straight there, 0 is
no guidance. ``--docs docs/results`` puts the table into ``table1.md``; ``--quick`` tries few disks.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from tqdm import tqdm

from examples.paper.lib.means import Mean
from examples.paper.lib.pages import fill
from examples.paper.table1.ablations import WIDTHS
from examples.paper.table1.objectives import objective
from examples.paper.table1.problem import FRINGE, HARDER, Column, FloatArray, Problem
from examples.paper.table1.settings import OURS, Setting
from loi_core import ScaleSpace
from loi_core.support.markdown import markdown

__all__ = ["cosines", "main"]

RANDOM: Final = next(column for column in HARDER if column.colours == "random")
COUNTS: Final = (1, 4, 16, 64)
SEEN: Final = 512  # disks behind every number
FINE: Final = 1.0 / 32.0
_OURS: Final = OURS["loi"]
SETTINGS: Final = (
    _OURS,
    replace(_OURS, name="tonal scale 1/32", scales=ScaleSpace(WIDTHS, WIDTHS, FINE)),
    replace(_OURS, name="13 sums of channels", channels="sums"),
    replace(_OURS, name="inner scale 0, widest extent", scales=ScaleSpace(0.0, WIDTHS[-1], 0.125)),
    replace(_OURS, name="the same, tonal scale 1/32", scales=ScaleSpace(0.0, WIDTHS[-1], FINE)),
)


def main(words: Sequence[str] | None = None) -> None:
    """Measure, print, and write."""
    parser = argparse.ArgumentParser(prog="python -m examples.paper guidance", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few disks, for a test")
    parser.add_argument("--docs", type=Path, help="folder with table1.md, which gets the table")
    options = parser.parse_args(words)
    counts, seen = ((1, 4), 8) if options.quick else (COUNTS, SEEN)
    rows: dict[str, list[str]] = {setting.name: [] for setting in SETTINGS}
    for setting, count in tqdm([(one, count) for one in SETTINGS for count in counts]):
        column = replace(RANDOM, disks=count)
        found = Mean.of(np.concatenate([cosines(setting, column, seed) for seed in range(seen // count)]).tolist())
        rows[setting.name].append(f"{found.value:.2f} ± {found.half_width:.2f}")
    table = markdown(["disks", *map(str, counts)], [[name, *cells] for name, cells in rows.items()])
    print("\n".join(table))
    if options.docs:
        fill(options.docs / "table1.md", {"guidance": table})


def cosines(setting: Setting, column: Column, seed: int) -> FloatArray:
    """Of each disk, at random places of the part of the frame that the grid fills, parted; shape (n,)."""
    problem = Problem.of(column, seed)
    disks = problem.disks(confine=True)
    low, high = FRINGE * column.side, (1.0 - FRINGE) * column.side
    places = np.random.default_rng([seed, 1]).uniform(low, high, (column.disks, 2))
    start = disks.parameters()
    params = disks.project(start | {"positions": places.astype(start["positions"].dtype)})
    image, pullback = disks.render_vjp(params)
    _, cotangent = objective(setting, problem.reference).value_and_grad(image)
    falls = -np.asarray(pullback(cotangent)["positions"], dtype=np.float64)
    ways = problem.goal - params["positions"]
    found: FloatArray = np.sum(falls * ways, axis=1) / np.linalg.norm(falls, axis=1) / np.linalg.norm(ways, axis=1)
    return found

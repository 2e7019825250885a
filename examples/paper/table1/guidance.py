"""How well the gradient of the loss points each of many disks of random colours to its target.

``python -m examples.paper guidance`` places disks at random, and prints the cosine between the negative gradient of the
loss by the position of a disk and the direction to the target of that disk: 1 points straight at the target, 0 is no
guidance. ``--docs docs/results`` puts the table into ``table1.md``; ``--quick`` tries few disks.
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
SAMPLED_DISKS: Final = 512  # for every cell
FINE_TONAL_SCALE: Final = 1.0 / 32.0
_LOI: Final = OURS["loi"]
SETTINGS: Final = (
    _LOI,
    replace(_LOI, name="tonal scale 1/32", scales=ScaleSpace(WIDTHS, WIDTHS, FINE_TONAL_SCALE)),
    replace(_LOI, name="13 sums of channels", channels="sums"),
    replace(_LOI, name="inner scale 0, widest extent", scales=ScaleSpace(0.0, WIDTHS[-1], 0.125)),
    replace(_LOI, name="the same, tonal scale 1/32", scales=ScaleSpace(0.0, WIDTHS[-1], FINE_TONAL_SCALE)),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the cosines, print their table, and write it to the documentation."""
    parser = argparse.ArgumentParser(prog="python -m examples.paper guidance", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few disks")
    parser.add_argument("--docs", type=Path, help="folder with table1.md; update its table")
    options = parser.parse_args(arguments)
    counts, sampled_disks = ((1, 4), 8) if options.quick else (COUNTS, SAMPLED_DISKS)
    rows: dict[str, list[str]] = {setting.name: [] for setting in SETTINGS}
    for setting, count in tqdm([(setting, count) for setting in SETTINGS for count in counts]):
        column = replace(RANDOM, disks=count)
        seeds = range(sampled_disks // count)
        mean = Mean.of(np.concatenate([cosines(setting, column, seed) for seed in seeds]).tolist())
        rows[setting.name].append(f"{mean.value:.2f} ± {mean.half_width:.2f}")
    table = markdown(["disks", *map(str, counts)], [[name, *cells] for name, cells in rows.items()])
    print("\n".join(table))
    if options.docs:
        fill(options.docs / "table1.md", {"guidance": table})


def cosines(setting: Setting, column: Column, seed: int) -> FloatArray:
    """Return the cosine of each disk, shape (n,), at random positions without overlap in the area of the grid."""
    problem = Problem.of(column, seed)
    disks = problem.disks(confine=True)
    margin = FRINGE * column.side
    positions = np.random.default_rng([seed, 1]).uniform(margin, (1.0 - FRINGE) * column.side, (column.disks, 2))
    start = disks.parameters()
    params = disks.project(start | {"positions": positions.astype(start["positions"].dtype)})
    image, pullback = disks.render_vjp(params)
    _, cotangent = objective(setting, problem.reference).value_and_grad(image)
    descent = -np.asarray(pullback(cotangent)["positions"], dtype=np.float64)
    offsets = problem.goal - params["positions"]
    products = np.sum(descent * offsets, axis=1)
    normalised: FloatArray = products / np.linalg.norm(descent, axis=1) / np.linalg.norm(offsets, axis=1)
    return normalised

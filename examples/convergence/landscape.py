"""Draw the loss of every scale along the straight way from start to goal: ``python -m examples.convergence.landscape``.

Three scenes of the suite on which the objective alone fails. Where a curve rises along the way, that scale points away.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np

from examples.convergence.__main__ import cases
from examples.convergence.case import Trial
from loi_core import LOIObjective, ScaleSpace
from loi_core.io.files import write_bytes
from loi_core.report.plots import new_figure, png_of
from loi_core.support.arrays import Host, from_numpy, to_numpy

SCENES: Final = (("warp: picture on checkers", 0), ("vector: ellipse on a photograph", 0), ("Mitsuba: ball on wood", 0))
PLACES: Final = 49


def along(trial: Trial) -> list[Host]:
    """Images on the straight way from the start to the goal."""
    whole = trial.renderer.parameters()
    images = []
    for share in np.linspace(0.0, 1.0, PLACES):
        params = dict(whole)
        for name, goal in trial.goal.items():
            start = np.asarray(trial.free[name].initial, dtype=np.float64)
            params[name] = _like((1.0 - share) * start + share * goal, whole[name])
        images.append(to_numpy(trial.renderer.render(params, seed=0)))
    return images


def _like(values: Host, like: Any) -> Any:
    return from_numpy(np.asarray(values), like)


def relative(values: Iterable[float]) -> Host:
    """Values in units of the first."""
    found = np.asarray(list(values))
    shares: Host = found / found[0]
    return shares


def main() -> None:
    """Draw the figure."""
    parser = argparse.ArgumentParser(prog="python -m examples.convergence.landscape", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/images/far-to-near.png"))
    options = parser.parse_args()
    known = {case.name: case for case in cases("")}
    figure = new_figure(11.0, 3.6)
    axes = figure.subplots(1, len(SCENES), sharey=True)
    way = np.linspace(0.0, 1.0, PLACES)
    for panel, (name, seed) in zip(axes, SCENES, strict=True):
        trial = known[name].make(seed)
        images = along(trial)
        height, width = trial.target.shape[:2]
        far, near = (LOIObjective(trial.target, scales) for scales in ScaleSpace.far_to_near(height, width))
        terms = [near.terms(image) for image in images]
        widths = sorted({key[0] for key in terms[0]})
        for index, alpha in enumerate(widths):
            sums = relative(sum(float(one[key]) for key in one if key[0] == alpha) for one in terms)
            shade = mpl.colormaps["viridis"](0.9 * index / max(len(widths) - 1, 1))
            panel.plot(way, sums, color=shade, lw=0.9, label=f"extent {alpha:g}")
        panel.plot(way, relative(float(near.value(image)) for image in images), "k--", lw=1.6, label="all of for_image")
        panel.plot(
            way, relative(float(far.value(image)) for image in images), color="#c2410c", lw=2.2, label="far stage"
        )
        panel.set(title=name, xlabel="way from the start to the goal", ylim=(0.0, 1.4))
        panel.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("loss, relative to the start")
    axes[-1].legend(frameon=False, fontsize=7, loc="lower left")
    write_bytes(options.output, png_of(figure))
    print(options.output)


if __name__ == "__main__":
    main()

"""Draw the loss of every scale along the line from start to goal: ``python -m examples.convergence.landscape``.

Three scenes of the suite where the objective alone fails. Where a curve rises, its scale points away from the goal.
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
from examples.plots import new_figure, png_of
from loi_core import LOIObjective, ScaleSpace
from loi_core.io.files import write_bytes
from loi_core.support.arrays import Host, from_numpy, to_numpy

SCENES: Final = (("warp: picture on checkers", 0), ("vector: ellipse on a photograph", 0), ("Mitsuba: ball on wood", 0))
LINE_POINTS: Final = 49


def images_along_line(trial: Trial) -> list[Host]:
    """Return images along the line from the start to the goal."""
    whole = trial.renderer.parameters()
    images = []
    for share in np.linspace(0.0, 1.0, LINE_POINTS):
        params = dict(whole)
        for name, goal in trial.goal.items():
            start = np.asarray(trial.free[name].initial, dtype=np.float64)
            params[name] = _like((1.0 - share) * start + share * goal, whole[name])
        images.append(to_numpy(trial.renderer.render(params, seed=0)))
    return images


def _like(values: Host, like: Any) -> Any:
    return from_numpy(np.asarray(values), like)


def relative(values: Iterable[float]) -> Host:
    """Return values in units of the first."""
    array = np.asarray(list(values))
    ratios: Host = array / array[0]
    return ratios


def main() -> None:
    """Draw the figure."""
    parser = argparse.ArgumentParser(prog="python -m examples.convergence.landscape", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/images/far-to-near.png"))
    options = parser.parse_args()
    suite = {case.name: case for case in cases("")}
    figure = new_figure(11.0, 3.6)
    axes = figure.subplots(1, len(SCENES), sharey=True)
    fractions = np.linspace(0.0, 1.0, LINE_POINTS)
    for panel, (name, seed) in zip(axes, SCENES, strict=True):
        trial = suite[name].make(seed)
        images = images_along_line(trial)
        height, width = trial.target.shape[:2]
        far_objective, _, near_objective = (
            LOIObjective(trial.target, scales) for scales in ScaleSpace.far_to_near(height, width)
        )
        terms = [near_objective.terms(image) for image in images]
        widths = sorted({key[0] for key in terms[0]})
        for index, alpha in enumerate(widths):
            sums = relative(sum(float(values[key]) for key in values if key[0] == alpha) for values in terms)
            shade = mpl.colormaps["viridis"](0.9 * index / max(len(widths) - 1, 1))
            panel.plot(fractions, sums, color=shade, lw=0.9, label=f"extent {alpha:g}")
        panel.plot(
            fractions,
            relative(float(near_objective.value(image)) for image in images),
            "k--",
            lw=1.6,
            label="all of for_image",
        )
        panel.plot(
            fractions,
            relative(float(far_objective.value(image)) for image in images),
            color="#c2410c",
            lw=2.2,
            label="far stage",
        )
        panel.set(title=name, xlabel="fraction of the line from start to goal", ylim=(0.0, 1.4))
        panel.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("loss, relative to the start")
    axes[-1].legend(frameon=False, fontsize=7, loc="lower left")
    write_bytes(options.output, png_of(figure))
    print(options.output)


if __name__ == "__main__":
    main()

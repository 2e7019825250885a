"""What each scale of an objective adds along the way, as a table, and what it pulls at, as pictures."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from loi_core.fitting.views import by_view
from loi_core.io.images import write_png
from loi_core.io.result_folder import ResultFolder
from loi_core.method.comparison import ScaleKey
from loi_core.pixels.signed import about_grey
from loi_core.scenes.by_scale import scale_objectives, scale_pulls
from loi_core.scenes.experiment import Trial
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Host, to_numpy

__all__ = [
    "COLUMNS",
    "GRADIENTS_FOLDER",
    "MOMENTS",
    "gradient_file",
    "scale_entries",
    "scale_name",
    "scale_table",
    "write_gradients",
]

GRADIENTS_FOLDER: Final = "gradients"
COLUMNS: Final = ("step", "sigma", "alpha", "beta", "value")
MOMENTS: Final = ("start", "end")
MOST_SCALES: Final = 24  # that have pictures


def scale_table(trial: Trial) -> str:
    """``scales.csv``: a row for each recorded step and scale; empty if the objective has no scales."""
    done = len(trial.result.history) if trial.result else 0
    rows = [
        (step, f"{sigma:.9g}", f"{alpha:.9g}", f"{beta:.9g}", repr(value))
        for step, terms in sorted(trial.terms.items())
        if step < done
        for (alpha, beta, sigma), value in terms.items()
    ]
    if not rows:
        return ""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(rows)
    return stream.getvalue()


def scale_name(sigma: float, alpha: float, beta: float) -> str:
    """A scale by its numbers, for people."""
    return f"sigma {sigma:g}, alpha {alpha:g}, beta {beta:g}"


def gradient_file(moment: str, sigma: float, alpha: float, beta: float) -> str:
    """The picture of what a scale pulls at, within the folder of results; `moment` is "start" or "end"."""
    return f"{GRADIENTS_FOLDER}/{moment}-sigma-{sigma:.9g}-alpha-{alpha:.9g}-beta-{beta:.9g}.png"


def write_gradients(folder: ResultFolder, scene: Scene, trial: Trial) -> dict[ScaleKey, dict[str, float]]:
    """Write what each scale pulls at, at the start and at the end; how strongly, by scale and moment.

    Every picture has a scale of its own, so that a pull of any strength is seen: mid grey is none, brighter is where
    the scale wants the image brighter. The strength is the 2-norm.
    """
    strengths: dict[ScaleKey, dict[str, float]] = {}
    pictures: dict[str, Host] = {}
    if trial.result is not None and 0 < _count(scene, trial) <= MOST_SCALES:
        ends = {name: to_numpy(one) for name, one in by_view(trial.result.image).items()}
        for moment, images in zip(MOMENTS, (trial.starts, ends), strict=True):
            if set(images) != set(scene.views):
                continue
            for (alpha, beta, sigma), pull in scale_pulls(scene, trial.objective, images).items():
                strengths.setdefault((alpha, beta, sigma), {})[moment] = float(np.linalg.norm(pull))
                pictures[gradient_file(moment, sigma, alpha, beta)] = pull
    folder.remove(set(folder.listed(GRADIENTS_FOLDER)) - set(pictures))
    folder.claim(pictures)
    for name, pull in pictures.items():
        write_png(folder.path / name, about_grey(pull))
    return strengths


def scale_entries(strengths: Mapping[ScaleKey, Mapping[str, float]]) -> list[dict[str, Any]]:
    """The scales that have pictures, and how strongly they pull, as plain values for JSON."""
    return [
        {"sigma": sigma, "alpha": alpha, "beta": beta, "pull": dict(moments)}
        for (alpha, beta, sigma), moments in strengths.items()
    ]


def _count(scene: Scene, trial: Trial) -> int:
    return sum(len(one.scales.keys) for one in scale_objectives(scene, trial.objective).values())

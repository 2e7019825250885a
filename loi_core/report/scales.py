"""The value of each scale along a fit as a table, and its gradient as pictures."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from loi_core.fitting.views import by_view
from loi_core.io.images import write_png
from loi_core.io.result_folder import ResultFolder
from loi_core.pixels.display import signed_to_grey
from loi_core.report.names import GRADIENTS_FOLDER, MOMENTS, gradient_file
from loi_core.report.tables import SCALE_COLUMNS, csv_text
from loi_core.scenes.recorder import Trial
from loi_core.scenes.scale_terms import scale_descent, scale_objectives
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Host, to_numpy

__all__ = ["scale_table", "write_gradients"]

MAX_SCALES: Final = 24  # an objective with more scales gets no pictures


def scale_table(trial: Trial) -> str:
    """Return ``scales.csv``, a row for each recorded step and scale; empty if the objective has no scales."""
    done = len(trial.result.history) if trial.result else 0
    rows = [
        (step, f"{sigma:.9g}", f"{alpha:.9g}", f"{beta:.9g}", repr(value))
        for step, terms in sorted(trial.terms.items())
        if step < done
        for (alpha, beta, sigma), value in terms.items()
    ]
    return csv_text(SCALE_COLUMNS, rows) if rows else ""


def write_gradients(folder: ResultFolder, scene: Scene, trial: Trial) -> list[dict[str, Any]]:
    """Write the negative gradient of each scale at the start and at the end as pictures.

    Each picture has its own range, so that a gradient of any size is visible: mid grey is 0, and the scale wants
    brighter pixels brighter.

    Returns
    -------
    list of dict
        The scales that have pictures, with the 2-norms of their gradients, as plain values for JSON.
    """
    entries: dict[tuple[float, float, float], dict[str, Any]] = {}
    pictures: dict[str, Host] = {}
    if trial.result is not None and 0 < _count(scene, trial) <= MAX_SCALES:
        final_images = {name: to_numpy(image) for name, image in by_view(trial.result.image).items()}
        for moment, images in zip(MOMENTS, (trial.starts, final_images), strict=True):
            if set(images) != set(scene.views):
                continue
            for (alpha, beta, sigma), pull in scale_descent(scene, trial.objective, images).items():
                empty = {"sigma": sigma, "alpha": alpha, "beta": beta, "gradient_norm": {}}
                entry = entries.setdefault((alpha, beta, sigma), empty)
                entry["gradient_norm"][moment] = float(np.linalg.norm(pull))
                pictures[gradient_file(moment, sigma, alpha, beta)] = pull
    folder.remove(set(folder.pictures(GRADIENTS_FOLDER)) - set(pictures))
    for name, pull in pictures.items():
        write_png(folder.file(name), signed_to_grey(pull))
    return list(entries.values())


def _count(scene: Scene, trial: Trial) -> int:
    return sum(len(objective.scales.keys) for objective in scale_objectives(scene, trial.objective).values())

"""One fit of a sweep, in a process of its own: what `loi fit` does, without a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from loi_core.errors import LoiError, ParameterError
from loi_core.fitting.parameters import bounds_of, starting_parameters
from loi_core.fitting.race import draw_starts
from loi_core.io.result_folder import CHECKPOINT_FILE, ResultFolder
from loi_core.report import write_page, write_results
from loi_core.scenes.experiment import Trial, run_scene
from loi_core.scenes.reading import make_scene
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import to_numpy

__all__ = ["FitTask", "carry_out", "refusal"]


@dataclass(frozen=True, eq=False)
class FitTask:
    """What a process has to know of a fit.

    Attributes
    ----------
    name : str
        Of its run.
    scene : Path
        Its scene file, to whose folder paths are relative.
    document : dict
        What stands in that file, with what varies put in.
    start : int
        Which of the places within the bounds it starts from; 0 is the scene's own.
    output : Path
        Folder of its results.
    """

    name: str
    scene: Path
    document: Mapping[str, Any]
    start: int
    output: Path


def refusal(task: FitTask) -> str:
    """What is wrong with the scene of a fit, on one line; empty if nothing is. Nothing is written."""
    try:
        _scene(task)
    except LoiError as error:
        return str(error)
    return ""


def carry_out(task: FitTask) -> dict[str, Any]:
    """Fit, write what `loi fit` writes, and give what a sweep keeps of it.

    A fit that was cut off goes on from its checkpoint, and one that has failed keeps it; one that is done removes it.
    """
    scene = _scene(task)
    folder = ResultFolder(scene.output)
    folder.claim()
    trials = _fitted(scene)
    entry = write_results(scene, trials)["trials"][0]
    write_page(scene.output)
    if not entry["error"]:  # of all that is left they are nine tenths, and many runs are left
        folder.remove([CHECKPOINT_FILE])
    found = entry.get("diagnosis") or {}
    # Of equal images PSNR is infinite, for which JSON has no number.
    psnr = entry.get("psnr") if entry.get("psnr") is not None or "psnr" not in entry else math.inf
    return {
        "objective": entry["objective"],
        "verdict": found.get("verdict", ""),
        "psnr": psnr,
        "psnr_initial": entry.get("psnr_initial"),
        "value": entry.get("value"),
        "errors": entry.get("parameter_errors", {}),
        "best_step": entry.get("best_step"),
        "steps": entry.get("steps_done"),
        "seconds": entry.get("seconds"),
        "cause": entry["error"] or "",
    }


def _scene(task: FitTask) -> Scene:
    scene = make_scene(task.document, task.scene, output=task.output)
    if task.start == 0:
        return scene
    params = starting_parameters(scene, scene.optimise)
    place = draw_starts(params, bounds_of(params, scene.optimise), 2, first=task.start)[1]
    moved = {name: replace(free, initial=to_numpy(place[name])) for name, free in scene.optimise.items()}
    return replace(scene, optimise=moved)


def _fitted(scene: Scene) -> list[Trial]:
    checkpoint = scene.output / CHECKPOINT_FILE
    try:
        return run_scene(scene, checkpoint=checkpoint, resume=True)
    except ParameterError:  # damaged, or from before something changed that a sweep does not know of
        ResultFolder(scene.output).remove([CHECKPOINT_FILE])
        return run_scene(scene, checkpoint=checkpoint)

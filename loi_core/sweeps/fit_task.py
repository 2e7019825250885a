"""One fit of a sweep, executed in a worker process: `loi fit` without a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from loi_core.errors import LoiError, ParameterError
from loi_core.fitting.parameters import bounds_of, starting_parameters
from loi_core.fitting.starts import draw_starts
from loi_core.io.result_folder import CHECKPOINT_FILE, ResultFolder
from loi_core.report import write_page, write_results
from loi_core.report.output import frame_writer
from loi_core.scenes.experiment import run_scene
from loi_core.scenes.reading import make_scene
from loi_core.scenes.recorder import Trial
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import to_numpy

__all__ = ["FitTask", "run_fit", "scene_error"]


@dataclass(frozen=True, eq=False)
class FitTask:
    """A fit, as sent to a worker process.

    Attributes
    ----------
    name : str
        Name of the run.
    scene : Path
        The scene file; paths in `document` are relative to its folder.
    document : dict
        Content of the scene file, with the varied values in place.
    start : int
        Index of the starting point within the bounds; 0 is the scene's own.
    output : Path
        Folder of the results.
    """

    name: str
    scene: Path
    document: Mapping[str, Any]
    start: int
    output: Path


def scene_error(task: FitTask) -> str:
    """Return the error in the scene of a fit, on one line; empty if the scene is valid. Writes nothing."""
    try:
        _make_scene(task)
    except LoiError as error:
        return str(error)
    return ""


def run_fit(task: FitTask) -> dict[str, Any]:
    """Run a fit, write the files of `loi fit`, and return the record of the run.

    An interrupted fit continues from its checkpoint. A failed fit keeps the checkpoint; a finished fit removes it.
    """
    scene = _make_scene(task)
    folder = ResultFolder(scene.output)
    folder.claim()
    trials = _run(scene, folder)
    entry = write_results(scene, trials)["trials"][0]
    write_page(scene.output)
    if not entry["error"]:  # checkpoints would take nine tenths of the space of a sweep
        folder.remove([CHECKPOINT_FILE])
    diagnosis = entry.get("diagnosis") or {}
    # Equal images have infinite PSNR, which JSON cannot represent.
    psnr = entry.get("psnr") if entry.get("psnr") is not None or "psnr" not in entry else math.inf
    return {
        "objective": entry["objective"],
        "verdict": diagnosis.get("verdict", ""),
        "psnr": psnr,
        "psnr_initial": entry.get("psnr_initial"),
        "value": entry.get("value"),
        "errors": entry.get("parameter_errors", {}),
        "best_step": entry.get("best_step"),
        "steps": entry.get("steps_done"),
        "seconds": entry.get("seconds"),
        "cause": entry["error"] or "",
    }


def _make_scene(task: FitTask) -> Scene:
    scene = make_scene(task.document, task.scene, output=task.output)
    if task.start == 0:
        return scene
    params = starting_parameters(scene, scene.optimise)
    start = draw_starts(params, bounds_of(params, scene.optimise), 2, first=task.start)[1]
    return replace(
        scene,
        optimise={name: replace(free, initial=to_numpy(start[name])) for name, free in scene.optimise.items()},
    )


def _run(scene: Scene, folder: ResultFolder) -> list[Trial]:
    checkpoint, write_frame = folder.file(CHECKPOINT_FILE), frame_writer(scene, folder)
    try:
        return run_scene(scene, checkpoint=checkpoint, resume=True, write_frame=write_frame)
    except ParameterError:  # the checkpoint is damaged, or something outside the sweep has changed since
        folder.remove([CHECKPOINT_FILE])
        return run_scene(scene, checkpoint=checkpoint, write_frame=write_frame)

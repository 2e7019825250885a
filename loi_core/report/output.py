"""Writing the result folder of a scene; each file appears whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from loi_core.fitting.history import FitStep
from loi_core.fitting.views import Images, by_view
from loi_core.io.files import write_text
from loi_core.io.images import write_png
from loi_core.io.result_folder import (
    HISTORY_FILE,
    RESULT_FILE,
    SCALES_FILE,
    ResultFolder,
)
from loi_core.objectives.loi import ACCURACIES
from loi_core.pixels.display import Display, robust_maximum, signed_to_grey
from loi_core.report.names import EFFECTS_FOLDER, FRAMES_FOLDER, GRADIENTS_FOLDER, effect_file, frame_file
from loi_core.report.provenance import environment
from loi_core.report.scales import scale_table, write_gradients
from loi_core.report.tables import csv_text
from loi_core.scenes.recorder import FrameWriter, Trial, frame_steps, scene_psnr
from loi_core.scenes.scale_terms import scale_objectives
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Array, Host, epsilon, to_numpy, widened
from loi_core.support.values import finite_or_none

__all__ = ["frame_writer", "summary", "write_results"]

MAX_TRUE_VALUES: Final = 64  # of a parameter; a history holds no larger ones


def write_results(scene: Scene, trials: Sequence[Trial], *, command: str = "") -> dict[str, Any]:
    """Write all results of a scene to its output folder, except for the page; return the summary.

    ``parameters.json``, ``history.csv``, ``initial.png``, ``final.png``, ``target.png``, ``error.png`` and ``frames/``
    belong to the first objective. Every other objective has ``final.png``, ``error.png``, ``history.csv`` and
    ``parameters.json`` in ``compare/NAME``. A renderer that plans its effects adds ``effects/NAME.png``: the change of
    the image by each effect, grey where there is none. An objective with scales adds ``scales.csv``, the value of each
    scale at the steps of the frames; the first objective also ``gradients/``. ``result.json`` summarises all
    objectives.

    Parameters
    ----------
    scene : Scene
    trials : sequence of Trial
    command : str
        The command that repeats the fit.

    Raises
    ------
    OptionError
        If the output is not a folder of results.
    WriteError
        If a file cannot be written.
    """
    folder = ResultFolder(scene.output)
    folder.claim()
    folder.remove_unfinished()
    target, display = scene.target_montage, scene.display
    gradients: list[dict[str, Any]] = []
    for index, trial in enumerate(trials):
        prefix = "" if index == 0 else f"compare/{trial.objective}/"
        if index == 0:
            write_png(folder.file("target.png"), display.show(target))
            write_png(folder.file("initial.png"), display.show(trial.initial))
        if trial.result is None:
            # Files of an earlier run must not be mistaken for the outcome of this one.
            names = ("final.png", "error.png", "parameters.json", HISTORY_FILE, SCALES_FILE)
            pictures = (*folder.pictures(FRAMES_FOLDER), *folder.pictures(GRADIENTS_FOLDER)) if index == 0 else ()
            folder.remove([*(f"{prefix}{name}" for name in names), *pictures])
            continue
        final = scene.montage(_host_images(trial.result.image))
        write_png(folder.file(f"{prefix}final.png"), display.show(final))
        write_png(folder.file(f"{prefix}error.png"), display.difference(final, target) * _pixel_weights(scene))
        write_text(folder.file(f"{prefix}{HISTORY_FILE}"), _history(trial))
        table = scale_table(trial)
        if table:
            write_text(folder.file(f"{prefix}{SCALES_FILE}"), table)
        else:
            folder.remove([f"{prefix}{SCALES_FILE}"])
        best = {name: to_numpy(value).tolist() for name, value in trial.result.best_params.items()}
        write_text(folder.file(f"{prefix}parameters.json"), json.dumps(best, indent=2) + "\n")
        if index == 0:
            _write_frames(folder, scene, trial, display)
            _write_effects(folder, trial)
            gradients = write_gradients(folder, scene, trial)
    result = summary(scene, trials, command=command)
    if gradients:
        result["scales"] = gradients
    write_text(folder.file(RESULT_FILE), json.dumps(result, indent=2, allow_nan=False) + "\n")
    return result


def summary(scene: Scene, trials: Sequence[Trial], *, command: str = "") -> dict[str, Any]:
    """Return the outcome as plain values for JSON; numbers that are not finite become null."""
    first = trials[0].result
    image = None if first is None else next(iter(by_view(first.image).values()))
    result = {
        "title": scene.title,
        "scene": scene.path.name,
        "output": str(scene.output),
        "steps": scene.fit.steps,
        "views": [name for name in scene.views if name],
        "notes": [*scene.notes, *filter(None, [scene.display.note, _stages_note(trials)])],
        "trials": [_trial_summary(scene, trial) for trial in trials],
        "command": command or None,
        "seed": scene.fit.seed,
        "truth": {name: true.tolist() for name, true in scene.truth.items() if true.size <= MAX_TRUE_VALUES},
        "accuracy": _accuracy(scene, image),
        "environment": environment(scene, image),
    }
    plan = trials[0].plan
    if plan is not None:
        result |= {"plan": str(plan), "effects": {str(choice.effect): choice.on for choice in plan.choices}}
    return result


def frame_writer(scene: Scene, folder: ResultFolder) -> FrameWriter:
    """Return a function that writes a recorded step to its folder at once, so that it survives a crash."""
    display = scene.display

    def write(step: int, frame: Host) -> None:
        write_png(folder.file(frame_file(step)), display.show(frame))

    return write


def _accuracy(scene: Scene, image: Array | None) -> dict[str, Any] | None:
    """Return the accuracy and the plan of the first objective that has scales."""
    names = {value: name for name, value in ACCURACIES.items()}
    for name in scene.objectives:
        for objective in scale_objectives(scene, name).values():
            plan = objective.plan(eps=None if image is None else epsilon(widened(image)))
            return {"name": names.get(objective.tolerance), "tolerance": objective.tolerance, "plan": str(plan)}
    return None


def _trial_summary(scene: Scene, trial: Trial) -> dict[str, Any]:
    entry: dict[str, Any] = {"objective": trial.objective, "error": trial.error or None}
    if trial.result is None:
        return entry
    best = {name: to_numpy(value) for name, value in trial.result.best_params.items()}
    diagnosis = trial.result.diagnosis
    return entry | {
        "value": finite_or_none(trial.result.best_value),
        "best_step": trial.result.best_step,
        "steps_done": len(trial.result.history),
        "seconds": round(trial.seconds, 3),
        "psnr": finite_or_none(scene_psnr(scene, _host_images(trial.result.image))),
        "psnr_initial": finite_or_none(trial.psnr_initial),
        "diagnosis": None
        if diagnosis is None
        else asdict(diagnosis) | {"left": finite_or_none(diagnosis.left), "noise": finite_or_none(diagnosis.noise)},
        "learning_rates": {name: finite_or_none(rate) for name, rate in trial.result.rates.items()},
        "starts_agreeing": trial.result.agreeing,
        "parameters": {name: best[name].tolist() for name in scene.optimise},
        "parameter_errors": {
            name: finite_or_none(np.abs(best[name] - true).max()) for name, true in scene.truth.items()
        },
    }


def _stages_note(trials: Sequence[Trial]) -> str:
    """Return which fits went from far to near, if others did not; empty otherwise."""
    staged = [
        trial.objective for trial in trials if trial.result and trial.result.history and trial.result.history[-1].stage
    ]
    if not staged or len(staged) == len(trials):
        return ""
    return f"{' and '.join(staged)} went from far to near, with a search where that settled early; the others did not"


def _host_images(image: Images) -> dict[str, Host]:
    return {name: to_numpy(array) for name, array in by_view(image).items()}


def _pixel_weights(scene: Scene) -> Host:
    """Return the weight of each pixel, at most 1, shape (H, W, 1), for a picture of the views."""
    return scene.montage(
        {
            name: np.ones((*view.target.image.shape[:2], 1))
            if view.target.weights is None
            else np.minimum(view.target.weights, 1.0)[..., None]
            for name, view in scene.views.items()
        }
    )


def _write_frames(folder: ResultFolder, scene: Scene, trial: Trial, display: Display) -> None:
    frames = {frame_file(step): frame for step, frame in trial.frames}
    for name, frame in frames.items():
        write_png(folder.file(name), display.show(frame))
    done = len(trial.result.history) if trial.result else 0
    # A resumed fit keeps the frames of its first part; frames of a run with other steps must go.
    expected = {frame_file(step) for step in frame_steps(scene) if step < done}
    folder.remove(set(folder.pictures(FRAMES_FOLDER)) - expected)


def _write_effects(folder: ResultFolder, trial: Trial) -> None:
    """Write the change by each effect, all on the range of their sum without its few largest values."""
    pictures = {effect_file(name): image for name, image in trial.effects.items()}
    folder.remove(set(folder.pictures(EFFECTS_FOLDER)) - set(pictures))
    if pictures:
        largest = robust_maximum(np.sum(list(pictures.values()), axis=0))
        for name, image in pictures.items():
            write_png(folder.file(name), signed_to_grey(image, largest))


def _numbers(steps: Sequence[FitStep]) -> Iterator[tuple[str, Host, int]]:
    """Yield every number of the free parameters of some steps: name, array and index."""
    for step in steps:
        for name, value in step.params.items():
            for index in range(value.size):
                yield name, value, index


def _history(trial: Trial) -> str:
    """Return ``history.csv``: a row for each step."""
    history = trial.result.history if trial.result else ()
    names = [f"{name}[{index}]" if value.size > 1 else name for name, value, index in _numbers(history[:1])]
    rows = []
    for step in history:
        psnr = trial.psnr.get(step.step)
        shown = "" if psnr is None else f"{psnr:.4f}"
        row = [step.step, repr(step.value), repr(step.gradient_norm), f"{step.rate:.6g}", f"{step.seconds:.5f}", shown]
        rows.append([*row, step.stage, *(f"{value.ravel()[index]:.9g}" for _, value, index in _numbers([step]))])
    return csv_text(["step", "value", "gradient_norm", "rate", "seconds", "psnr", "stage", *names], rows)

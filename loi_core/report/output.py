"""The result folder of a scene: every file written whole or not at all."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.fitting.history import FitStep
from loi_core.fitting.views import Images, by_view
from loi_core.io.files import write_bytes, write_text
from loi_core.io.images import write_png
from loi_core.io.result_folder import (
    CHECKPOINT_FILE,
    CHECKPOINT_FILES,
    HISTORY_FILE,
    PAGE_FILE,
    RESULT_FILE,
    SCALES_FILE,
    ResultFolder,
)
from loi_core.objectives.loi import ACCURACIES
from loi_core.pixels.display import Display
from loi_core.pixels.signed import about_grey, brightest
from loi_core.report.environment import environment
from loi_core.report.plots import convergence_plot
from loi_core.report.scales import GRADIENTS_FOLDER, scale_entries, scale_table, write_gradients
from loi_core.scenes.by_scale import scale_objectives
from loi_core.scenes.experiment import FrameWriter, Trial, frame_steps, quality
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Array, Host, epsilon, to_numpy, widened

__all__ = ["FRAMES_FOLDER", "effect_file", "frame_writer", "summary", "write_results"]

FRAMES_FOLDER: Final = "frames"
EFFECTS_FOLDER: Final = "effects"
MOST_TRUTH: Final = 64  # numbers of a parameter: of more, no history holds them


def write_results(scene: Scene, trials: Sequence[Trial], *, command: str = "") -> dict[str, Any]:
    """Write all results of a scene to its output folder, except for the page; return the summary.

    ``parameters.json``, ``history.csv``, ``initial.png``, ``final.png``, ``target.png``, ``error.png`` and
    ``frames/`` are those of the first objective; every other has ``final.png``, ``error.png``, ``history.csv`` and
    ``parameters.json`` in ``compare/NAME``. A renderer that plans its effects adds ``effects/NAME.png``, how each makes
    the image change, grey where it does not. An objective with scales adds ``scales.csv``, what each adds to its value
    at the steps of the frames; the first also ``gradients/``, what each pulls at. ``convergence.png`` and
    ``result.json`` hold all of them. `command` is how the fit can be made again.

    Raises
    ------
    OptionError
        If the folder is not one of results.
    WriteError
        If a file cannot be written.
    """
    folder = ResultFolder(scene.output)
    folder.claim([CHECKPOINT_FILE, PAGE_FILE])  # which others write
    folder.remove_unfinished()
    folder.remove([name for name in CHECKPOINT_FILES[1:] if not (folder.path / name).exists()])
    target, display = scene.strip({name: view.target.image for name, view in scene.views.items()}), _display(scene)
    pulls: list[dict[str, Any]] = []
    for index, trial in enumerate(trials):
        own = "" if index == 0 else f"compare/{trial.objective}/"
        if index == 0:
            write_png(folder.file("target.png"), display.show(target))
            write_png(folder.file("initial.png"), display.show(trial.initial))
        if trial.result is None:
            # What an earlier run left must not be taken for the outcome of this one.
            stale = [
                f"{own}{name}" for name in ("final.png", "error.png", "parameters.json", HISTORY_FILE, SCALES_FILE)
            ]
            more = (*folder.listed(FRAMES_FOLDER), *folder.listed(GRADIENTS_FOLDER)) if index == 0 else ()
            folder.remove([*stale, *more])
            continue
        final = scene.strip(_images(trial.result.image))
        write_png(folder.file(f"{own}final.png"), display.show(final))
        write_png(folder.file(f"{own}error.png"), display.difference(final, target) * _counted(scene))
        write_text(folder.file(f"{own}{HISTORY_FILE}"), _history(trial))
        table = scale_table(trial)
        if table:
            write_text(folder.file(f"{own}{SCALES_FILE}"), table)
        else:
            folder.remove([f"{own}{SCALES_FILE}"])
        best = {name: to_numpy(value).tolist() for name, value in trial.result.best_params.items()}
        write_text(folder.file(f"{own}parameters.json"), json.dumps(best, indent=2) + "\n")
        if index == 0:
            _write_frames(folder, scene, trial, display)
            _write_effects(folder, trial)
            pulls = scale_entries(write_gradients(folder, scene, trial))
    write_bytes(folder.file("convergence.png"), convergence_plot(trials))
    result = summary(scene, trials, command=command)
    if pulls:
        result["scales"] = pulls
    write_text(folder.file(RESULT_FILE), json.dumps(result, indent=2, allow_nan=False) + "\n")
    return result


def summary(scene: Scene, trials: Sequence[Trial], *, command: str = "") -> dict[str, Any]:
    """What came out, as plain values for JSON; numbers that are not finite become null."""
    first = trials[0].result
    image = None if first is None else next(iter(by_view(first.image).values()))
    return {
        "title": scene.title,
        "scene": scene.path.name,
        "output": str(scene.output),
        "steps": scene.fit.steps,
        "views": [name for name in scene.views if name],
        "notes": [*scene.notes, *filter(None, [_display(scene).note, _stages(trials)])],
        "trials": [_one(scene, trial) for trial in trials],
        "command": command or None,
        "seed": scene.fit.seed,
        "truth": {name: true.tolist() for name, true in scene.truth.items() if true.size <= MOST_TRUTH},
        "accuracy": _accuracy(scene, image),
        "environment": environment(scene, image),
    } | _plan(trials[0])


def _accuracy(scene: Scene, image: Array | None) -> dict[str, Any] | None:
    """What the first objective that has scales may be off by, and what it does with that."""
    for name in scene.objectives:
        for objective in scale_objectives(scene, name).values():
            named = {value: key for key, value in ACCURACIES.items()}
            tolerance = objective.tolerance
            plan = objective.plan(eps=None if image is None else epsilon(widened(image)))
            return {"name": named.get(tolerance), "tolerance": tolerance, "plan": str(plan)}
    return None


def _plan(trial: Trial) -> dict[str, Any]:
    if trial.plan is None:
        return {}
    return {"plan": str(trial.plan), "effects": {str(one.effect): one.on for one in trial.plan.choices}}


def _one(scene: Scene, trial: Trial) -> dict[str, Any]:
    entry: dict[str, Any] = {"objective": trial.objective, "error": trial.error or None}
    if trial.result is None:
        return entry
    best = {name: to_numpy(value) for name, value in trial.result.best_params.items()}
    return entry | {
        "value": _finite(trial.result.best_value),
        "best_step": trial.result.best_step,
        "steps_done": len(trial.result.history),
        "seconds": round(trial.seconds, 3),
        "psnr": _finite(quality(scene, _images(trial.result.image))),
        "psnr_initial": _finite(trial.psnr_initial),
        "diagnosis": _diagnosis(trial),
        "learning_rates": {name: _finite(rate) for name, rate in trial.result.rates.items()},
        "starts_agreeing": trial.result.agreeing,
        "parameters": {name: best[name].tolist() for name in scene.optimise},
        "parameter_errors": {name: _finite(np.abs(best[name] - true).max()) for name, true in scene.truth.items()},
    }


def _diagnosis(trial: Trial) -> dict[str, Any] | None:
    found = trial.result.diagnosis if trial.result else None
    if found is None:
        return None
    return asdict(found) | {"left": _finite(found.left), "noise": _finite(found.noise)}


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _stages(trials: Sequence[Trial]) -> str:
    """Which fits went from far to near, where others did not; empty otherwise."""
    staged = [one.objective for one in trials if one.result and one.result.history and one.result.history[-1].stage]
    if not staged or len(staged) == len(trials):
        return ""
    return f"{' and '.join(staged)} went from far to near, with a search where that settled early; the others did not"


def _display(scene: Scene) -> Display:
    """How the pictures of a scene are shown."""
    targets = scene.strip({name: view.target.image for name, view in scene.views.items()})
    return Display.of(targets, scene.first.target.encoding)


def _images(image: Images) -> dict[str, Host]:
    """The image of a fit by view, as NumPy."""
    return {name: to_numpy(one) for name, one in by_view(image).items()}


def _counted(scene: Scene) -> Host:
    """How much each pixel counts, in [0, 1], shape (H, W, 1), for a picture of the views."""
    return scene.strip(
        {
            name: np.ones((*view.target.image.shape[:2], 1))
            if view.target.weights is None
            else np.minimum(view.target.weights, 1.0)[..., None]
            for name, view in scene.views.items()
        }
    )


def frame_writer(scene: Scene, folder: ResultFolder) -> FrameWriter:
    """What writes a picture of the way of a fit to its folder at once, so that it is there whatever comes."""
    display = _display(scene)

    def write(step: int, frame: Host) -> None:
        write_png(folder.file(_frame_file(step)), display.show(frame))

    return write


def _frame_file(step: int) -> str:
    return f"{FRAMES_FOLDER}/{step:06d}.png"


def _write_frames(folder: ResultFolder, scene: Scene, trial: Trial, display: Display) -> None:
    new = {_frame_file(step): frame for step, frame in trial.frames}
    folder.claim(new)
    for name, frame in new.items():
        write_png(folder.path / name, display.show(frame))
    done = len(trial.result.history) if trial.result else 0
    # A resumed fit keeps the pictures of its first part; those of a run with other steps must go.
    kept = {step for step in frame_steps(scene) if step < done}
    folder.remove([name for name in folder.listed(FRAMES_FOLDER) if int(Path(name).stem) not in kept])


def _write_effects(folder: ResultFolder, trial: Trial) -> None:
    """Pictures of what each effect changes, all to one scale: that of their sum, less its few largest values."""
    new = {effect_file(name): image for name, image in trial.effects.items()}
    folder.remove(set(folder.listed(EFFECTS_FOLDER)) - set(new))
    folder.claim(new)
    if new:
        largest = brightest(np.sum(list(new.values()), axis=0))
        for name, image in new.items():
            write_png(folder.path / name, about_grey(image, largest))


def effect_file(name: str) -> str:
    """The picture of an effect of this name, within the folder of results."""
    return f"{EFFECTS_FOLDER}/{name.replace(' ', '-')}.png"


def _numbers(steps: Sequence[FitStep]) -> Iterator[tuple[str, Host, int]]:
    """Every number of the free parameters of a step: name, array and index."""
    for one in steps:
        for name, value in one.params.items():
            for index in range(value.size):
                yield name, value, index


def _history(trial: Trial) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    history = trial.result.history if trial.result else ()
    names = [f"{name}[{index}]" if value.size > 1 else name for name, value, index in _numbers(history[:1])]
    writer.writerow(["step", "value", "gradient_norm", "rate", "seconds", "psnr", "stage", *names])
    for one in history:
        quality = trial.psnr.get(one.step)
        shown = "" if quality is None else f"{quality:.4f}"
        writer.writerow(
            [
                *(one.step, repr(one.value), repr(one.gradient_norm), f"{one.rate:.6g}", f"{one.seconds:.5f}", shown),
                *(one.stage, *(f"{value.ravel()[index]:.9g}" for _, value, index in _numbers([one]))),
            ]
        )
    return stream.getvalue()

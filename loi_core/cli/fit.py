"""``loi fit``."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

from loi_core.cli.codes import DONE, FAILED, NOT_FOUND
from loi_core.cli.progress import ProgressBar
from loi_core.errors import OptionError, SceneError, WriteError
from loi_core.fitting.checkpoint import recorded_seconds
from loi_core.fitting.loop import check_fit_options
from loi_core.io.lock import exclusive_use
from loi_core.io.result_folder import CHECKPOINT_FILE, LOCK_FILE, RESULT_FILE, ResultFolder
from loi_core.report import RunningPage, write_page, write_results
from loi_core.report.names import objective_label
from loi_core.report.output import frame_writer, summary
from loi_core.report.page import verdict_line
from loi_core.scenes.experiment import plan_scene, run_scene
from loi_core.scenes.reading import load_scene
from loi_core.scenes.scene import Scene
from loi_core.support.markdown import columns
from loi_core.support.values import formatted
from loi_core.support.wording import printable, shown

__all__ = ["print_summary", "run", "run_and_write"]

MAX_REPLACED_SECONDS: Final = 60.0  # of an earlier fit that a new one replaces without being asked to


def run(options: argparse.Namespace) -> int:
    """Fit a scene file and write its results.

    Returns
    -------
    int
        DONE if the fit found its target, NOT_FOUND if it ended elsewhere, FAILED if a fit ended early.
    """
    if options.explain:
        return _explain(options.scene, as_json=options.json)
    scene = load_scene(options.scene, output=options.output)
    changes = {name: getattr(options, name) for name in ("steps", "starts") if getattr(options, name) is not None}
    fit_options = replace(scene.fit, **changes)
    check_fit_options(
        fit_options.steps, fit_options.learning_rate, fit_options.seed, fit_options.decay, fit_options.starts
    )
    scene = replace(scene, fit=fit_options)
    for note in scene.notes:
        print(f"loi: {printable(note)}", file=sys.stderr)
    ResultFolder(scene.output)  # a folder of somebody else is refused before a lock is put into it
    # The command in the report leaves out folders, and `--resume`, which changes no result.
    command = shlex.join(["loi", "fit", options.scene.name, *(f"--{name}={value}" for name, value in changes.items())])
    with exclusive_use(scene.output / LOCK_FILE, scene.output):
        if not (options.resume or options.overwrite):
            _require_short(scene.output)
        try:
            result = run_and_write(scene, resume=options.resume, command=command, watch=options.watch)
            page = write_page(scene.output)
        except WriteError as error:
            msg = f"{error}; `--resume` continues the fit once it can be written"
            raise WriteError(msg) from error
    if options.json:
        print(json.dumps({**result, "report": str(page)}, indent=2))
    else:
        print_summary(result)
        _print_verdicts(result)
        print(f"\nreport: {page}")
    if any(trial["error"] for trial in result["trials"]):
        return FAILED
    diagnosis = result["trials"][0].get("diagnosis")
    return DONE if diagnosis is None or diagnosis["verdict"] == "converged" else NOT_FOUND


def _require_short(output: Path) -> None:
    """Raise :class:`OptionError` if a folder holds an earlier fit that took long."""
    seconds = recorded_seconds(output / CHECKPOINT_FILE)
    if seconds > MAX_REPLACED_SECONDS:
        msg = (
            f"{shown(str(output))} holds a fit of {seconds / 60.0:.0f} minutes; `--overwrite` replaces it, `--resume` "
            "continues it, and `--output` writes to another folder"
        )
        raise OptionError(msg)


def run_and_write(scene: Scene, *, resume: bool = False, command: str = "", watch: bool = False) -> dict[str, Any]:
    """Fit a scene with progress bars on standard error, write its results, and return the summary.

    Parameters
    ----------
    scene : Scene
    resume : bool
        Whether to continue from the checkpoint.
    command : str
        The command that repeats the fit, for the report.
    watch : bool
        Whether a page follows the fit. The report, which the caller writes, replaces that page.
    """
    folder = ResultFolder(scene.output)  # a folder of somebody else is refused now, not after the fit

    def progress(name: str, step: int, value: float) -> None:
        folder.claim()  # before the checkpoint is written
        bar.show(step + 1, scene.fit.steps, f"{value:.3g}", title=objective_label(name))

    with ProgressBar() as bar:
        trials = run_scene(
            scene,
            checkpoint=scene.output / CHECKPOINT_FILE,
            resume=resume,
            progress=progress,
            write_frame=frame_writer(scene, folder),
            watch=RunningPage(scene, folder, _announce) if watch else None,
        )
    for trial in trials:
        if trial.error:
            hint = "; `--resume` continues the fit" if trial.can_resume else ""
            print(f"loi: {objective_label(trial.objective)}: {printable(trial.error)}{hint}", file=sys.stderr)
    if trials[0].result is None and trials[0].can_resume and (scene.output / RESULT_FILE).exists():
        output = printable(str(scene.output))
        print(f"loi: {output}: the results of an earlier fit are left as they are", file=sys.stderr)
        return summary(scene, trials, command=command)
    return write_results(scene, trials, command=command)


def print_summary(result: Mapping[str, Any]) -> None:
    """Print the summary of one scene as a small table."""
    names = sorted({name for trial in result["trials"] for name in trial.get("parameter_errors", {})})
    rows = [[result["title"], "PSNR dB", "seconds", *(f"|d {name}|" for name in names)]]
    for trial in result["trials"]:
        errors = trial.get("parameter_errors", {})
        numbers = [(trial.get("psnr"), ".2f"), (trial.get("seconds"), ".1f"), *((errors.get(n), ".4g") for n in names)]
        rows.append([objective_label(trial["objective"]), *(formatted(value, spec) for value, spec in numbers)])
    print("\n".join(columns(rows)))


def _announce(page: Path) -> None:
    print(f"loi: follow the fit at {page.absolute().as_uri()}", file=sys.stderr, flush=True)


def _print_verdicts(result: Mapping[str, Any]) -> None:
    print()
    for trial in result["trials"]:
        verdict = verdict_line(trial)
        if verdict:
            print(f"{objective_label(trial['objective'])}: {verdict}")


def _explain(path: Path, *, as_json: bool) -> int:
    """Print the effects that a scene's fit would simulate, and why; write nothing.

    Raises
    ------
    SceneError
        If the scene's renderer does not plan its effects.
    """
    scene = load_scene(path)
    plan = plan_scene(scene, next(iter(scene.objectives)))
    if plan is None:
        msg = f"{path}: [renderer] does not plan its effects; renderers that do are named *-planned by `loi renderers`"
        raise SceneError(msg)
    print(json.dumps(asdict(plan), indent=2) if as_json else plan)
    return DONE

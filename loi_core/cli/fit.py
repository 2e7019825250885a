"""``loi fit``."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from loi_core.cli.codes import DONE, FAILED, NOT_FOUND
from loi_core.cli.watch import check_port, watched
from loi_core.errors import SceneError, WriteError
from loi_core.fitting.loop import check_fit_options
from loi_core.io.lock import FileLock
from loi_core.io.result_folder import CHECKPOINT_FILE, CHECKPOINT_FILES, LOCK_FILE, RESULT_FILE, ResultFolder
from loi_core.renderers.contract import capabilities_of
from loi_core.report import write_page, write_results
from loi_core.report.output import frame_writer, summary
from loi_core.report.page import verdict_line
from loi_core.report.plots import LABELS
from loi_core.scenes.experiment import Trial, Watch, plan_scene, run_scene
from loi_core.scenes.reading import load_scene
from loi_core.scenes.scene import Scene
from loi_core.support.wording import printable

__all__ = ["explain_scene", "fit_scene", "run_and_write"]


def fit_scene(
    path: Path,
    output: Path | None,
    *,
    resume: bool,
    steps: int | None,
    starts: int | None,
    as_json: bool,
    watch: bool = False,
    port: int | None = None,
) -> int:
    """Fit a scene file and write its results; with `watch`, on a page that follows it.

    Returns
    -------
    int
        The exit status: 0 if the scene was found, 1 if a fit ended early, 3 if it ended elsewhere: see the verdict.
    """
    check_port(port, watch=watch)
    scene = load_scene(path, output=output)
    changes = {name: value for name, value in (("steps", steps), ("starts", starts)) if value is not None}
    options = replace(scene.fit, **changes)
    check_fit_options(options.steps, options.learning_rate, options.seed, options.decay, options.starts)
    scene = replace(scene, fit=options)
    for note in scene.notes:
        print(f"loi: {printable(note)}", file=sys.stderr)
    ResultFolder(scene.output)  # somebody else's is told before a lock is put into it
    if watch:
        with watched(scene, port) as served:
            result, page = _fit_alone(scene, _command(path, changes), served.live, resume=resume)
            served.live.finish(page.read_text(encoding="utf-8"))
            _tell(result, page, as_json=as_json)
            if sys.stdout.isatty() and not as_json and not any(trial["error"] for trial in result["trials"]):
                served.stay()
    else:
        result, page = _fit_alone(scene, _command(path, changes), None, resume=resume)
        _tell(result, page, as_json=as_json)
    if any(trial["error"] for trial in result["trials"]):
        return FAILED
    found = result["trials"][0].get("diagnosis")
    return DONE if found is None or found["verdict"] == "converged" else NOT_FOUND


def _fit_alone(scene: Scene, command: str, watch: Watch | None, *, resume: bool) -> tuple[dict[str, Any], Path]:
    """Fit in a folder that nobody else writes to meanwhile; the summary and the page."""
    with FileLock(scene.output / LOCK_FILE, scene.output):
        try:
            result = run_and_write(scene, resume=resume, command=command, watch=watch)
            return result, write_page(scene.output)
        except WriteError as error:
            msg = f"{error}; once it can be, `--resume` goes on"
            raise WriteError(msg) from error


def _command(path: Path, changes: Mapping[str, int]) -> str:
    """How a fit can be made again. Places of files are left out, and so is `--resume`, which changes no result."""
    return shlex.join(["loi", "fit", path.name, *(f"--{name}={value}" for name, value in changes.items())])


def _tell(result: Mapping[str, Any], page: Path, *, as_json: bool) -> None:
    if as_json:
        print(json.dumps({**result, "report": str(page)}, indent=2), flush=True)
        return
    print_summary(result)
    print_verdicts(result)
    print(f"\nreport: {page}", flush=True)


def print_verdicts(result: Mapping[str, Any]) -> None:
    """What came of every fit, a line each."""
    print()
    for trial in result["trials"]:
        said = verdict_line(trial)
        if said:
            print(f"{LABELS.get(trial['objective'], trial['objective'])}: {said}")


def explain_scene(path: Path, *, as_json: bool) -> None:
    """Print which effects a scene's fit would simulate, and why; nothing is written.

    Raises
    ------
    SceneError
        If the scene's renderer does not plan its effects.
    """
    scene = load_scene(path)
    planner = capabilities_of(scene.renderer).planner
    if planner is None:
        msg = f"{path}: [renderer] has no effects to choose; those that have are named *-planned by `loi renderers`"
        raise SceneError(msg)
    plan = plan_scene(scene, planner, next(iter(scene.objectives.values())))
    print(json.dumps(asdict(plan), indent=2) if as_json else plan)


def run_and_write(
    scene: Scene, *, resume: bool = False, command: str = "", watch: Watch | None = None
) -> dict[str, Any]:
    """Fit a scene with progress bars on standard error, write all but the page, and return the summary."""
    folder = ResultFolder(scene.output)  # somebody else's is told now, not after the fit
    bars = _Bars(scene.fit.steps)

    def progress(name: str, step: int, value: float) -> None:
        folder.claim(CHECKPOINT_FILES)  # before the first is written
        bars.step(name, step, value)

    try:
        trials: list[Trial] = run_scene(
            scene,
            checkpoint=scene.output / CHECKPOINT_FILE,
            resume=resume,
            progress=progress,
            write_frame=frame_writer(scene, folder),
            watch=watch,
        )
    finally:
        bars.close()
    for trial in trials:
        if trial.error:
            hint = "; `--resume` goes on" if trial.can_resume else ""
            print(
                f"loi: {LABELS.get(trial.objective, trial.objective)}: {printable(trial.error)}{hint}", file=sys.stderr
            )
    if trials[0].result is None and trials[0].can_resume and (scene.output / RESULT_FILE).exists():
        print(
            f"loi: {printable(str(scene.output))}: the results of an earlier fit are left as they are", file=sys.stderr
        )
        return summary(scene, trials, command=command)
    return write_results(scene, trials, command=command)


def print_summary(result: Mapping[str, Any]) -> None:
    """The summary of one scene as a small table."""
    names = sorted({name for trial in result["trials"] for name in trial.get("parameter_errors", {})})
    heads = [result["title"], "PSNR dB", "seconds", *(f"|d {name}|" for name in names)]
    rows = [heads]
    for trial in result["trials"]:
        errors = trial.get("parameter_errors", {})
        rows.append(
            [
                LABELS.get(trial["objective"], trial["objective"]),
                _shown(trial.get("psnr"), ".2f"),
                _shown(trial.get("seconds"), ".1f"),
                *(_shown(errors.get(name), ".4g") for name in names),
            ]
        )
    widths = [max(len(row[column]) for row in rows) for column in range(len(heads))]
    for row in rows:
        first, *rest = (
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        print("  ".join([first, *rest]))


def _shown(value: Any, spec: str) -> str:
    return format(value, spec) if isinstance(value, int | float) else "-"


class _Bars:
    """One progress bar per objective, on standard error; silent where that is not a terminal."""

    def __init__(self, steps: int) -> None:
        self._steps = steps
        self._bar: tqdm[Any] | None = None
        self._name = ""

    def step(self, name: str, step: int, value: float) -> None:
        """Move the bar of this objective to this step."""
        if self._bar is None or name != self._name:
            self.close()
            self._name = name
            self._bar = tqdm(total=self._steps, initial=step, desc=f"{LABELS.get(name, name):>17}", disable=None)
        self._bar.set_postfix_str(f"{value:.3g}", refresh=False)
        self._bar.update()

    def close(self) -> None:
        """Leave the bar as it is and end its line."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

"""Running a scene: one fit per objective from the same start, watched, and measured against the target."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from loi_core.effects import EffectPlan, PlanningRenderer
from loi_core.errors import FitError, SceneError
from loi_core.fitting.loop import FitInterruptedError, FitResult, FitStep, fit
from loi_core.fitting.parameters import starting_parameters
from loi_core.io.files import read_bytes
from loi_core.io.result_folder import HISTORY_FILE
from loi_core.objectives.base import Objective
from loi_core.pixels.psnr import psnr
from loi_core.renderers.contract import Parameters
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Array, Host, to_numpy
from loi_core.support.guards import foreign

__all__ = ["Progress", "Start", "Trial", "frame_steps", "plan_scene", "run_scene"]

FRAMES: Final = 8  # pictures of the way that a report shows
MOST_HISTORY: Final = 2**28  # bytes, of a million steps

Progress: TypeAlias = Callable[[str, int, float], None]
"""Called as ``progress(objective, step, value)`` after every step of every fit."""


@dataclass
class Trial:
    """One objective's fit.

    Attributes
    ----------
    objective : str
        Its name in the scene.
    result : FitResult or None
        None if the very first step failed.
    initial : array, shape (H, W, C)
        The image at the start.
    psnr : dict of float
        Step to PSNR of its image against the target, in dB.
    frames : list of (int, array)
        Steps and images along the way.
    error : str
        Why the fit ended early; empty if it did not.
    plan : EffectPlan or None
        What was simulated at the end, if the renderer plans that.
    effects : dict of arrays, shape (H, W, C)
        How each effect's part of the image changed along the first descent, whether it was simulated or not.
    """

    objective: str
    result: FitResult | None = None
    initial: Host = field(default_factory=lambda: np.zeros((1, 1, 3)))
    psnr: dict[int, float] = field(default_factory=dict)
    frames: list[tuple[int, Host]] = field(default_factory=list)
    error: str = ""
    plan: EffectPlan | None = None
    effects: dict[str, Host] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Time that the steps took together."""
        return sum(one.seconds for one in self.result.history) if self.result else 0.0


@dataclass(frozen=True)
class Start:
    """Where the fits of a scene begin.

    Attributes
    ----------
    params : dict of arrays
        All parameters of the renderer.
    image : array, shape (H, W, C)
        What it renders of them, in its own library.
    """

    params: Parameters
    image: Array

    @classmethod
    def of(cls, scene: Scene) -> Start:
        """Render the start of a scene.

        Raises
        ------
        SceneError
            If the image does not have the target's shape.
        """
        params = starting_parameters(scene.renderer, scene.optimise)
        with foreign(f"{scene.path}: rendering the start"):
            image = scene.renderer.render(params, seed=scene.fit.seed)
            shape = tuple(image.shape)
        if shape != scene.target.shape:
            msg = f"{scene.path}: the renderer makes images of shape {shape}, the target has {scene.target.shape}"
            raise SceneError(msg)
        return cls(params, image)

    @property
    def host(self) -> Host:
        """The image as NumPy."""
        return to_numpy(self.image)

    def cotangent(self, objective: Objective) -> Array:
        """The gradient of an objective by the image."""
        return objective.value_and_grad(self.image)[1]


def run_scene(
    scene: Scene, *, checkpoint: Path | None = None, resume: bool = False, progress: Progress | None = None
) -> list[Trial]:
    """Fit a scene with each of its objectives.

    A fit that fails, or Ctrl-C, ends with what has been reached so far: the trial says so in ``error``, and after
    Ctrl-C the remaining objectives are not tried. Only the first objective keeps a checkpoint.

    Raises
    ------
    LoiError
        If the scene's options are not allowed; nothing has been rendered then.
    """
    start = Start.of(scene)
    initial = start.host
    earlier = _earlier_psnr(scene.output / HISTORY_FILE) if resume else {}
    trials: list[Trial] = []
    for index, (name, objective) in enumerate(scene.objectives.items()):
        trial = Trial(name, initial=initial)
        watcher = _Watcher(scene, trial, progress)
        trials.append(trial)
        try:
            if isinstance(scene.renderer, PlanningRenderer):
                cotangent = start.cotangent(objective)
                trial.plan = _plan(scene, scene.renderer, start, cotangent)
                if index == 0:
                    found = scene.renderer.effect_images(start.params, cotangent, seed=scene.fit.seed)
                    trial.effects = {name: to_numpy(one) for name, one in found.items()}
            trial.result = fit(
                scene.renderer,
                objective,
                steps=scene.fit.steps,
                learning_rate=scene.fit.learning_rate,
                seed=scene.fit.seed,
                decay=scene.fit.decay,
                stages=None if scene.fit.stages == "none" else "auto",
                starts=scene.fit.starts,
                optimise=scene.optimise,
                checkpoint=checkpoint if index == 0 else None,
                resume=resume,
                callback=watcher,
            )
        except FitError as error:
            trial.error = str(error)
            trial.result = error.result if isinstance(error.result, FitResult) else None
        except FitInterruptedError as stop:
            trial.error = str(stop)
            trial.result = stop.result
            break
        finally:
            if isinstance(scene.renderer, PlanningRenderer):
                trial.plan = scene.renderer.plan
            if index == 0 and trial.result is not None:
                trial.psnr = _known_psnr(trial.result, earlier) | trial.psnr
    return trials


def plan_scene(scene: Scene, renderer: PlanningRenderer, objective: Objective) -> EffectPlan:
    """Plan the effects of a scene's fit with one of its objectives.

    Raises
    ------
    LoiError
        If the renderer or the objective does not take the scene's starting parameters.
    """
    start = Start.of(scene)
    return _plan(scene, renderer, start, start.cotangent(objective))


def _plan(scene: Scene, renderer: PlanningRenderer, start: Start, cotangent: Array) -> EffectPlan:
    return renderer.begin(start.params, cotangent, optimise=list(scene.optimise), seed=scene.fit.seed)


def _earlier_psnr(path: Path) -> dict[tuple[int, float], float]:
    """PSNR by step and value from the history of an earlier fit; empty where there is none that can be read."""
    try:
        text = read_bytes(path, MOST_HISTORY).decode("utf-8")
        rows = [row for row in csv.DictReader(io.StringIO(text, newline="")) if row["psnr"]]
        return {(int(row["step"]), float(row["value"])): float(row["psnr"]) for row in rows}
    except (OSError, ValueError, KeyError, TypeError, csv.Error):
        return {}


def _known_psnr(result: FitResult, earlier: Mapping[tuple[int, float], float]) -> dict[int, float]:
    """PSNR by step, where the earlier fit had the same value: else that history is not of the fit resumed."""
    keys = ((one.step, one.value) for one in result.history)
    return {key[0]: earlier[key] for key in keys if key in earlier}


def frame_steps(steps: int) -> set[int]:
    """The steps whose images a report of a fit of so many steps shows."""
    return {round(k * (steps - 1) / (FRAMES - 1)) for k in range(FRAMES)}


@dataclass
class _Watcher:
    """The callback that keeps what a report shows."""

    scene: Scene
    trial: Trial
    progress: Progress | None

    def __call__(self, step: FitStep, params: Parameters, image: Array) -> None:
        seen = to_numpy(image)
        self.trial.psnr[step.step] = psnr(seen, self.scene.target)
        if step.step in frame_steps(self.scene.fit.steps):
            self.trial.frames.append((step.step, seen.copy()))
        if isinstance(self.scene.renderer, PlanningRenderer):
            self.scene.renderer.watch(step, params, image)
        if self.progress is not None:
            self.progress(self.trial.objective, step.step, step.value)

"""Running a scene: one fit per objective from the same start, watched, and measured against the target."""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from loi_core.effects import EffectPlan, PlanningRenderer
from loi_core.errors import FitError, SceneError
from loi_core.fitting.loop import FitInterruptedError, FitResult, FitStep, fit
from loi_core.fitting.parameters import starting_parameters
from loi_core.fitting.views import Images, by_view
from loi_core.io.files import read_bytes
from loi_core.io.result_folder import HISTORY_FILE
from loi_core.objectives.base import Objective
from loi_core.pixels.psnr import psnr
from loi_core.renderers.contract import Parameters
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Array, Host, to_numpy
from loi_core.support.guards import foreign

__all__ = ["Progress", "Start", "Trial", "frame_steps", "plan_scene", "quality", "run_scene"]

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
        The image at the start; of several views, side by side.
    psnr : dict of float
        Step to PSNR of its image against the target, in dB; of several views, those that the step rendered.
    frames : list of (int, array)
        Steps and images along the way, likewise side by side.
    psnr_initial : float
        That of the start, of all views.
    elapsed : float
        Seconds since the fit began, or was resumed.
    began : int
        The first step that it took since.
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
    psnr_initial: float = math.nan
    elapsed: float = 0.0
    began: int = 0
    frames: list[tuple[int, Host]] = field(default_factory=list)
    error: str = ""
    plan: EffectPlan | None = None
    effects: dict[str, Host] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Time that the fit took, with planning, searching and judging; of an earlier part, that of its steps."""
        earlier = self.result.history[: self.began] if self.result else ()
        return self.elapsed + sum(one.seconds for one in earlier)


@dataclass(frozen=True)
class Start:
    """Where the fits of a scene begin.

    Attributes
    ----------
    params : dict of arrays
        All parameters of the renderers.
    images : dict of arrays, shape (H, W, C)
        What each view renders of them, in its own library.
    """

    params: Parameters
    images: Mapping[str, Array]

    @classmethod
    def of(cls, scene: Scene) -> Start:
        """Render the start of a scene.

        Raises
        ------
        SceneError
            If the image does not have the target's shape.
        """
        params = starting_parameters(scene, scene.optimise)
        images = {}
        for name, view in scene.views.items():
            where = f"{scene.path}: [views.{name}]" if name else f"{scene.path}"
            with foreign(f"{where}: rendering the start"):
                images[name] = view.renderer.render(view.own(params, scene.optimise), seed=scene.fit.seed)
                shape = tuple(images[name].shape)
            wanted = view.target.image.shape
            if shape != wanted:
                msg = f"{where}: the renderer makes images of shape {shape}, the target has {wanted}"
                raise SceneError(msg)
        return cls(params, images)

    @property
    def host(self) -> Host:
        """The image of the first view as NumPy."""
        return to_numpy(next(iter(self.images.values())))


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
    initial = scene.strip({name: to_numpy(image) for name, image in start.images.items()})
    first = quality(scene, {name: to_numpy(image) for name, image in start.images.items()})
    earlier = _earlier_psnr(scene.output / HISTORY_FILE) if resume else {}
    trials: list[Trial] = []
    for index, name in enumerate(scene.objectives):
        trial = Trial(name, initial=initial, psnr_initial=first)
        watcher = _Watcher(scene, trial, progress, {view: to_numpy(image) for view, image in start.images.items()})
        trials.append(trial)
        started = time.perf_counter()
        try:
            trial.plan = _plan_all(scene, start, name)
            if index == 0:
                trial.effects = _effect_images(scene, start, name)
            trial.result = fit(
                scene.renderers,
                scene.objective(name),
                steps=scene.fit.steps,
                learning_rate=scene.fit.learning_rate,
                seed=scene.fit.seed,
                decay=scene.fit.decay,
                stages=None if scene.fit.stages == "none" else "auto",
                starts=scene.fit.starts,
                views_per_step=scene.fit.views_per_step,
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
            trial.elapsed = time.perf_counter() - started
            if isinstance(scene.renderer, PlanningRenderer):
                trial.plan = scene.renderer.plan
            if trial.result is not None:
                trial.result = replace(trial.result, image=_all_views(scene, trial.result, start))
            if index == 0 and trial.result is not None:
                trial.psnr = _known_psnr(trial.result, earlier) | trial.psnr
    return trials


def _all_views(scene: Scene, result: FitResult, start: Start) -> Images:
    """The image of every view: a fit that was cut short may have those of some only."""
    if not isinstance(result.image, dict) or len(result.image) == len(scene.views):
        return result.image
    images = dict(result.image)
    for name, view in scene.views.items():
        if name not in images:
            try:
                own = view.own(result.best_params, scene.optimise)
                images[name] = view.renderer.render(own, seed=scene.fit.seed + result.best_step)
            except Exception:  # noqa: BLE001 - it may be what cut the fit short
                images[name] = start.images[name]
    return images


def plan_scene(scene: Scene, renderer: PlanningRenderer, objective: Objective) -> EffectPlan:
    """Plan the effects of a scene's fit with one of its objectives.

    Raises
    ------
    LoiError
        If the renderer or the objective does not take the scene's starting parameters.
    """
    start = Start.of(scene)
    image = next(iter(start.images.values()))
    return _plan(scene, scene.first.own(start.params, scene.optimise), renderer, objective, image)


def _plan(
    scene: Scene, params: Parameters, renderer: PlanningRenderer, objective: Objective, image: Array
) -> EffectPlan:
    cotangent = objective.value_and_grad(image)[1]
    moving = [name for name in scene.optimise if name in params]
    return renderer.begin(params, cotangent, optimise=moving, seed=scene.fit.seed)


def _plan_all(scene: Scene, start: Start, objective: str) -> EffectPlan | None:
    """Plan the effects of every view that plans them; the plan of the first."""
    plans = [
        _plan(
            scene,
            view.own(start.params, scene.optimise),
            view.renderer,
            view.objectives[objective],
            start.images[name],
        )
        for name, view in scene.views.items()
        if isinstance(view.renderer, PlanningRenderer)
    ]
    return plans[0] if plans else None


def _effect_images(scene: Scene, start: Start, objective: str) -> dict[str, Host]:
    """How each effect of the first view makes its image change; none if it plans none."""
    name, view = next(iter(scene.views.items()))
    if not isinstance(view.renderer, PlanningRenderer):
        return {}
    cotangent = view.objectives[objective].value_and_grad(start.images[name])[1]
    params = view.own(start.params, scene.optimise)
    found = view.renderer.effect_images(params, cotangent, seed=scene.fit.seed)
    return {effect: to_numpy(one) for effect, one in found.items()}


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


def quality(scene: Scene, images: Mapping[str, Host]) -> float:
    """PSNR of the images of some views against their targets, in dB, where pixels count."""
    errors = []
    for name, image in images.items():
        target = scene.views[name].target
        errors.append(10.0 ** (-0.1 * psnr(image, target.image, target.weights)))
    error = sum(errors) / len(errors)
    return math.inf if error == 0.0 else -10.0 * math.log10(error)


def frame_steps(steps: int) -> set[int]:
    """The steps whose images a report of a fit of so many steps shows."""
    return {round(k * (steps - 1) / (FRAMES - 1)) for k in range(FRAMES)}


@dataclass
class _Watcher:
    """The callback that keeps what a report shows."""

    scene: Scene
    trial: Trial
    progress: Progress | None
    latest: dict[str, Host]  # the image of each view when it was last rendered

    def __call__(self, step: FitStep, params: Parameters, image: Images) -> None:
        images = by_view(image)
        seen = {name: to_numpy(one) for name, one in images.items()}
        if not self.trial.psnr:
            self.trial.began = step.step
        self.latest |= seen
        self.trial.psnr[step.step] = quality(self.scene, seen)
        if step.step in frame_steps(self.scene.fit.steps):
            self.trial.frames.append((step.step, self.scene.strip(self.latest).copy()))
        for name, one in images.items():
            view = self.scene.views[name]
            if isinstance(view.renderer, PlanningRenderer):
                view.renderer.watch(step, view.own(params, self.scene.optimise), one)
        if self.progress is not None:
            self.progress(self.trial.objective, step.step, step.value)

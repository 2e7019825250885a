"""The experiment of a scene: one fit per objective from the same start, compared with the target."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from loi_core.effects import EffectPlan
from loi_core.errors import FitError, SceneError, WriteError
from loi_core.fitting.loop import FitInterruptedError, FitResult, fit
from loi_core.fitting.parameters import starting_parameters
from loi_core.fitting.views import Images, by_view
from loi_core.method.dispatch import choose_backend
from loi_core.renderers.contract import Parameters, capabilities_of
from loi_core.scenes.recorder import FrameWriter, Progress, Recorder, Trial, Watch, scene_psnr
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Array, Host, to_numpy
from loi_core.support.guards import wrap_errors

__all__ = ["Start", "plan_scene", "run_scene"]


@dataclass(frozen=True)
class Start:
    """The common start of a scene's fits.

    Attributes
    ----------
    params : dict of arrays
        All parameters of the renderers.
    images : dict of arrays, shape (H, W, C)
        The image of each view, in its own array library.
    """

    params: Parameters
    images: Mapping[str, Array]

    @classmethod
    def of(cls, scene: Scene) -> Start:
        """Render the start of a scene.

        Raises
        ------
        SceneError
            If an image does not have the shape of its target.
        """
        params = starting_parameters(scene, scene.optimise)
        images = {}
        for name, view in scene.views.items():
            location = f"{scene.path}: [views.{name}]" if name else f"{scene.path}"
            with wrap_errors(f"{location}: rendering the start"):
                images[name] = view.renderer.render(view.parameters(params, scene.optimise), seed=scene.fit.seed)
                shape = tuple(images[name].shape)
            expected = view.target.image.shape
            if shape != expected:
                msg = f"{location}: the renderer makes images of shape {shape}, the target has {expected}"
                background = getattr(view.renderer, "background", None)
                if getattr(background, "shape", None) == shape:
                    msg += "; its images are as large as its `background`"
                raise SceneError(msg)
        return cls(params, images)

    @property
    def host(self) -> Host:
        """The image of the first view as a NumPy array."""
        return to_numpy(next(iter(self.images.values())))


def run_scene(
    scene: Scene,
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    write_frame: FrameWriter | None = None,
    watch: Watch | None = None,
) -> list[Trial]:
    """Fit a scene with each of its objectives.

    A fit that fails, or is interrupted by Ctrl-C, returns its partial result with the cause in ``Trial.error``. After
    Ctrl-C, or if a checkpoint cannot be written, the remaining objectives are skipped. Only the first objective has a
    checkpoint, which contains the record of the trial without its frames.

    Raises
    ------
    LoiError
        If an option of the scene is not allowed; nothing has been rendered then.
    """
    start = Start.of(scene)
    starts = {name: to_numpy(image).copy() for name, image in start.images.items()}
    initial, psnr_initial = scene.montage(starts), scene_psnr(scene, starts)
    trials: list[Trial] = []
    for image in start.images.values():
        choose_backend(image)  # compiles the comparison, if this machine has not yet, before any clock runs
    for index, name in enumerate(scene.objectives):
        is_first = index == 0
        trial = Trial(name, initial=initial, starts=starts, psnr_initial=psnr_initial)
        recorder = Recorder(scene, trial, progress, write_frame if is_first else None, watch, dict(starts))
        trials.append(trial)
        started = time.perf_counter()
        try:
            if is_first:
                trial.effects = _effect_images(scene, start, name)
            trial.result = fit(
                scene.renderers,
                scene.objective(name),
                steps=scene.fit.steps,
                learning_rate=scene.fit.learning_rate,
                seed=scene.fit.seed,
                decay=scene.fit.decay,
                stages=None if scene.fit.stages == "none" else "auto",
                polish=None if scene.fit.polish == "none" else "pixels",
                starts=scene.fit.starts,
                views_per_step=scene.fit.views_per_step,
                optimise=scene.optimise,
                checkpoint=checkpoint if is_first else None,
                resume=resume and is_first,
                callback=recorder,
            )
        except FitError as error:
            trial.error = str(error)
            trial.result = error.result if isinstance(error.result, FitResult) else None
            if isinstance(error.__cause__, WriteError):  # the files of other objectives could not be written either
                trial.can_resume = True
                break
        except FitInterruptedError as interruption:
            trial.error = str(interruption)
            trial.result = interruption.result
            trial.can_resume = True
            break
        finally:
            trial.elapsed = time.perf_counter() - started
            if trial.result is not None:
                trial.plan = next(iter(by_view(trial.result.plan).values()))
                trial.result = replace(trial.result, image=_images_of_all_views(scene, trial.result, start))
    return trials


def plan_scene(scene: Scene, objective: str) -> EffectPlan | None:
    """Return the plan with which the fit of a scene's first view starts; None if its renderer plans nothing.

    Raises
    ------
    LoiError
        If the renderer or the objective rejects the initial parameters.
    """
    start = capabilities_of(scene.renderer).start
    if start is None:
        return None
    params, cotangent, optimise = _first_gradient(scene, Start.of(scene), objective)
    planner = capabilities_of(start(params, cotangent, optimise=optimise, seed=scene.fit.seed)).planner
    return None if planner is None else planner.plan


def _images_of_all_views(scene: Scene, result: FitResult, start: Start) -> Images:
    """Return the image of every view; the result of an interrupted fit may have only some of them."""
    if not isinstance(result.image, dict) or len(result.image) == len(scene.views):
        return result.image
    images = dict(result.image)
    for name, view in scene.views.items():
        if name not in images:
            try:
                params = view.parameters(result.best_params, scene.optimise)
                images[name] = view.renderer.render(params, seed=scene.fit.seed + result.best_step)
            except Exception:  # noqa: BLE001 - the cause of the interruption may be this very view
                images[name] = start.images[name]
    return images


def _first_gradient(scene: Scene, start: Start, objective: str) -> tuple[Parameters, Array, list[str]]:
    """Return the parameters of the first view, the gradient of the loss there, and the names of the free parameters."""
    name, view = next(iter(scene.views.items()))
    params = view.parameters(start.params, scene.optimise)
    cotangent = view.objectives[objective].value_and_grad(start.images[name])[1]
    return params, cotangent, [free for free in scene.optimise if free in params]


def _effect_images(scene: Scene, start: Start, objective: str) -> dict[str, Host]:
    """Return the change of the first view's image through each effect; empty without a planner."""
    planner = capabilities_of(scene.renderer).planner
    if planner is None:
        return {}
    params, cotangent, optimise = _first_gradient(scene, start, objective)
    images = planner.effect_images(params, cotangent, optimise=optimise, seed=scene.fit.seed)
    return {effect: to_numpy(image) for effect, image in images.items()}

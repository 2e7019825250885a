"""Running a scene: one fit per objective from the same start, watched, and measured against the target."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from loi_core.effects import EffectPlan, EffectPlanner
from loi_core.errors import FitError, SceneError, WriteError
from loi_core.fitting.loop import FitInterruptedError, FitResult, FitStep, fit
from loi_core.fitting.parameters import starting_parameters
from loi_core.fitting.views import Images, by_view
from loi_core.method.comparison import ScaleKey
from loi_core.objectives.base import Objective
from loi_core.pixels.psnr import psnr
from loi_core.renderers.contract import Parameters, capabilities_of
from loi_core.scenes.scale_terms import scale_terms
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Array, Host, to_numpy
from loi_core.support.guards import wrap_errors

__all__ = ["FrameWriter", "Progress", "Start", "Trial", "Watch", "frame_steps", "plan_scene", "quality", "run_scene"]

FRAMES: Final = 24  # pictures of the way that a report shows
FEW_FRAMES: Final = 8  # and of large images
LARGE: Final = 2**18  # pixels
SEEN: Final = "seen/"  # what the images of views are called in a checkpoint
FRAME: Final = "frame/"  # and frames, by their steps, that are not on disk yet
TERMS: Final = "terms"  # rows of a step, a scale (alpha, beta, sigma) and what it adds to the value

Progress: TypeAlias = Callable[[str, int, float], None]
"""Called as ``progress(objective, step, value)`` after every step of every fit."""

FrameWriter: TypeAlias = Callable[[int, Host], None]
"""Called as ``write(step, frame)`` for every picture of the way of the first fit, once that has come so far."""

Watch: TypeAlias = Callable[[str, FitStep, float, Callable[[], Host]], None]
"""Called as ``watch(objective, step, psnr, picture)`` after every step; ``picture()`` is a copy of its image."""


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
        Steps and images along the way, likewise side by side; of a fit that was resumed, those since.
    terms : dict of dict of float
        Of the steps in `frames`, what each scale (alpha, beta, sigma) of the objective adds to its value; of one that
        has no scales, empty.
    starts : dict of arrays, shape (H, W, C)
        The image of each view at the start.
    psnr_initial : float
        That of the start, of all views.
    elapsed : float
        Seconds since the fit began, or was resumed.
    began : int
        The first step that it took since.
    error : str
        Why the fit ended early; empty if it did not.
    can_resume : bool
        Whether it can go on from its checkpoint: it was interrupted, or a file could not be written.
    plan : EffectPlan or None
        What was simulated at the end, if the renderer plans that.
    effects : dict of arrays, shape (H, W, C)
        How each effect's part of the image changed along the first descent, whether it was simulated or not.
    """

    objective: str
    result: FitResult | None = None
    initial: Host = field(default_factory=lambda: np.zeros((1, 1, 3)))
    psnr: dict[int, float] = field(default_factory=dict)
    terms: dict[int, dict[ScaleKey, float]] = field(default_factory=dict)
    starts: dict[str, Host] = field(default_factory=dict)
    psnr_initial: float = math.nan
    elapsed: float = 0.0
    began: int = 0
    frames: list[tuple[int, Host]] = field(default_factory=list)
    error: str = ""
    can_resume: bool = False
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
            with wrap_errors(f"{where}: rendering the start"):
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
    scene: Scene,
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    write_frame: FrameWriter | None = None,
    watch: Watch | None = None,
) -> list[Trial]:
    """Fit a scene with each of its objectives.

    A fit that fails, or Ctrl-C, ends with what has been reached so far: the trial says so in ``error``, and after
    Ctrl-C, or where a checkpoint cannot be written, the remaining objectives are not tried. Only the first objective
    keeps a checkpoint, and in it what is seen on the way; but no frame that `write_frame` has written.

    Raises
    ------
    LoiError
        If the scene's options are not allowed; nothing has been rendered then.
    """
    start = Start.of(scene)
    starts = {name: to_numpy(image).copy() for name, image in start.images.items()}
    initial = scene.strip(starts)
    first = quality(scene, starts)
    trials: list[Trial] = []
    for index, name in enumerate(scene.objectives):
        trial = Trial(name, initial=initial, starts=starts, psnr_initial=first)
        watcher = _Watcher(scene, trial, progress, write_frame if index == 0 else None, watch, dict(starts))
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
                finish=None if scene.fit.finish == "none" else "pixels",
                starts=scene.fit.starts,
                views_per_step=scene.fit.views_per_step,
                optimise=scene.optimise,
                checkpoint=checkpoint if index == 0 else None,
                resume=resume and index == 0,
                callback=watcher,
            )
        except FitError as error:
            trial.error = str(error)
            trial.result = error.result if isinstance(error.result, FitResult) else None
            if isinstance(error.__cause__, WriteError):  # the results of others could not be written either
                trial.can_resume = True
                break
        except FitInterruptedError as stop:
            trial.error = str(stop)
            trial.result = stop.result
            trial.can_resume = True
            break
        finally:
            trial.elapsed = time.perf_counter() - started
            planner = capabilities_of(scene.renderer).planner
            if planner is not None:
                trial.plan = planner.plan
            if trial.result is not None:
                trial.result = replace(trial.result, image=_all_views(scene, trial.result, start))
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


def plan_scene(scene: Scene, planner: EffectPlanner, objective: Objective) -> EffectPlan:
    """Plan the effects of a scene's fit with one of its objectives.

    Raises
    ------
    LoiError
        If the renderer or the objective does not take the scene's starting parameters.
    """
    start = Start.of(scene)
    image = next(iter(start.images.values()))
    return _plan(scene, scene.first.own(start.params, scene.optimise), planner, objective, image)


def _plan(scene: Scene, params: Parameters, planner: EffectPlanner, objective: Objective, image: Array) -> EffectPlan:
    cotangent = objective.value_and_grad(image)[1]
    moving = [name for name in scene.optimise if name in params]
    return planner.begin(params, cotangent, optimise=moving, seed=scene.fit.seed)


def _plan_all(scene: Scene, start: Start, objective: str) -> EffectPlan | None:
    """Plan the effects of every view that plans them; the plan of the first."""
    plans = [
        _plan(scene, view.own(start.params, scene.optimise), planner, view.objectives[objective], start.images[name])
        for name, view in scene.views.items()
        if (planner := capabilities_of(view.renderer).planner) is not None
    ]
    return plans[0] if plans else None


def _effect_images(scene: Scene, start: Start, objective: str) -> dict[str, Host]:
    """How each effect of the first view makes its image change; none if it plans none."""
    name, view = next(iter(scene.views.items()))
    planner = capabilities_of(view.renderer).planner
    if planner is None:
        return {}
    cotangent = view.objectives[objective].value_and_grad(start.images[name])[1]
    params = view.own(start.params, scene.optimise)
    found = planner.effect_images(params, cotangent, seed=scene.fit.seed)
    return {effect: to_numpy(one) for effect, one in found.items()}


def quality(scene: Scene, images: Mapping[str, Host]) -> float:
    """PSNR of the images of some views against their targets, in dB, where pixels count."""
    errors = []
    for name, image in images.items():
        target = scene.views[name].target
        errors.append(10.0 ** (-0.1 * psnr(image, target.image, target.weights)))
    error = sum(errors) / len(errors)
    return math.inf if error == 0.0 else -10.0 * math.log10(error)


def frame_steps(scene: Scene) -> set[int]:
    """The steps of a fit whose images a report shows."""
    pixels = sum(math.prod(view.target.image.shape[:2]) for view in scene.views.values())
    count = FRAMES if pixels <= LARGE else FEW_FRAMES
    return {round(k * (scene.fit.steps - 1) / (count - 1)) for k in range(count)}


@dataclass
class _Watcher:
    """The callback that keeps what a report shows, and has a checkpoint remember it."""

    scene: Scene
    trial: Trial
    progress: Progress | None
    write_frame: FrameWriter | None
    watch: Watch | None
    latest: dict[str, Host]  # the image of each view when it was last rendered
    unwritten: dict[int, Host] = field(default_factory=dict)
    called: bool = False
    shown: set[int] = field(init=False)

    def __post_init__(self) -> None:
        self.shown = frame_steps(self.scene)

    def __call__(self, step: FitStep, params: Parameters, image: Images, /) -> None:  # noqa: ARG002 - a callback's
        seen = {name: to_numpy(one) for name, one in by_view(image).items()}
        if not self.called:
            self.trial.began, self.called = step.step, True
        self.latest |= seen
        psnr = self.trial.psnr[step.step] = quality(self.scene, seen)
        if step.step in self.shown:
            self._add_frame(step.step, self._picture())
            self.trial.terms[step.step] = scale_terms(self.scene, self.trial.objective, self.latest)
        if self.watch is not None:
            self.watch(self.trial.objective, step, psnr, self._picture)
        if self.progress is not None:
            self.progress(self.trial.objective, step.step, step.value)

    def memory(self) -> dict[str, Host]:
        """The PSNR of every step; the images of views that not every step renders; and frames that are not on disk."""
        self._write_frames()
        known = np.array(sorted(self.trial.psnr.items()), dtype=np.float64).reshape(-1, 2)
        terms = [(step, *key, value) for step, each in self.trial.terms.items() for key, value in each.items()]
        some = self.scene.fit.views_per_step is not None
        views = {f"{SEEN}{name}": image for name, image in self.latest.items()} if some else {}
        told = {"psnr": known, TERMS: np.array(terms, dtype=np.float64).reshape(-1, 5)}
        return {**told, **views, **{f"{FRAME}{step}": frame for step, frame in self.unwritten.items()}}

    def restore(self, memory: Mapping[str, Host], /) -> None:
        """What :meth:`memory` gave to the checkpoint of an earlier fit; what is of another kind is left out."""
        known = memory.get("psnr", np.zeros((0, 2)))
        if known.ndim == 2 and known.shape[1] == 2 and np.all(np.isfinite(known[:, 0])):
            self.trial.psnr |= {int(step): float(value) for step, value in known}
        self.trial.began = len(self.trial.psnr)
        terms = memory.get(TERMS, np.zeros((0, 5)))
        if terms.ndim == 2 and terms.shape[1] == 5 and np.all(np.isfinite(terms)):
            for step, alpha, beta, sigma, value in terms.tolist():
                self.trial.terms.setdefault(int(step), {})[alpha, beta, sigma] = value
        for name, image in self.latest.items():
            seen = memory.get(f"{SEEN}{name}", image)
            if seen.shape == image.shape:
                self.latest[name] = seen
        shape = self.scene.strip(self.latest).shape
        for name, frame in memory.items():
            step = name.removeprefix(FRAME)
            if name.startswith(FRAME) and step.isascii() and step.isdecimal() and frame.shape == shape:
                self._add_frame(int(step), frame)

    def _picture(self) -> Host:
        return self.scene.strip(self.latest).copy()

    def _add_frame(self, step: int, frame: Host) -> None:
        self.trial.frames.append((step, frame))
        self.unwritten[step] = frame
        self._write_frames()

    def _write_frames(self) -> None:
        """Write the frames that are not on disk; those that cannot be written wait: a picture does not end a fit."""
        if self.write_frame is None:
            return
        for step, frame in list(self.unwritten.items()):
            try:
                self.write_frame(step, frame)
            except WriteError:
                return
            del self.unwritten[step]

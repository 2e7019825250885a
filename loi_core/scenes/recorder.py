"""Recording of a fit for its report, across interruptions."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from loi_core.effects import EffectPlan
from loi_core.errors import WriteError
from loi_core.fitting.loop import FitResult, FitStep
from loi_core.fitting.views import Images, by_view
from loi_core.method.comparison import ScaleKey
from loi_core.pixels.psnr import psnr
from loi_core.renderers.contract import Parameters
from loi_core.scenes.scale_terms import scale_terms
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Host, to_numpy

__all__ = ["FrameWriter", "Progress", "Recorder", "Trial", "Watch", "frame_steps", "scene_psnr"]

FRAMES: Final = 24  # images of the descent in a report
FRAMES_OF_LARGE_IMAGES: Final = 8
LARGE_IMAGE_PIXELS: Final = 2**18
VIEW: Final = "view/"  # prefix of view images in a checkpoint
TERMS: Final = "terms"  # rows of step, alpha, beta, sigma and the scale's contribution to the value

Progress: TypeAlias = Callable[[str, int, float], None]
"""Called as ``progress(objective, step, value)`` after every step of every fit."""

FrameWriter: TypeAlias = Callable[[int, Host], None]
"""Called as ``write(step, frame)`` for every frame of the first fit."""

Watch: TypeAlias = Callable[[str, FitStep, float, Callable[[], Host]], None]
"""Called as ``watch(objective, step, psnr, picture)`` after every step; ``picture()`` returns a copy of its image."""


@dataclass
class Trial:
    """The fit of a scene with one of its objectives.

    Attributes
    ----------
    objective : str
        Name of the objective in the scene.
    result : FitResult or None
        None if the first step failed.
    initial : array, shape (H, W, C)
        Initial image; the views side by side.
    psnr : dict of float
        PSNR in dB by step, over the views that the step rendered.
    frames : list of (int, array)
        Steps and images of the descent since the start or the resumption, the views side by side.
    terms : dict of dict of float
        Contribution of each scale (alpha, beta, sigma) to the value, for the steps in `frames`; empty for an objective
        without scales.
    starts : dict of arrays, shape (H, W, C)
        Initial image of each view.
    psnr_initial : float
        PSNR in dB of all initial images.
    elapsed : float
        Seconds since the fit started or resumed.
    first_step : int
        First step after the start or the resumption.
    error : str
        Cause of an early end; empty otherwise.
    can_resume : bool
        Whether the fit can continue from its checkpoint: it was interrupted, or a file could not be written.
    plan : EffectPlan or None
        The final plan, if the renderer plans effects.
    effects : dict of arrays, shape (H, W, C)
        Change of the image through each effect along the first descent direction, whether it was simulated or not.
    """

    objective: str
    result: FitResult | None = None
    initial: Host = field(default_factory=lambda: np.zeros((1, 1, 3)))
    psnr: dict[int, float] = field(default_factory=dict)
    terms: dict[int, dict[ScaleKey, float]] = field(default_factory=dict)
    starts: dict[str, Host] = field(default_factory=dict)
    psnr_initial: float = math.nan
    elapsed: float = 0.0
    first_step: int = 0
    frames: list[tuple[int, Host]] = field(default_factory=list)
    error: str = ""
    can_resume: bool = False
    plan: EffectPlan | None = None
    effects: dict[str, Host] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Duration of the fit, including planning, search and diagnosis; before a resumption the steps only."""
        earlier = self.result.history[: self.first_step] if self.result else ()
        return self.elapsed + sum(step.seconds for step in earlier)


def scene_psnr(scene: Scene, images: Mapping[str, Host]) -> float:
    """Return the PSNR in dB of the images of some views against their targets, over pixels with weight."""
    errors = []
    for name, image in images.items():
        target = scene.views[name].target
        errors.append(10.0 ** (-0.1 * psnr(image, target.image, target.weights)))
    error = sum(errors) / len(errors)
    return math.inf if error == 0.0 else -10.0 * math.log10(error)


def frame_steps(scene: Scene) -> set[int]:
    """Return the steps of a fit whose images a report shows."""
    pixels = sum(math.prod(view.target.image.shape[:2]) for view in scene.views.values())
    count = FRAMES if pixels <= LARGE_IMAGE_PIXELS else FRAMES_OF_LARGE_IMAGES
    return {round(k * (scene.fit.steps - 1) / (count - 1)) for k in range(count)}


@dataclass
class Recorder:
    """Callback that records a trial, and saves the record in the checkpoint of the fit.

    Attributes
    ----------
    scene : Scene
    trial : Trial
        The record.
    progress, write_frame, watch : callable, optional
        Called after every step, or for every frame.
    latest : dict of arrays, shape (H, W, C)
        Latest image of each view.
    """

    scene: Scene
    trial: Trial
    progress: Progress | None
    write_frame: FrameWriter | None
    watch: Watch | None
    latest: dict[str, Host]
    _called: bool = False
    _frame_steps: set[int] = field(init=False)

    def __post_init__(self) -> None:
        self._frame_steps = frame_steps(self.scene)

    def __call__(self, step: FitStep, params: Parameters, image: Images, /) -> None:  # noqa: ARG002
        """Record a step."""
        rendered = {name: to_numpy(view_image) for name, view_image in by_view(image).items()}
        if not self._called:
            self.trial.first_step, self._called = step.step, True
        self.latest |= rendered
        step_psnr = self.trial.psnr[step.step] = scene_psnr(self.scene, rendered)
        if step.step in self._frame_steps:
            self._add_frame(step.step)
            self.trial.terms[step.step] = scale_terms(self.scene, self.trial.objective, self.latest)
        if self.watch is not None:
            self.watch(self.trial.objective, step, step_psnr, self._picture)
        if self.progress is not None:
            self.progress(self.trial.objective, step.step, step.value)

    def memory(self) -> dict[str, Host]:
        """Return the state for a checkpoint: PSNR and terms by step, and the latest image of each view."""
        values = np.array(sorted(self.trial.psnr.items()), dtype=np.float64).reshape(-1, 2)
        rows = [(step, *key, value) for step, terms in self.trial.terms.items() for key, value in terms.items()]
        skips_views = self.scene.fit.views_per_step is not None
        views = {f"{VIEW}{name}": image for name, image in self.latest.items()} if skips_views else {}
        return {"psnr": values, TERMS: np.array(rows, dtype=np.float64).reshape(-1, 5), **views}

    def restore(self, memory: Mapping[str, Host], /) -> None:
        """Restore the state that :meth:`memory` saved; entries of a wrong shape are ignored."""
        values = memory.get("psnr", np.zeros((0, 2)))
        if values.ndim == 2 and values.shape[1] == 2 and np.all(np.isfinite(values[:, 0])):
            self.trial.psnr |= {int(step): float(value) for step, value in values}
        self.trial.first_step = len(self.trial.psnr)
        rows = memory.get(TERMS, np.zeros((0, 5)))
        if rows.ndim == 2 and rows.shape[1] == 5 and np.all(np.isfinite(rows)):
            for step, alpha, beta, sigma, value in rows.tolist():
                self.trial.terms.setdefault(int(step), {})[alpha, beta, sigma] = value
        for name, image in self.latest.items():
            saved = memory.get(f"{VIEW}{name}", image)
            if saved.shape == image.shape:
                self.latest[name] = saved

    def _picture(self) -> Host:
        return self.scene.montage(self.latest).copy()

    def _add_frame(self, step: int) -> None:
        frame = self._picture()
        self.trial.frames.append((step, frame))
        if self.write_frame is not None:
            with contextlib.suppress(WriteError):  # a frame must not end a fit
                self.write_frame(step, frame)

"""A scene: what is rendered, what the image should look like, what may move, and how it is compared."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from loi_core.fitting.parameters import Free, SharedParameters
from loi_core.fitting.views import Images, as_given
from loi_core.io.images import FloatImage
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import Objective
from loi_core.pixels.display import side_by_side
from loi_core.pixels.tone_curve import LogTone
from loi_core.renderers.contract import Parameters, Renderer
from loi_core.scenes.target import Target
from loi_core.support.arrays import Host

__all__ = ["FitOptions", "Scene", "SceneView"]


@dataclass(frozen=True)
class FitOptions:
    """The ``[fit]`` table; the arguments of :func:`loi_core.fit` of the same names."""

    steps: int = 200
    learning_rate: float | str | None = None
    decay: Any = "cosine"
    seed: int = 0
    stages: Any = "auto"
    finish: Any = "none"
    starts: int = 1
    views_per_step: int | None = None


@dataclass(frozen=True)
class SceneView:
    """One render of a scene, and what it is compared with.

    Attributes
    ----------
    renderer : Renderer
        As its factory made it.
    target : Target
        The image to match, and how much each of its pixels counts.
    scales : ScaleSpace
        Those of the file, for whichever objective compares them.
    objectives : dict
        By name; the first is the one that the scene is fitted with, the others are compared with it.
    """

    renderer: Renderer
    target: Target
    scales: ScaleSpace
    objectives: dict[str, Objective]

    def own(self, params: Parameters, moving: Iterable[str]) -> Parameters:
        """The parameters of this view: those that move out of `params`, all others as its renderer has them."""
        own = self.renderer.parameters()
        return {**own, **{name: params[name] for name in moving if name in own}}


@dataclass(frozen=True)
class Scene:
    """A scene file, read, checked and made into objects.

    Attributes
    ----------
    path : Path
        The file.
    title : str
        For the report.
    output : Path
        Folder of the results.
    views : dict of SceneView
        By name; one whose name is empty if the file names none.
    optimise : dict of Free
        What may move.
    truth : dict of arrays
        True values of parameters, where the scene gives them; only ever used to report errors.
    fit : FitOptions
        Steps, rates and seed.
    samples : int, optional
        Samples per pixel, if the renderer takes them as an option ``spp``.
    tone : LogTone, optional
        The tone curve that image and target pass in every objective.
    """

    path: Path
    title: str
    output: Path
    views: dict[str, SceneView]
    optimise: dict[str, Free]
    truth: dict[str, np.ndarray[Any, Any]]
    fit: FitOptions = field(default_factory=FitOptions)
    samples: int | None = None
    tone: LogTone | None = None

    @property
    def first(self) -> SceneView:
        """The only view, or the first of several."""
        return next(iter(self.views.values()))

    @property
    def renderer(self) -> Renderer:
        """The renderer of the first view."""
        return self.first.renderer

    @property
    def target(self) -> FloatImage:
        """The image that the first view is to match, shape (H, W, 3)."""
        return self.first.target.image

    @property
    def scales(self) -> ScaleSpace:
        """The scales of the first view."""
        return self.first.scales

    @property
    def objectives(self) -> dict[str, Objective]:
        """The objectives of the first view, by name."""
        return self.first.objectives

    def parameters(self) -> Parameters:
        """The parameters of all views."""
        return SharedParameters({name: view.renderer for name, view in self.views.items()}).parameters()

    @property
    def renderers(self) -> Images:
        """The renderer, or those of several views by name."""
        return as_given({name: view.renderer for name, view in self.views.items()})

    def objective(self, name: str) -> Images:
        """The objective of this name, or those of several views by theirs."""
        return as_given({view: one.objectives[name] for view, one in self.views.items()})

    def strip(self, images: Mapping[str, Host]) -> Host:
        """Images of views as one picture, in the order of the file."""
        return side_by_side(images[name] for name in self.views)

    @property
    def notes(self) -> list[str]:
        """What was done to the targets as they were read, a line each."""
        return list(dict.fromkeys(note for view in self.views.values() for note in view.target.notes))

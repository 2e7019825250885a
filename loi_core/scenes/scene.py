"""A scene: renderers, target images, free parameters and objectives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from loi_core.fitting.parameters import Free, SharedParameters
from loi_core.fitting.views import Images, ungrouped
from loi_core.io.images import FloatImage
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import Objective
from loi_core.pixels.display import Display, side_by_side
from loi_core.pixels.tone_curve import LogTone
from loi_core.renderers.contract import Parameters, Renderer
from loi_core.scenes.target import Target
from loi_core.support.arrays import Host

__all__ = ["FitOptions", "Scene", "SceneView"]


@dataclass(frozen=True)
class FitOptions:
    """The table ``[fit]``: arguments of :func:`loi_core.fit`."""

    steps: int = 200
    learning_rate: float | str | None = None
    decay: Any = "cosine"
    seed: int = 0
    stages: Any = "auto"
    polish: Any = "none"
    starts: int = 1
    views_per_step: int | None = None


@dataclass(frozen=True)
class SceneView:
    """One view of a scene, with its target.

    Attributes
    ----------
    renderer : Renderer
        The renderer of the view.
    target : Target
        The image to match, with pixel weights.
    scales : ScaleSpace
        Scales of the file, for objectives that compare scales.
    objectives : dict
        By name; the scene is fitted with the first, and the others are compared with it.
    """

    renderer: Renderer
    target: Target
    scales: ScaleSpace
    objectives: dict[str, Objective]

    def parameters(self, params: Parameters, optimised: Iterable[str]) -> Parameters:
        """Return the parameters of this view: the optimised ones from `params`, the others from its renderer."""
        current = self.renderer.parameters()
        return {**current, **{name: params[name] for name in optimised if name in current}}


@dataclass(frozen=True)
class Scene:
    """A scene file, read and checked.

    Attributes
    ----------
    path : Path
        The file.
    title : str
        Heading of the report.
    output : Path
        Folder of the results.
    views : dict of SceneView
        By name; a single view with an empty name if the file has no ``[views]``.
    optimise : dict of Free
        Free parameters.
    truth : dict of arrays
        True values of parameters that the file gives; used only to report errors.
    fit : FitOptions
        Steps, rates and seed.
    samples : int, optional
        Samples per pixel, if the renderer has an option ``spp``.
    tone : LogTone, optional
        Tone curve that every objective applies to image and target.
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
    def first_view(self) -> SceneView:
        """The first view."""
        return next(iter(self.views.values()))

    @property
    def renderer(self) -> Renderer:
        """The renderer of the first view."""
        return self.first_view.renderer

    @property
    def target(self) -> FloatImage:
        """The target image of the first view, shape (H, W, 3)."""
        return self.first_view.target.image

    @property
    def scales(self) -> ScaleSpace:
        """The scales of the first view."""
        return self.first_view.scales

    @property
    def objectives(self) -> dict[str, Objective]:
        """The objectives of the first view, by name."""
        return self.first_view.objectives

    def parameters(self) -> Parameters:
        """Return the parameters of all views."""
        return SharedParameters({name: view.renderer for name, view in self.views.items()}).parameters()

    @property
    def renderers(self) -> Images:
        """The renderer of a single view, or the renderers of several views by name."""
        return ungrouped({name: view.renderer for name, view in self.views.items()})

    def objective(self, name: str) -> Images:
        """Return the objective called `name` of a single view, or these objectives of several views by view."""
        return ungrouped({view_name: view.objectives[name] for view_name, view in self.views.items()})

    def montage(self, images: Mapping[str, Host]) -> Host:
        """Return the images of all views side by side, in the order of the file."""
        return side_by_side(images[name] for name in self.views)

    @property
    def target_montage(self) -> Host:
        """The targets of all views side by side."""
        return self.montage({name: view.target.image for name, view in self.views.items()})

    @property
    def display(self) -> Display:
        """Exposure and encoding of all pictures of the scene."""
        return Display.of(self.target_montage, self.first_view.target.encoding)

    @property
    def notes(self) -> list[str]:
        """Conversions of the target images when they were read, one line each."""
        return list(dict.fromkeys(note for view in self.views.values() for note in view.target.notes))

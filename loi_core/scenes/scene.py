"""A scene: what is rendered, what the image should look like, what may move, and how it is compared."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from loi_core.fitting.parameters import Free
from loi_core.io.images import FloatImage
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import Objective
from loi_core.pixels.tone_curve import LogTone
from loi_core.renderers.contract import Renderer

__all__ = ["FitOptions", "Scene"]


@dataclass(frozen=True)
class FitOptions:
    """The ``[fit]`` table; the arguments of :func:`loi_core.fit` of the same names."""

    steps: int = 200
    learning_rate: float | str | None = None
    decay: Any = "cosine"
    seed: int = 0
    stages: Any = "auto"
    starts: int = 1


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
    renderer : Renderer
        As its factory made it.
    target : array, shape (H, W, 3), float64
        The image to match.
    scales : ScaleSpace
        Those of the file, for whichever objective compares them.
    objectives : dict
        By name; the first is the one that the scene is fitted with, the others are compared with it.
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
    renderer: Renderer
    target: FloatImage
    scales: ScaleSpace
    objectives: dict[str, Objective]
    optimise: dict[str, Free]
    truth: dict[str, np.ndarray[Any, Any]]
    fit: FitOptions = field(default_factory=FitOptions)
    samples: int | None = None
    tone: LogTone | None = None

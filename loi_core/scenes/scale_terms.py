"""Per-scale values and gradients of the objective of a scene."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loi_core.errors import LoiError
from loi_core.method.comparison import ScaleKey
from loi_core.objectives import LOIObjective
from loi_core.objectives.loi import gradients_by_scale
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Host

__all__ = ["scale_descent", "scale_objectives", "scale_terms"]


def scale_objectives(scene: Scene, name: str) -> dict[str, LOIObjective]:
    """Return the objectives called `name` by view; empty unless every view has an LOIObjective."""
    objectives = {view_name: view.objectives[name] for view_name, view in scene.views.items()}
    multiscale = {view: objective for view, objective in objectives.items() if isinstance(objective, LOIObjective)}
    return multiscale if len(multiscale) == len(objectives) else {}


def scale_terms(scene: Scene, name: str, images: Mapping[str, Host]) -> dict[ScaleKey, float]:
    """Return the contribution of each scale to a scene's objective, averaged over views; they sum to its value.

    Parameters
    ----------
    scene : Scene
    name : str
        Name of the objective.
    images : dict of arrays, shape (H, W, C)
        Images of all views.

    Returns
    -------
    dict of float
        By (alpha, beta, sigma); empty if the objective has no scales, or an image has no value.
    """
    terms: dict[ScaleKey, float] = {}
    for view, objective in scale_objectives(scene, name).items():
        try:
            view_terms = objective.terms(images[view])
        except LoiError:  # a view that has not been rendered yet; the fit itself checks the images that it renders
            return {}
        for key, value in view_terms.items():
            terms[key] = terms.get(key, 0.0) + float(value) / len(scene.views)
    return terms


def scale_descent(scene: Scene, name: str, images: Mapping[str, Host]) -> dict[ScaleKey, Host]:
    """Return each scale's descent direction in the image: positive where the scale's term falls as pixels brighten.

    Parameters and keys as in :func:`scale_terms`. Values have the shape of ``scene.montage(images)`` and are 0 in views
    without the scale.
    """
    by_scale: dict[ScaleKey, dict[str, Host]] = {}
    for view, objective in scale_objectives(scene, name).items():
        try:
            for key, gradient in gradients_by_scale(objective, images[view]):
                by_scale.setdefault(key, {})[view] = -np.asarray(gradient) / len(scene.views)
        except LoiError:
            return {}
    blank = {view: np.zeros_like(image) for view, image in images.items()}
    return {key: scene.montage({**blank, **directions}) for key, directions in by_scale.items()}
